"""Inputs and outputs, messages' ports, memory and locks (L3239-L3582, L6735-L6799, L7734-L8154)."""

from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.status import report
from sim.yaskawa.language.arguments import parse_fields, split, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import compile_expression, integer
from sim.yaskawa.language.registry import Outcome, Runner, bare, command
from sim.yaskawa.motion.trippoints import at_sample

HANDLES = "ABCDEFGH"
UNUSED = -2147483648
POLARITIES = 4
"""Fields of CN."""


# Outputs and inputs


def _output(op: str, level: bool) -> None:
    @command(op)
    def compile_output(text: str) -> Runner:
        value = integer(text)

        def run(c: Context) -> Outcome:
            c.machine.io.set_output(value(c), level)
            return None

        return run

    del compile_output


_output("SB", True)
_output("CB", False)


@command("OB")
def _output_bit(text: str) -> Runner:
    parts = split(text)
    if len(parts) != 2:
        raise CommandError(50)
    number, value = integer(parts[0]), compile_expression(parts[1])

    def run(c: Context) -> Outcome:
        c.machine.io.set_output(number(c), value(c) != 0)
        return None

    return run


@command("OP")
def _output_port(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_whole(c.machine.io.outputs, 3)
    value = integer(text)

    def run(c: Context) -> Outcome:
        outputs = value(c)
        if not 0 <= outputs <= 255:
            raise CommandError(6)
        c.machine.io.set_all(outputs)
        return None

    return run


@command("AO")
def _analog_output(text: str) -> Runner:
    fields = values(parse_fields(text, 2))

    def run(c: Context) -> Outcome:
        given = [raw for raw in fields(c) if raw is not None]
        if len(given) != 2:
            raise CommandError(50)
        if abs(given[1]) > fixed.of(9.9982):
            raise CommandError(6)
        c.machine.io.set_analog(fixed.truncated(given[0]), given[1] / fixed.ONE)
        return None

    return run


@command("CN")
def _configure(text: str) -> Runner:
    if not text:
        raise CommandError(50)
    fields = values(parse_fields(text, POLARITIES))

    def run(c: Context) -> Outcome:
        given = [None if raw is None else fixed.truncated(raw) for raw in fields(c)]
        for index, value in enumerate(given):
            if value is not None and value not in ((0, 1) if index == 3 else (-1, 1)):
                raise CommandError(6)
        for index, value in enumerate(given):
            if value is not None:
                c.machine.polarity[index] = value
        c.machine.motion.homing.polarity = c.machine.polarity[1]
        return None

    return run


# Messages and echo


@command("CF")
def _message_port(text: str) -> Runner:
    if text not in (*HANDLES, "S"):
        raise CommandError(4)

    def run(c: Context) -> Outcome:
        c.machine.unsolicited_port = text
        return None

    return run


@command("CW")
def mark_messages(text: str) -> Runner:
    """`CW`: marks on what nobody has asked for; 0 tells the copyright."""
    value = integer(text)

    def run(c: Context) -> Outcome:
        number = value(c)
        if not 0 <= number <= 2:
            raise CommandError(6)
        if number == 0:
            return report(c, f"{c.machine.revision} Copyright Yaskawa Electric America")
        c.machine.unsolicited_mode = number
        return None

    return run


@command("EO")
def _echo(text: str) -> Runner:
    value = integer(text)

    def run(c: Context) -> Outcome:
        number = value(c)
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.echo = number == 1
        return None

    return run


@command("MW")
def _modbus_wait(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_whole(int(c.machine.modbus_wait), 1)
    value = integer(text)

    def run(c: Context) -> Outcome:
        number = value(c)
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.modbus_wait = number == 1
        return None

    return run


# Memory and locks


def _burn(op: str, burn: Callable[[Context], None], where: str, *, idle: bool) -> None:
    @command(op, where=where, lock="1")
    def compile_burn(text: str) -> Runner:
        bare(text)

        def run(c: Context) -> Outcome:
            machine = c.machine
            if idle and any(thread.running for thread in machine.interpreter.threads if thread is not c.thread):
                raise CommandError(17)
            if op in machine.model.burning.at_rest and machine.motion.active():
                raise CommandError(7)
            burn(c)
            if machine.options.burn_takes_time:
                return at_sample(machine.now() + 1024 * machine.model.burning.seconds[op])
            return None

        return run

    del compile_burn


_burn("BN", lambda c: c.machine.memory.burn_parameters(), "both", idle=True)
_burn("BP", lambda c: c.machine.memory.burn_program(), "line", idle=False)
_burn("BV", lambda c: c.machine.memory.burn_variables(), "both", idle=False)


@command("PW", where="line", lock="13")
def _password(text: str) -> Runner:
    parts = text.split(",")
    if len(parts) != 2:
        raise CommandError(50)
    if parts[0] != parts[1] or len(parts[0]) > 8:
        raise CommandError(4)

    def run(c: Context) -> Outcome:
        memory = c.machine.memory
        memory.password = parts[0]
        if c.machine.model.password_discards:
            memory.discard_parameters()
        return None

    return run


@command("LC", where="line")
def _lock(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show("LC", fixed.whole(c.machine.locked))
    password, _, level_text = text.partition(",")
    level = integer(level_text) if level_text else None

    def run(c: Context) -> Outcome:
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

    return run
