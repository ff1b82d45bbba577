"""Inputs and outputs, messages' ports, memory and locks (L3239-L3582, L6735-L6799, L7734-L8154)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.status import report_text
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_expression, compile_integer
from sim.yaskawa.language.registry import Outcome, Runner, register_command, require_bare
from sim.yaskawa.motion.trippoints import at_sample

HANDLES = "ABCDEFGH"
UNUSED = -2147483648
POLARITIES = 4
"""Fields of CN."""


# Outputs and inputs


def _register_output(op: str, *, level: bool) -> None:
    @register_command(op)
    def compile_output(text: str) -> Runner:
        value = compile_integer(text)

        def run_command(c: CommandContext) -> Outcome:
            c.machine.io.set_output(value(c), level=level)
            return None

        return run_command

    del compile_output


_register_output("SB", level=True)
_register_output("CB", level=False)


@register_command("OB")
def _compile_output_bit(text: str) -> Runner:
    parts = split_fields(text)
    if len(parts) != 2:
        raise CommandError(50)
    number, value = compile_integer(parts[0]), compile_expression(parts[1])

    def run_command(c: CommandContext) -> Outcome:
        c.machine.io.set_output(number(c), level=value(c) != 0)
        return None

    return run_command


@register_command("OP")
def _compile_output_port(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_integer(c.machine.io.outputs, 3)
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        outputs = value(c)
        if not 0 <= outputs <= 255:
            raise CommandError(6)
        c.machine.io.set_all(outputs)
        return None

    return run_command


@register_command("AO")
def _compile_analog_output(text: str) -> Runner:
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        given_fields = [raw for raw in fields(c) if raw is not None]
        if len(given_fields) != 2:
            raise CommandError(50)
        if abs(given_fields[1]) > fixed.from_real(9.9982):
            raise CommandError(6)
        c.machine.io.set_analog(fixed.to_integer(given_fields[0]), given_fields[1] / fixed.ONE)
        return None

    return run_command


@register_command("CN")
def _compile_configure(text: str) -> Runner:
    if not text:
        raise CommandError(50)
    fields = compile_values(parse_fields(text, POLARITIES))

    def run_command(c: CommandContext) -> Outcome:
        values = [None if raw is None else fixed.to_integer(raw) for raw in fields(c)]
        for index, value in enumerate(values):
            if value is not None and value not in ((0, 1) if index == 3 else (-1, 1)):
                raise CommandError(6)
        for index, value in enumerate(values):
            if value is not None:
                c.machine.polarity[index] = value
        c.machine.motion.homing.polarity = c.machine.polarity[1]
        return None

    return run_command


# Messages and echo


@register_command("CF")
def _compile_message_port(text: str) -> Runner:
    if text not in (*HANDLES, "S"):
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        c.machine.unsolicited_port = text
        return None

    return run_command


@register_command("CW")
def compile_mark_messages(text: str) -> Runner:
    """`CW`: marks on unsolicited text; 0 reports the copyright."""
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        number = value(c)
        if not 0 <= number <= 2:
            raise CommandError(6)
        if number == 0:
            return report_text(c, f"{c.machine.revision_text} Copyright Yaskawa Electric America")
        c.machine.unsolicited_mode = number
        return None

    return run_command


@register_command("EO")
def _compile_echo(text: str) -> Runner:
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        number = value(c)
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.echo = number == 1
        return None

    return run_command


@register_command("MW")
def _compile_modbus_wait(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_integer(int(c.machine.modbus_wait), 1)
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        number = value(c)
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.modbus_wait = number == 1
        return None

    return run_command


# Memory and locks


def _register_burn(op: str, burn: Callable[[CommandContext], None], where: str, *, idle: bool) -> None:
    @register_command(op, where=where, lock="1")
    def compile_burn(text: str) -> Runner:
        require_bare(text)

        def run_command(c: CommandContext) -> Outcome:
            machine = c.machine
            if idle and any(thread.running for thread in machine.programs.threads if thread is not c.thread):
                raise CommandError(17)
            if op in machine.model.burning.at_rest and machine.motion.is_active():
                raise CommandError(7)
            burn(c)
            if machine.options.burn_takes_time:
                return at_sample(machine.current_sample() + 1024 * machine.model.burning.seconds[op])
            return None

        return run_command

    del compile_burn


_register_burn("BN", lambda c: c.machine.memory.burn_parameters(), "both", idle=True)
_register_burn("BP", lambda c: c.machine.memory.burn_program(), "line", idle=False)
_register_burn("BV", lambda c: c.machine.memory.burn_variables(), "both", idle=False)


@register_command("PW", where="line", lock="13")
def _compile_password(text: str) -> Runner:
    parts = text.split(",")
    if len(parts) != 2:
        raise CommandError(50)
    if parts[0] != parts[1] or len(parts[0]) > 8:
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        memory = c.machine.memory
        memory.password = parts[0]
        if c.machine.model.password_discards:
            memory.discard_parameters()
        return None

    return run_command


@register_command("LC", where="line")
def _compile_lock(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_answer("LC", fixed.from_integer(c.machine.locked))
    password, _, level_text = text.partition(",")
    level = compile_integer(level_text) if level_text else None

    def run_command(c: CommandContext) -> Outcome:
        if level is None:
            raise CommandError(50)
        number = level(c)
        if not 0 <= number <= c.machine.model.lock_levels:
            raise CommandError(6)
        if password != c.machine.memory.password:
            raise CommandError(4)
        c.machine.locked = number
        c.machine.memory.burn_lock()
        return None

    return run_command
