"""Program lines and command lines, split into statements and compiled once by their text."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

from sim.yaskawa.base import fixed
from sim.yaskawa.base.data import LONGEST_LINE
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import NumberFormat
from sim.yaskawa.language.arguments import canonical_axis, split_fields
from sim.yaskawa.language.context import CommandContext, Outcome, Runner
from sim.yaskawa.language.expressions import compile_expression
from sim.yaskawa.language.model import LanguageModel

_ASSIGNMENT = re.compile(r"([A-Za-z][A-Za-z0-9]*)(\[[^=]*\])?=(?!=)(.*)")
_SPACED_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*\s+[A-Za-z0-9]")
_LOCAL = re.compile(r"\{([FS$N^])([-0-9.]*)\}")


class RawData(str):
    """Data that is sent as it is, without CR LF after it."""


@dataclass(frozen=True, slots=True)
class CompiledStatement:
    """One instruction, ready to run. `quiet` ones (labels, comments) take no time."""

    op: str
    text: str
    runner: Runner
    where: str = "both"
    lock: str = ""
    quiet: bool = False

    def run_statement(self, c: CommandContext) -> Outcome:
        """Run it; raises `CommandError` when it is refused."""
        if self.where != "both" and (self.where == "program") != (c.thread is not None):
            raise CommandError(2 if self.where == "program" else 3)
        if c.thread is None and c.machine.is_locked_command(self.op, self.lock, self.text):
            raise CommandError(130)
        return self.runner(c)


def without_blanks(text: str) -> str:
    """Return the text without blanks, except inside quotes."""
    if " " not in text:
        return text
    if '"' not in text:
        return text.replace(" ", "")
    return '"'.join(part if number % 2 else part.replace(" ", "") for number, part in enumerate(text.split('"')))


def is_comment(text: str, model: LanguageModel) -> bool:
    """Return whether a statement is a comment (SMC-4000: L7912, SMC-2000: L10567)."""
    return text.startswith(model.comments) or text == "NO"


@lru_cache(maxsize=8192)
def compile_line(line: str, model: LanguageModel) -> tuple[CompiledStatement, ...]:
    """Compile the statements of a line. An error in one of them is raised when it runs."""
    statements: list[CompiledStatement] = []
    remainder = line
    while True:
        statement = remainder.lstrip()
        if is_comment(statement, model):
            head, mark, remainder = statement.partition(model.comment_end) if model.comment_end else (statement, "", "")
            runner = _do_nothing if len(head) <= LONGEST_LINE else _refuse_with(5)
            statements.append(CompiledStatement("NO", head, runner, quiet=len(head) <= LONGEST_LINE))
            if not mark:
                break
            continue
        text, mark, remainder = _cut_statement(remainder)
        statements.append(compile_statement(text.strip(), model))
        if not mark:
            break
    return tuple(statements)


def finished_length(line: str, model: LanguageModel) -> int:
    """Return the number of characters of an unfinished line that are whole statements with their semicolons."""
    position = 0
    while not is_comment(line[position:].lstrip(), model):
        head, mark, _ = _cut_statement(line[position:])
        if not mark:
            break
        position += len(head) + 1
    return position


def _cut_statement(line: str) -> tuple[str, bool, str]:
    head, *tail = split_fields(line, ";") if '"' in line else line.split(";", 1)
    return head, bool(tail), ";".join(tail)


def _do_nothing(c: CommandContext) -> Outcome:
    return None


def _refuse_with(code: int) -> Runner:
    def raise_refusal(c: CommandContext) -> Outcome:
        raise CommandError(code)

    return raise_refusal


def compile_statement(text: str, model: LanguageModel) -> CompiledStatement:
    """Compile one statement from its text; syntax errors are raised when it runs."""
    compact = without_blanks(text)
    if len(text) > LONGEST_LINE:
        return CompiledStatement("", text, _refuse_with(5))
    if not compact:
        return CompiledStatement("", text, _do_nothing, quiet=True)
    if compact.startswith("#"):
        return CompiledStatement("#", text, _do_nothing, where="program", quiet=True)
    for op in ("ELSE", "ENDIF"):
        if compact == op and op in model.commands:
            command = model.commands[op]
            return CompiledStatement(op, text, command.compile(""), command.where, command.lock)
    op = compact[:2]
    try:
        if not _is_spaced_command(text, model) and is_assignment(compact, model):
            if not model.spaced_names and _SPACED_NAME.match(text):
                raise CommandError(1)
            return CompiledStatement("=", text, _compile_assignment(compact))
        if compact.startswith("~") and model.designators:
            return CompiledStatement("~", text, _compile_variable_axis(compact))
        command = model.commands.get(op)
        if command is None:
            raise CommandError(1)
        return CompiledStatement(op, text, command.compile(compact[2:]), command.where, command.lock)
    except CommandError as error:
        code = error.code
    command = model.commands.get(op)
    return CompiledStatement(
        op, text, _refuse_with(code), command.where if command else "both", command.lock if command else ""
    )


def _is_spaced_command(text: str, model: LanguageModel) -> bool:
    """Return whether a blank or the kind of op-code shows that arguments follow, e.g. `MG V1=2`."""
    op, tail = text[:2], text[2:]
    return op in model.commands and (op == "IF" or (tail[:1] == " " and not tail.lstrip().startswith(("=", "["))))


def is_assignment(compact: str, model: LanguageModel) -> bool:
    """Return whether `compact` sets or shows a variable or array element and is not a command (D8)."""
    match = _ASSIGNMENT.fullmatch(compact)
    if match is None:
        return False
    name, index = match[1], match[2]
    if name == "ET" and index is not None:
        return False
    if len(name) == 3 and index is None and name[:2] in model.commands:
        return canonical_axis(name[2]) not in model.allowed_suffixes(name[:2])
    return True


def _compile_assignment(compact: str) -> Runner:
    match = _ASSIGNMENT.fullmatch(compact)
    if match is None:
        raise CommandError(9)
    name, index_text, text = match[1], match[2], match[3]
    source = compile_expression(name + (index_text or ""))
    if text in ("", "?") or text.startswith("{"):
        write = local_format(text) if text.startswith("{") else None

        def show_variable(c: CommandContext) -> Outcome:
            raw = source(c)
            return write(c, raw) if write is not None else c.machine.format_variable(raw)

        return show_variable
    value = compile_expression(text)
    if index_text is None:

        def assign_variable(c: CommandContext) -> Outcome:
            c.machine.data.assign_variable(name, value(c))
            return None

        return assign_variable
    index = compile_expression(index_text[1:-1])

    def store_element(c: CommandContext) -> Outcome:
        c.machine.data.store_element(name, fixed.to_integer(index(c)), value(c))
        return None

    return store_element


def local_format(text: str) -> Callable[[CommandContext, int], str]:
    """Parse `{Fm.n}`, `{$m.n}` and `{Sn}` (L16288)."""
    match = _LOCAL.fullmatch(text)
    if match is None or match[1] in "N^":
        raise CommandError(53)
    kind, size = match[1], match[2]
    if kind == "S":
        length = int(size) if size.isdigit() else fixed.STRING_LENGTH
        if not 1 <= length <= fixed.STRING_LENGTH:
            raise CommandError(53)
        return lambda c, raw: fixed.to_string(raw, length)
    try:
        plain = NumberFormat.from_number(fixed.parse_literal(size or "0"))
    except ValueError:
        raise CommandError(53) from None
    layout = NumberFormat(plain.digits, plain.decimals, kind == "$")
    return lambda c, raw: layout.format_value(raw, c.machine.layout)


def _compile_variable_axis(compact: str) -> Runner:
    """`~a=n`: set the axis of the designator `~a` (L7780)."""
    if len(compact) < 4 or compact[2] != "=" or compact[1] not in "abcd":
        raise CommandError(4)
    name = compact[:2]
    text = compact[3:]
    if text.startswith('"') and len(text) == 3:
        letter = canonical_axis(text[1])
        return lambda c: c.machine.designators.name_axis(name, letter)
    value = compile_expression(text)
    return lambda c: c.machine.designators.number_axis(name, fixed.to_integer(value(c)))
