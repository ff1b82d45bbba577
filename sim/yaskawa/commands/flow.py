"""Program flow: XQ HX JP JS EN IF ELSE ENDIF ZS RE RI II IN BK SL TR ED NO (L3126-L11936)."""

import re
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.status import report_text
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_expression, compile_integer
from sim.yaskawa.language.registry import Outcome, Runner, register_command
from sim.yaskawa.motion.trippoints import when_passed
from sim.yaskawa.program.editor import ProgramEditor
from sim.yaskawa.program.threads import NO_BREAK, ProgramThread


def running_thread(c: CommandContext) -> ProgramThread:
    """Return the thread that runs the command."""
    if c.thread is None:
        raise CommandError(2)
    return c.thread


def _compile_location(text: str) -> Callable[[CommandContext], int]:
    """A label, `#L+n`, or a line number (L5671)."""
    if text.startswith("#"):
        label, mark, extra = text[1:].partition("+")
        offset = compile_integer(extra) if mark else None
        return lambda c: _check_line(c, c.machine.program.find_label(label) + (offset(c) if offset is not None else 0))
    value = compile_integer(text)
    return lambda c: _check_line(c, value(c))


def _check_line(c: CommandContext, number: int) -> int:
    if not 0 <= number < c.machine.model.room.lines:
        raise CommandError(11)
    if number >= len(c.machine.program.lines):
        raise CommandError(10)
    return number


@register_command("XQ")
def _compile_execute(text: str) -> Runner:
    parts = split_fields(text)
    location = _compile_location(parts[0]) if parts[0] else None
    number = compile_integer(parts[1]) if len(parts) > 1 and parts[1] else None
    index = compile_integer(parts[2]) if len(parts) > 2 else None

    def run_command(c: CommandContext) -> Outcome:
        programs = c.machine.programs
        thread = number(c) if number is not None else 0
        if not 0 <= thread < c.machine.model.threads:
            raise CommandError(6)
        line = location(c) if location is not None else _check_line(c, 0)
        if programs.threads[thread].running:
            raise CommandError(19)
        programs.threads[thread].start_at(line, index(c) if index is not None else 0, c.machine.current_sample())
        return None

    return run_command


@register_command("HX")
def _compile_halt(text: str) -> Runner:
    number = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        if number is None:
            c.machine.programs.halt_all()
            return None
        thread = number(c)
        if not 0 <= thread < c.machine.model.threads:
            raise CommandError(6)
        c.machine.programs.threads[thread].halt_thread()
        return None

    return run_command


def _parse_jump(text: str) -> tuple[Callable[[CommandContext], int], Callable[[CommandContext], int] | None]:
    parts = split_fields(text)
    if len(parts) > 2 or not parts[0]:
        raise CommandError(4)
    return _compile_location(parts[0]), compile_expression(parts[1]) if len(parts) == 2 else None


@register_command("JP", where="program")
def _compile_jump_to(text: str) -> Runner:
    location, condition = _parse_jump(text)

    def run_command(c: CommandContext) -> Outcome:
        if condition is None or condition(c):
            c.machine.programs.jump_to(running_thread(c), location(c))
        return None

    return run_command


@register_command("JS", where="program")
def _compile_subroutine(text: str) -> Runner:
    location, condition = _parse_jump(text)

    def run_command(c: CommandContext) -> Outcome:
        if condition is not None and not condition(c):
            return None
        thread, programs = running_thread(c), c.machine.programs
        line = location(c)
        if thread.index >= len(programs.compiled_line(thread.line)):
            thread.line, thread.index = thread.line + 1, 0
        backward = line <= thread.line
        thread.call_subroutine(line)
        if backward:
            programs.count_loop(thread)
        return None

    return run_command


@register_command("EN", where="program")
def _compile_end(text: str) -> Runner:
    def run_command(c: CommandContext) -> Outcome:
        thread = running_thread(c)
        if thread.stack:
            thread.leave_subroutine()
        else:
            thread.halt_thread()
        return None

    return run_command


@register_command("IF", where="program")
def _compile_if(text: str) -> Runner:
    if not text:
        raise CommandError(50)
    condition = compile_expression(text)

    def run_command(c: CommandContext) -> Outcome:
        if not condition(c):
            c.machine.programs.skip_block(running_thread(c), to_else=True)
        return None

    return run_command


@register_command("ELSE", where="program")
def _compile_else(text: str) -> Runner:
    def run_command(c: CommandContext) -> Outcome:
        c.machine.programs.skip_block(running_thread(c), to_else=False)
        return None

    return run_command


@register_command("ENDIF", where="program")
def _compile_endif(text: str) -> Runner:
    return lambda c: None


@register_command("ZS", where="program")
def _compile_zero_stack(text: str) -> Runner:
    """Set the stack; `ZS ?` reports the depth (L11914)."""
    if text == "?":
        return lambda c: report_text(c, c.machine.format_variable(fixed.from_integer(len(running_thread(c).stack))))
    value = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        thread = running_thread(c)
        number = value(c) if value is not None else 0
        if not 0 <= number <= 15:
            raise CommandError(6)
        if number == 0:
            thread.stack.clear()
        elif thread.stack:
            thread.stack.pop()
        return None

    return run_command


