"""Program flow: XQ HX JP JS EN IF ELSE ENDIF ZS RE RI II IN BK SL TR ED NO (L3126-L11936)."""

import re
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.status import report
from sim.yaskawa.language.arguments import parse_fields, split, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import compile_expression, integer
from sim.yaskawa.language.registry import Outcome, Runner, command
from sim.yaskawa.motion.trippoints import when
from sim.yaskawa.program.editor import Editor
from sim.yaskawa.program.interpreter import NO_BREAK
from sim.yaskawa.program.threads import Thread


def thread_of(c: Context) -> Thread:
    """The thread that runs the command."""
    if c.thread is None:
        raise CommandError(2)
    return c.thread


def _location(text: str) -> Callable[[Context], int]:
    """A label, `#L+n`, or a line number (L5671)."""
    if text.startswith("#"):
        label, found, extra = text[1:].partition("+")
        offset = integer(extra) if found else None
        return lambda c: _line(c, c.machine.program.line_of(label) + (offset(c) if offset is not None else 0))
    value = integer(text)
    return lambda c: _line(c, value(c))


def _line(c: Context, number: int) -> int:
    if not 0 <= number < c.machine.model.room.lines:
        raise CommandError(11)
    if number >= len(c.machine.program.lines):
        raise CommandError(10)
    return number


@command("XQ")
def _execute(text: str) -> Runner:
    parts = split(text)
    location = _location(parts[0]) if parts[0] else None
    number = integer(parts[1]) if len(parts) > 1 and parts[1] else None
    index = integer(parts[2]) if len(parts) > 2 else None

    def run(c: Context) -> Outcome:
        interpreter = c.machine.interpreter
        thread = number(c) if number is not None else 0
        if not 0 <= thread < c.machine.model.threads:
            raise CommandError(6)
        line = location(c) if location is not None else _line(c, 0)
        if interpreter.threads[thread].running:
            raise CommandError(19)
        interpreter.threads[thread].start(line, index(c) if index is not None else 0, c.machine.now())
        return None

    return run


@command("HX")
def _halt(text: str) -> Runner:
    number = integer(text) if text else None

    def run(c: Context) -> Outcome:
        if number is None:
            c.machine.interpreter.halt_all()
            return None
        thread = number(c)
        if not 0 <= thread < c.machine.model.threads:
            raise CommandError(6)
        c.machine.interpreter.threads[thread].halt()
        return None

    return run


def _jump(text: str) -> tuple[Callable[[Context], int], Callable[[Context], int] | None]:
    parts = split(text)
    if len(parts) > 2 or not parts[0]:
        raise CommandError(4)
    return _location(parts[0]), compile_expression(parts[1]) if len(parts) == 2 else None


@command("JP", where="program")
def _jump_to(text: str) -> Runner:
    location, condition = _jump(text)

    def run(c: Context) -> Outcome:
        if condition is None or condition(c):
            c.machine.interpreter.jump(thread_of(c), location(c))
        return None

    return run


@command("JS", where="program")
def _subroutine(text: str) -> Runner:
    location, condition = _jump(text)

    def run(c: Context) -> Outcome:
        if condition is not None and not condition(c):
            return None
        thread, interpreter = thread_of(c), c.machine.interpreter
        line = location(c)
        if thread.index >= len(interpreter.line(thread.line)):
            thread.line, thread.index = thread.line + 1, 0
        backward = line <= thread.line
        thread.call(line)
        if backward:
            interpreter.tire(thread)
        return None

    return run


@command("EN", where="program")
def _end(text: str) -> Runner:
    def run(c: Context) -> Outcome:
        thread = thread_of(c)
        if thread.stack:
            thread.leave()
        else:
            thread.halt()
        return None

    return run


@command("IF", where="program")
def _if(text: str) -> Runner:
    if not text:
        raise CommandError(50)
    condition = compile_expression(text)

    def run(c: Context) -> Outcome:
        if not condition(c):
            c.machine.interpreter.skip_block(thread_of(c), to_else=True)
        return None

    return run


@command("ELSE", where="program")
def _else(text: str) -> Runner:
    def run(c: Context) -> Outcome:
        c.machine.interpreter.skip_block(thread_of(c), to_else=False)
        return None

    return run


@command("ENDIF", where="program")
def _endif(text: str) -> Runner:
    return lambda c: None


@command("ZS", where="program")
def _zero_stack(text: str) -> Runner:
    """`ZS ?` tells the depth (L11914)."""
    if text == "?":
        return lambda c: report(c, c.machine.show_value(fixed.whole(len(thread_of(c).stack))))
    value = integer(text) if text else None

    def run(c: Context) -> Outcome:
        thread = thread_of(c)
        number = value(c) if value is not None else 0
        if not 0 <= number <= 15:
            raise CommandError(6)
        if number == 0:
            thread.stack.clear()
        elif thread.stack:
            thread.stack.pop()
        return None

    return run


