"""Programs, arrays, lists and reset of the SMC-2000: LA LL QU TB RS (L9826, L10003, L10807, L10969)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.data import array_name, element_span, register_listing
from sim.yaskawa.commands.status import compile_tell_code, general_status, report_text
from sim.yaskawa.commands.system import compile_mark_messages
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_integer
from sim.yaskawa.language.registry import SMC2000_COMMANDS, Outcome, Runner, register_command, require_bare
from sim.yaskawa.language.statements import RawData
from sim.yaskawa.ports.ports import END_OF_TEXT

RESET, PARAMETERS, CLEAR = 0, 1, 2


def _array_lines(c: CommandContext) -> list[str]:
    arrays = c.machine.data.arrays
    return [f"{name}[{len(arrays[name])}]" for name in sorted(arrays)]


register_listing("LA", _array_lines, SMC2000_COMMANDS)
register_listing("LL", lambda c: [f"#{label}" for label in sorted(c.machine.program.labels)], SMC2000_COMMANDS)


@register_command("QU", table=SMC2000_COMMANDS)
def _compile_upload_array(text: str) -> Runner:
    """Elements in the variable format, separated and not ended by comma or carriage return, then ctrl-Z (D37)."""
    name_text, *field_texts = split_fields(text)
    name = array_name(name_text)
    fields = compile_values(parse_fields(",".join(field_texts), 3))

    def run_command(c: CommandContext) -> Outcome:
        array = c.machine.data.get_array(name)
        given_fields = [*fields(c), None, None]
        first, last = element_span(c, len(array), given_fields)
        separator = "," if given_fields[2] is not None and fixed.to_integer(given_fields[2]) == 1 else "\r"
        message = separator.join(c.machine.format_variable(raw) for raw in array[first : last + 1]) + END_OF_TEXT
        if c.port is None:
            c.machine.ports.send_message(message)
            return None
        return RawData(message)

    return run_command


@register_command("CW", table=SMC2000_COMMANDS)
def _compile_mark_messages(text: str) -> Runner:
    """`CW ?` reports the copyright, too (L8074)."""
    return compile_mark_messages("0" if text == "?" else text)


@register_command("TC", table=SMC2000_COMMANDS)
def _compile_tell_code(text: str) -> Runner:
    """`TC1{N}` leaves the end of the line to the next message, as the manual's programs use it (L13229)."""
    reported_code = compile_tell_code(text.removesuffix("{N}"))
    if not text.endswith("{N}"):
        return reported_code

    def run_command(c: CommandContext) -> Outcome:
        answer = reported_code(CommandContext(c.machine, None, c.port))
        if not isinstance(answer, str):
            return None
        if c.thread is None:
            return RawData(answer)
        c.machine.ports.send_message(answer)
        return None

    return run_command


@register_command("TB", table=SMC2000_COMMANDS)
def _compile_tell_status(text: str) -> Runner:
    """Report the status without padding (L11675)."""
    require_bare(text.removeprefix("?"))
    return lambda c: report_text(c, c.machine.format_integer(general_status(c), len(str(general_status(c)))))


@register_command("RS", where="line", table=SMC2000_COMMANDS)
def _compile_reset(text: str) -> Runner:
    """`RS` resets, `RS1` restores the burned parameters, `RS2` clears the program (L11364)."""
    value = compile_integer(text) if text else None

    def run_command(c: CommandContext) -> Outcome:
        target = value(c) if value is not None else RESET
        if target not in (RESET, PARAMETERS, CLEAR):
            raise CommandError(6)
        if target == RESET:
            c.machine.reset_controller()
        elif target == PARAMETERS:
            c.machine.memory.restore_parameters()
        else:
            c.machine.programs.halt_all()
            c.machine.program.clear_lines()
        return None

    return run_command