def _register_return(op: str) -> None:
    @register_command(op, where="program")
    def compile_return(text: str) -> Runner:
        value = compile_integer(text) if text else None

        def run_command(c: CommandContext) -> Outcome:
            thread = running_thread(c)
            restore = value(c) if value is not None else 0
            if op == "RI":
                c.machine.programs.interrupts_on = c.machine.programs.interrupts != 0
            if thread.stack:
                thread.leave_subroutine(restore=restore == 1)
                c.machine.programs.count_loop(thread)
            return None

        return run_command

    del compile_return


_register_return("RE")
_register_return("RI")


@register_command("II")
def _compile_input_interrupt(text: str) -> Runner:
    """Set the interrupt mask in a program only (L6019); reading the mask is always allowed (L6021)."""
    if text == "?":
        return lambda c: report_text(c, c.machine.format_integer(c.machine.programs.interrupts, 3))
    if not text:
        raise CommandError(50)
    fields = compile_values(parse_fields(text, 4))

    def run_command(c: CommandContext) -> Outcome:
        running_thread(c)
        values = [None if raw is None else fixed.to_integer(raw) for raw in [*fields(c), None, None, None]]
        first, last, mask, high = values[:4]
        programs = c.machine.programs
        if first is not None:
            if not 0 <= first <= 8 or (last is not None and not 2 <= last <= 8):
                raise CommandError(6)
            selected_mask = 0
            if first:
                for number in range(first, (last or first) + 1):
                    selected_mask |= 1 << (number - 1)
        elif mask is not None:
            if not 1 <= mask <= 255:
                raise CommandError(6)
            selected_mask = mask
        else:
            selected_mask = high or 0
        if high is not None and not 1 <= high <= 255:
            raise CommandError(6)
        programs.interrupts, programs.active_high = selected_mask, high or 0
        programs.interrupts_on = selected_mask != 0
        return None

    return run_command


_TARGET = re.compile(r"[A-Za-z][A-Za-z0-9]*(\[.+\])?")
_STRING = re.compile(r"S[1-6]?\}")


@register_command("IN", where="program")
def _compile_input(text: str) -> Runner:
    """`IN "prompt",NAME{So}`: thread 0 waits for a value for a variable or an array element (L16135)."""
    body = text[4:] if text.startswith("{P1}") else text
    parts = split_fields(body)
    if len(parts) < 2:
        raise CommandError(65)
    name, _, form = parts[1].partition("{")
    if not name:
        raise CommandError(25)
    if (form and _STRING.fullmatch(form) is None) or _TARGET.fullmatch(name) is None:
        raise CommandError(53 if form else 9)
    length = int(form[1:-1] or fixed.STRING_LENGTH) if form else 0
    prompt = parts[0].strip('"')

    def run_command(c: CommandContext) -> Outcome:
        thread = running_thread(c)
        if thread.number:
            raise CommandError(71)
        c.machine.ports.send_text("S", prompt)
        thread.input_for, thread.input_length = name, length
        return when_passed(lambda machine, sample: not thread.input_for)

    return run_command


@register_command("BK", where="line")
def _compile_breakpoint(text: str) -> Runner:
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        programs = c.machine.programs
        values = [None if raw is None else fixed.to_integer(raw) for raw in [*fields(c), None]]
        for thread in programs.threads:
            thread.paused = False
            thread.steps = 0
        if values[0] is None:
            programs.break_at, programs.break_hit = None, False
            return None
        number = values[1] or 0
        if not 0 <= values[0] < c.machine.model.room.lines or not 0 <= number < c.machine.model.threads:
            raise CommandError(6)
        programs.break_at, programs.break_hit = (values[0], number), False
        return None

    return run_command


@register_command("SL", where="line")
def _compile_single_step(text: str) -> Runner:
    value = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        programs = c.machine.programs
        lines = value(c) if value is not None else 1
        if lines < 1:
            raise CommandError(6)
        for thread in programs.threads:
            if thread.paused:
                thread.paused, thread.steps = False, lines
        return None

    return run_command


@register_command("TR", lock="13")
def _compile_trace(text: str) -> Runner:
    value = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        number = value(c) if value is not None else 0
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.programs.trace = number == 1
        return None

    return run_command


@register_command("ED", where="line", lock="13")
def _compile_edit(text: str) -> Runner:
    """Start the editor, at a line; without one at the last (L4536). Not in motion (L4549)."""
    value = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        if c.machine.programs.any_running():
            raise CommandError(17)
        if c.machine.motion.is_active():
            raise CommandError(7)
        count = len(c.machine.program.lines)
        line = value(c) if value is not None else max(count - 1, 0)
        if not 0 <= line <= count:
            raise CommandError(11)
        if c.port is not None:
            c.port.editor = ProgramEditor(c.port, c.machine.program, line)
        return None

    return run_command


@register_command("NO")
def _compile_no_operation(text: str) -> Runner:
    return lambda c: None


def breakpoint_value(c: CommandContext) -> int:
    """`_BK`: minus the line when armed, the line when hit."""
    programs = c.machine.programs
    if programs.break_at is None:
        return NO_BREAK
    return programs.break_at[0] if programs.break_hit else -programs.break_at[0]