def _return(op: str) -> None:
    @command(op, where="program")
    def compile_return(text: str) -> Runner:
        value = integer(text) if text else None

        def run(c: Context) -> Outcome:
            thread = thread_of(c)
            restore = value(c) if value is not None else 0
            if op == "RI":
                c.machine.interpreter.interrupts_on = c.machine.interpreter.interrupts != 0
            if thread.stack:
                thread.leave(restore=restore == 1)
                c.machine.interpreter.tire(thread)
            return None

        return run

    del compile_return


_return("RE")
_return("RI")


@command("II")
def _input_interrupt(text: str) -> Runner:
    """Only a program sets it (L6019); anybody may ask for the mask (L6021)."""
    if text == "?":
        return lambda c: report(c, c.machine.show_whole(c.machine.interpreter.interrupts, 3))
    if not text:
        raise CommandError(50)
    fields = values(parse_fields(text, 4))

    def run(c: Context) -> Outcome:
        thread_of(c)
        given = [None if raw is None else fixed.truncated(raw) for raw in [*fields(c), None, None, None]]
        first, last, mask, high = given[:4]
        interpreter = c.machine.interpreter
        if first is not None:
            if not 0 <= first <= 8 or (last is not None and not 2 <= last <= 8):
                raise CommandError(6)
            selected = 0
            if first:
                for number in range(first, (last or first) + 1):
                    selected |= 1 << (number - 1)
        elif mask is not None:
            if not 1 <= mask <= 255:
                raise CommandError(6)
            selected = mask
        else:
            selected = high or 0
        if high is not None and not 1 <= high <= 255:
            raise CommandError(6)
        interpreter.interrupts, interpreter.active_high = selected, high or 0
        interpreter.interrupts_on = selected != 0
        return None

    return run


_TARGET = re.compile(r"[A-Za-z][A-Za-z0-9]*(\[.+\])?")
_STRING = re.compile(r"S[1-6]?\}")


@command("IN", where="program")
def _input(text: str) -> Runner:
    """`IN "prompt",NAME{So}`: thread 0 waits for a value for a variable or an array element (L16135)."""
    body = text[4:] if text.startswith("{P1}") else text
    parts = split(body)
    if len(parts) < 2:
        raise CommandError(65)
    name, _, form = parts[1].partition("{")
    if not name:
        raise CommandError(25)
    if (form and _STRING.fullmatch(form) is None) or _TARGET.fullmatch(name) is None:
        raise CommandError(53 if form else 9)
    length = int(form[1:-1] or fixed.STRING_LENGTH) if form else 0
    prompt = parts[0].strip('"')

    def run(c: Context) -> Outcome:
        thread = thread_of(c)
        if thread.number:
            raise CommandError(71)
        c.machine.ports.tell("S", prompt)
        thread.input_for, thread.input_length = name, length
        return when(lambda machine, now: not thread.input_for)

    return run


@command("BK", where="line")
def _breakpoint(text: str) -> Runner:
    fields = values(parse_fields(text, 2))

    def run(c: Context) -> Outcome:
        interpreter = c.machine.interpreter
        given = [None if raw is None else fixed.truncated(raw) for raw in [*fields(c), None]]
        for thread in interpreter.threads:
            thread.paused = False
            thread.steps = 0
        if given[0] is None:
            interpreter.break_at, interpreter.break_hit = None, False
            return None
        number = given[1] or 0
        if not 0 <= given[0] < c.machine.model.room.lines or not 0 <= number < c.machine.model.threads:
            raise CommandError(6)
        interpreter.break_at, interpreter.break_hit = (given[0], number), False
        return None

    return run


@command("SL", where="line")
def _single_step(text: str) -> Runner:
    value = integer(text) if text else None

    def run(c: Context) -> Outcome:
        interpreter = c.machine.interpreter
        lines = value(c) if value is not None else 1
        if lines < 1:
            raise CommandError(6)
        for thread in interpreter.threads:
            if thread.paused:
                thread.paused, thread.steps = False, lines
        return None

    return run


@command("TR", lock="13")
def _trace(text: str) -> Runner:
    value = integer(text) if text else None

    def run(c: Context) -> Outcome:
        number = value(c) if value is not None else 0
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.interpreter.trace = number == 1
        return None

    return run


@command("ED", where="line", lock="13")
def _edit(text: str) -> Runner:
    """The editor, at a line; without one at the last (L4536). Not in motion (L4549)."""
    value = integer(text) if text else None

    def run(c: Context) -> Outcome:
        if c.machine.interpreter.any_running():
            raise CommandError(17)
        if c.machine.motion.active():
            raise CommandError(7)
        count = len(c.machine.program.lines)
        line = value(c) if value is not None else max(count - 1, 0)
        if not 0 <= line <= count:
            raise CommandError(11)
        if c.port is not None:
            c.port.editor = Editor(c.port, line)
        return None

    return run


@command("NO")
def _no_operation(text: str) -> Runner:
    return lambda c: None


def breakpoint_value(c: Context) -> int:
    """`_BK`: minus the line when armed, the line when hit."""
    interpreter = c.machine.interpreter
    if interpreter.break_at is None:
        return NO_BREAK
    return interpreter.break_at[0] if interpreter.break_hit else -interpreter.break_at[0]
