"""Inputs and outputs, Ethernet, messages' ports, memory and locks (L3239-L3582, L5635-L5946, L6735, L7277)."""

from collections.abc import Callable

from sim.yaskawa import fixed
from sim.yaskawa.arguments import parse_fields, split, values
from sim.yaskawa.commands_status import report
from sim.yaskawa.context import Context
from sim.yaskawa.errors import CommandError
from sim.yaskawa.expressions import compile_expression, integer
from sim.yaskawa.ports import address_text
from sim.yaskawa.registry import Outcome, Runner, bare, command
from sim.yaskawa.trippoints import at_sample

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
        raise CommandError(126)

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


# Ethernet


@command("IA")
def _address(text: str) -> Runner:
    if text == "?":
        return lambda c: address_text(c.machine.address)
    head, retry_given, retry_text = text.partition("<")
    retry = integer(retry_text) if retry_given else None
    unsigned = int(head) if head.isdecimal() and int(head) < 1 << 32 else None
    fields = values(parse_fields(head)) if head and unsigned is None else None

    def run(c: Context) -> Outcome:
        machine = c.machine
        if c.port is not None and c.port.kind != "serial":
            raise CommandError(1)
        if machine.motion.active():
            raise CommandError(7)
        if unsigned is not None:
            machine.address = fixed.wrapped(unsigned)
        if fields is not None:
            machine.address = _parse_address([raw for raw in fields(c) if raw is not None])
        if retry is not None:
            time = retry(c)
            if not 0 <= time <= 2147483647:
                raise CommandError(6)
            machine.retry_time = time
        return None

    return run


def _parse_address(given: list[int]) -> int:
    numbers = [fixed.truncated(raw) for raw in given]
    if len(numbers) == 1:
        return fixed.wrapped(numbers[0])
    if len(numbers) != 4:
        raise CommandError(50)
    if any(not 0 <= number <= 255 for number in numbers):
        raise CommandError(6)
    return fixed.wrapped(int.from_bytes(bytes(numbers), "big"))


@command("IH")
def _internet_handle(text: str) -> Runner:
    handle, found, rest = text.partition("=")
    if not found or handle not in (*HANDLES, "S", "T"):
        raise CommandError(4)
    if rest.startswith(">"):
        value = integer(rest[1:])
        return lambda c: _close(c, handle, value(c))
    if handle in ("S", "T"):
        raise CommandError(4)
    head, kind_given, kind_text = rest.partition(">")
    head, port_given, port_text = head.partition("<")
    kind = integer(kind_text) if kind_given else None
    port = integer(port_text) if port_given else None
    fields = values(parse_fields(head))

    def run(c: Context) -> Outcome:
        ports = c.machine.ports
        if handle in ports.handles or handle in ports.outgoing:
            raise CommandError(124)
        address = _parse_address([raw for raw in fields(c) if raw is not None])
        number = port(c) if port is not None else 502
        session = kind(c) if kind is not None else 2
        if not 0 <= number <= 65535 or not 0 <= session <= 2:
            raise CommandError(6)
        ports.outgoing[handle] = (address, number, -5 if session == 1 else -6)
        return None

    return run


def _close(c: Context, handle: str, how: int) -> Outcome:
    ports = c.machine.ports
    if how not in (-1, -2):
        raise CommandError(6)
    own = c.port.name if c.port is not None else ""
    if handle == "S":
        names = [own]
    elif handle == "T":
        names = [name for name in HANDLES if name != own]
    else:
        names = [handle]
        if handle not in ports.handles and handle not in ports.outgoing:
            raise CommandError(126)
    for name in names:
        ports.outgoing.pop(name, None)
        port = ports.handles.get(name)
        if port is not None:
            if port is c.port:
                port.accept(None)
            port.hang_up()
    return None


@command("HS")
def _swap_handles(text: str) -> Runner:
    first, found, second = text.partition("=")
    if not found or first not in (*HANDLES, "S") or second not in (*HANDLES, "S"):
        raise CommandError(4)

    def run(c: Context) -> Outcome:
        own = c.port.name if c.port is not None else ""
        one, other = (own if name == "S" else name for name in (first, second))
        if not one or not other:
            raise CommandError(4)
        c.machine.ports.swap(one, other)
        return None

    return run


@command("SA")
def _send_command(text: str) -> Runner:
    handle, found, rest = text.partition("=")
    if not found or handle not in HANDLES or len(handle) != 1:
        raise CommandError(4)
    parts = split(rest)
    if len(parts) > 8 or not rest:
        raise CommandError(50)
    for part in parts:
        compile_expression(part)

    def run(c: Context) -> Outcome:
        if handle not in c.machine.ports.outgoing:
            raise CommandError(126)
        c.machine.response_state[handle] = 4
        return None

    return run


@command("MB")
def _modbus(text: str) -> Runner:
    handle, found, rest = text.partition("=")
    if not found or handle not in HANDLES or len(handle) != 1:
        raise CommandError(4)
    parts = split(rest)
    if len(parts) < 2:
        raise CommandError(50)
    place = 0 if parts[0].startswith("-1") else 1
    function = integer(parts[place])

    def run(c: Context) -> Outcome:
        if function(c) not in (-1, 1, 2, 3, 4, 5, 6, 7, 15, 16, 17):
            raise CommandError(127)
        raise CommandError(126)

    return run


@command("TH")
def _tell_handles(text: str) -> Runner:
    bare(text)

    def run(c: Context) -> Outcome:
        machine = c.machine
        serial = machine.options.serial_number
        lines = [
            f"CONTROLLER IP ADDRESS {address_text(machine.address)} "
            f"ETHERNET ADDRESS 00-20-B5-00-{serial >> 8:02X}-{serial & 255:02X}"
        ]
        for name in machine.model.handles:
            port = machine.ports.handles.get(name)
            peer = machine.ports.outgoing.get(name)
            if port is not None:
                lines.append(f"IH{name} {port.kind.upper()} PORT 23 TO IP ADDRESS 0,0,0,0 PORT 0")
            elif peer is not None:
                kind = "UDP" if peer[2] == -5 else "TCP"
                lines.append(f"IH{name} {kind} PORT 0 TO IP ADDRESS {address_text(peer[0])} PORT {peer[1]}")
            else:
                lines.append(f"IH{name} AVAILABLE")
        written = "\r\n".join(lines)
        return report(c, written)

    return run


@command("WH")
def _which_handle(text: str) -> Runner:
    bare(text)
    return lambda c: report(c, "RS232" if c.port is None or c.port.name == "S" else f"IH{c.port.name}")


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
        c.machine.memory.password = parts[0]
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
