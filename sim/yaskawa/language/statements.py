"""Program lines and command lines, split into statements and compiled once by their text."""

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import Format
from sim.yaskawa.language.arguments import canonical, split
from sim.yaskawa.language.expressions import compile_expression
from sim.yaskawa.motion.trippoints import Trip

if TYPE_CHECKING:
    from sim.yaskawa.base.model import Model
    from sim.yaskawa.language.context import Context

Outcome = str | Trip | None
"""What a command gives: text to answer, something to wait for, or nothing but the prompt."""
Runner = Callable[["Context"], Outcome]

_ASSIGNMENT = re.compile(r"([A-Za-z][A-Za-z0-9]*)(\[[^=]*\])?=(?!=)(.*)")
_SPACED_NAME = re.compile(r"[A-Za-z][A-Za-z0-9]*\s+[A-Za-z0-9]")
_LOCAL = re.compile(r"\{([FS$N^])([-0-9.]*)\}")


class Raw(str):
    """Data that is answered as it stands, without CR LF behind it."""


@dataclass(frozen=True, slots=True)
class Command:
    """One op-code. compile: from its argument text. where: `both`, `program` or `line`; lock: see `LC` (L6735)."""

    compile: Callable[[str], Runner]
    where: str = "both"
    lock: str = ""


@dataclass(frozen=True, slots=True)
class Statement:
    """One instruction, ready to run. `quiet` ones (labels, comments) take no time."""

    op: str
    text: str
    runner: Runner
    where: str = "both"
    lock: str = ""
    quiet: bool = False

    def execute(self, c: "Context") -> Outcome:
        """Run it; `CommandError` when it is refused."""
        if self.where != "both" and (self.where == "program") != (c.thread is not None):
            raise CommandError(2 if self.where == "program" else 3)
        if c.thread is None and c.machine.locks(self.op, self.lock, self.text):
            raise CommandError(130)
        return self.runner(c)


def without_blanks(text: str) -> str:
    """Blanks removed, except inside quotes."""
    if " " not in text:
        return text
    if '"' not in text:
        return text.replace(" ", "")
    return '"'.join(part if number % 2 else part.replace(" ", "") for number, part in enumerate(text.split('"')))


def is_comment(text: str, model: "Model") -> bool:
    """Whether a statement is a comment (SMC-4000: L7912, SMC-2000: L10567)."""
    return text.startswith(model.comments) or text == "NO"


@lru_cache(maxsize=8192)
def compile_line(line: str, model: "Model") -> tuple[Statement, ...]:
    """The statements of a line. What is wrong in one of them shows when it is run."""
    statements: list[Statement] = []
    rest = line
    while True:
        stripped = rest.lstrip()
        if is_comment(stripped, model):
            head, found, rest = stripped.partition(model.comment_end) if model.comment_end else (stripped, "", "")
            statements.append(Statement("NO", head, _nothing, quiet=True))
            if not found:
                break
            continue
        text, found, rest = _cut(rest)
        statements.append(compile_statement(text.strip(), model))
        if not found:
            break
    return tuple(statements)


def finished(line: str, model: "Model") -> int:
    """How many characters of an unfinished line are whole statements with their semicolons."""
    done = 0
    while not is_comment(line[done:].lstrip(), model):
        head, found, _ = _cut(line[done:])
        if not found:
            break
        done += len(head) + 1
    return done


def _cut(line: str) -> tuple[str, bool, str]:
    head, *tail = split(line, ";") if '"' in line else line.split(";", 1)
    return head, bool(tail), ";".join(tail)


def _nothing(c: "Context") -> Outcome:
    return None


def compile_statement(text: str, model: "Model") -> Statement:
    """One statement from its text; errors of syntax are raised when it runs."""
    compact = without_blanks(text)
    if not compact:
        return Statement("", text, _nothing, quiet=True)
    if compact.startswith("#"):
        return Statement("#", text, _nothing, where="program", quiet=True)
    for op in ("ELSE", "ENDIF"):
        if compact == op and op in model.commands:
            command = model.commands[op]
            return Statement(op, text, command.compile(""), command.where, command.lock)
    op = compact[:2]
    try:
        if not _is_spaced_command(text, model) and is_assignment(compact, model):
            if not model.spaced_names and _SPACED_NAME.match(text):
                raise CommandError(1)
            return Statement("=", text, _assignment(compact))
        if compact.startswith("~") and model.designators:
            return Statement("~", text, _variable_axis(compact))
        command = model.commands.get(op)
        if command is None:
            raise CommandError(1)
        return Statement(op, text, command.compile(compact[2:]), command.where, command.lock)
    except CommandError as error:
        code = error.code
    command = model.commands.get(op)

    def refuse(c: "Context") -> Outcome:
        raise CommandError(code)

    return Statement(op, text, refuse, command.where if command else "both", command.lock if command else "")


def _is_spaced_command(text: str, model: "Model") -> bool:
    """Whether a blank or the kind of op-code says that what follows are arguments, e.g. `MG V1=2`."""
    op, rest = text[:2], text[2:]
    return op in model.commands and (op == "IF" or (rest[:1] == " " and not rest.lstrip().startswith(("=", "["))))


def is_assignment(compact: str, model: "Model") -> bool:
    """Whether `compact` sets or shows a variable or array element rather than being a command (D8)."""
    match = _ASSIGNMENT.fullmatch(compact)
    if match is None:
        return False
    name, index = match[1], match[2]
    if name == "ET" and index is not None:
        return False
    if len(name) == 3 and index is None and name[:2] in model.commands:
        return canonical(name[2]) not in model.suffixes(name[:2])
    return True


def _assignment(compact: str) -> Runner:
    match = _ASSIGNMENT.fullmatch(compact)
    if match is None:
        raise CommandError(9)
    name, index_text, text = match[1], match[2], match[3]
    source = compile_expression(name + (index_text or ""))
    if text in ("", "?") or text.startswith("{"):
        write = local_format(text) if text.startswith("{") else None

        def show(c: "Context") -> Outcome:
            raw = source(c)
            return write(c, raw) if write is not None else c.machine.show_value(raw)

        return show
    value = compile_expression(text)
    if index_text is None:

        def assign(c: "Context") -> Outcome:
            c.machine.data.assign(name, value(c))
            return None

        return assign
    index = compile_expression(index_text[1:-1])

    def store(c: "Context") -> Outcome:
        c.machine.data.store(name, fixed.truncated(index(c)), value(c))
        return None

    return store


def local_format(text: str) -> Callable[["Context", int], str]:
    """`{Fm.n}`, `{$m.n}` and `{Sn}` (L16288)."""
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
        plain = Format.of(fixed.literal(size or "0"))
    except ValueError:
        raise CommandError(53) from None
    layout = Format(plain.digits, plain.decimals, kind == "$")
    return lambda c, raw: layout.write(raw, c.machine.layout)


def _variable_axis(compact: str) -> Runner:
    """`~a=n`: what the designator `~a` stands for (L7780)."""
    if len(compact) < 4 or compact[2] != "=" or compact[1] not in "abcd":
        raise CommandError(4)
    name = compact[:2]
    text = compact[3:]
    if text.startswith('"') and len(text) == 3:
        letter = canonical(text[1])
        return lambda c: c.machine.name_axis(name, letter)
    value = compile_expression(text)
    return lambda c: c.machine.number_axis(name, fixed.truncated(value(c)))
