"""Ethernet: addresses and handles, commands to other controllers, Modbus (L5635-L5946, L7277-L7380, L9738-L9783)."""

import struct
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.data import array_name
from sim.yaskawa.commands.status import report
from sim.yaskawa.commands.system import HANDLES
from sim.yaskawa.language.arguments import parse_fields, split, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import compile_expression, integer
from sim.yaskawa.language.registry import Outcome, Runner, bare, command
from sim.yaskawa.motion.trippoints import when
from sim.yaskawa.ports.modbus import FUNCTIONS, RAW, bits, packed, request, transact
from sim.yaskawa.ports.network import FIELDS, TCP, UDP, WAITING, Peer
from sim.yaskawa.ports.ports import address_text


@command("IA", lock="1")
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
        peer = ports.outgoing[handle] = Peer(c.machine, handle, address, number, UDP if session == UDP else TCP)
        peer.open()
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
        peer = ports.outgoing.pop(name, None)
        if peer is not None:
            peer.close()
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


Field = Callable[[Context], str]


def _send_field(text: str) -> Field:
    """A string as it stands, a number without padding (L9751-L9757)."""
    if text.startswith('"'):
        if len(text) < 2 or not text.endswith('"') or len(text) - 2 > fixed.STRING_LENGTH:
            raise CommandError(52)
        return lambda c: text[1:-1]
    value = compile_expression(text)
    return lambda c: _plain(value(c))


def _plain(raw: int) -> str:
    return f"{raw / fixed.ONE:.4f}".rstrip("0").rstrip(".")


@command("SA")
def _send_command(text: str) -> Runner:
    """`SAh="KI",2`: the first field, and behind it the others, separated by commas (L1796-L1806)."""
    handle, found, rest = text.partition("=")
    if not found or handle not in HANDLES or len(handle) != 1:
        raise CommandError(4)
    parts = split(rest)
    if len(parts) > FIELDS or not rest:
        raise CommandError(50)
    fields = [_send_field(part) for part in parts]

    def run(c: Context) -> Outcome:
        first, *others = [field(c) for field in fields]
        _peer(c, handle).ask(first + ",".join(others))
        return None

    return run


def _peer(c: Context, handle: str) -> Peer:
    peer = c.machine.ports.outgoing.get(handle)
    if peer is None:
        raise CommandError(126)
    return peer


@command("MB")
def _modbus(text: str) -> Runner:
    """A packet to a Modbus device (L7296-L7332); held until it has answered, unless MW is 0 (L7739)."""
    handle, found, rest = text.partition("=")
    if not found or handle not in HANDLES or len(handle) != 1:
        raise CommandError(4)
    parts = split(rest)
    name = array_name(parts.pop()) if parts[-1].endswith("]") else ""
    if not parts or not all(parts):
        raise CommandError(50)
    numbers = [integer(part) for part in parts]

    def run(c: Context) -> Outcome:
        given = [number(c) for number in numbers]
        if given[0] == RAW:
            given.insert(0, HANDLES.index(handle) + 1)
        if len(given) < 2:
            raise CommandError(50)
        if given[1] not in FUNCTIONS:
            raise CommandError(127)
        peer = _peer(c, handle)
        _transmit(peer, given, c.machine.data.array(name) if name else [])
        if not c.machine.modbus_wait:
            return None
        return when(lambda machine, now: peer.asked != WAITING)

    return run


def _transmit(peer: Peer, given: list[int], array: list[int]) -> None:
    """Make the packet of a function from its numbers, and put what comes back into the array."""
    unit, function, *numbers = given
    words = [fixed.truncated(raw) for raw in array]
    if len(numbers) != NUMBERS[function]:
        raise CommandError(50)
    start, count = [*numbers, 0, 0][:2]
    if function == RAW:
        peer.exchange(bytes(word & 0xFF for word in words[:start]), lambda heard: _store(array, list(heard)))
        return
    payload = struct.pack(">HH", start & 0xFFFF, count & 0xFFFF) if numbers else b""
    if function == 5:
        payload = struct.pack(">HH", start & 0xFFFF, 0xFF00 if count else 0)
    elif function == 15:
        data = packed(words[:count])
        payload += bytes([len(data)]) + data
    elif function == 16:
        payload += bytes([2 * count]) + b"".join(struct.pack(">H", word & 0xFFFF) for word in words[:count])

    def take(data: bytes) -> None:
        if function in (1, 2):
            _store(array, bits(data[1:], count))
        elif function in (3, 4):
            _store(array, [word for (word,) in struct.iter_unpack(">H", data[1 : 1 + len(data[1:]) // 2 * 2])])
        elif function in (7, 17):
            _store(array, list(data))

    transact(peer, request(unit & 0xFF, function, payload), take)


def _store(array: list[int], values: list[int]) -> bool:
    for index, value in enumerate(values[: len(array)]):
        array[index] = fixed.whole(value)
    return True


NUMBERS = {RAW: 1, 1: 2, 2: 2, 3: 2, 4: 2, 5: 2, 6: 2, 7: 0, 15: 2, 16: 2, 17: 0}
"""Numbers behind the function; the array is not among them."""


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
                kind = "UDP" if peer.kind == UDP else "TCP"
                lines.append(f"IH{name} {kind} PORT 0 TO IP ADDRESS {address_text(peer.address)} PORT {peer.number}")
            else:
                lines.append(f"IH{name} AVAILABLE")
        written = "\r\n".join(lines)
        return report(c, written)

    return run


@command("WH")
def _which_handle(text: str) -> Runner:
    bare(text)
    return lambda c: report(c, "RS232" if c.port is None or c.port.name == "S" else f"IH{c.port.name}")
