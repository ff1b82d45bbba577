"""Ethernet: addresses and handles, commands to other controllers, Modbus (L5635-L5946, L7277-L7380, L9738-L9783)."""

import struct
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.data import array_name
from sim.yaskawa.commands.status import report_text
from sim.yaskawa.commands.system import HANDLES
from sim.yaskawa.io.modbus import FUNCTIONS, RAW, build_request, pack_bits, send_request, unpack_bits
from sim.yaskawa.io.network import FIELDS, TCP, UDP, WAITING, PeerHandle
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.expressions import compile_expression, compile_integer
from sim.yaskawa.language.registry import Outcome, Runner, register_command, require_bare
from sim.yaskawa.motion.trippoints import when_passed
from sim.yaskawa.ports.ports import address_text


@register_command("IA", lock="1")
def _compile_address(text: str) -> Runner:
    if text == "?":
        return lambda c: address_text(c.machine.address)
    head, retry_given, retry_text = text.partition("<")
    retry = compile_integer(retry_text) if retry_given else None
    number = int(head) if head.isdecimal() and int(head) < 1 << 32 else None
    fields = compile_values(parse_fields(head)) if head and number is None else None

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        if c.port is not None and c.port.kind != "serial":
            raise CommandError(1)
        if machine.motion.is_active():
            raise CommandError(7)
        if number is not None:
            machine.address = fixed.wrap_counts(number)
        if fields is not None:
            machine.address = _parse_address([raw for raw in fields(c) if raw is not None])
        if retry is not None:
            time = retry(c)
            if not 0 <= time <= 2147483647:
                raise CommandError(6)
            machine.retry_time = time
        return None

    return run_command


def _parse_address(given: list[int]) -> int:
    numbers = [fixed.to_integer(raw) for raw in given]
    if len(numbers) == 1:
        return fixed.wrap_counts(numbers[0])
    if len(numbers) != 4:
        raise CommandError(50)
    if any(not 0 <= number <= 255 for number in numbers):
        raise CommandError(6)
    return fixed.wrap_counts(int.from_bytes(bytes(numbers), "big"))


@register_command("IH")
def _compile_internet_handle(text: str) -> Runner:
    handle, mark, tail = text.partition("=")
    if not mark or handle not in (*HANDLES, "S", "T"):
        raise CommandError(4)
    if tail.startswith(">"):
        value = compile_integer(tail[1:])
        return lambda c: _close_handle(c, handle, value(c))
    if handle in ("S", "T"):
        raise CommandError(4)
    head, kind_given, kind_text = tail.partition(">")
    head, port_given, port_text = head.partition("<")
    kind = compile_integer(kind_text) if kind_given else None
    port = compile_integer(port_text) if port_given else None
    fields = compile_values(parse_fields(head))

    def run_command(c: CommandContext) -> Outcome:
        ports = c.machine.ports
        if handle in ports.handles or handle in ports.outgoing:
            raise CommandError(124)
        address = _parse_address([raw for raw in fields(c) if raw is not None])
        number = port(c) if port is not None else 502
        session = kind(c) if kind is not None else 2
        if not 0 <= number <= 65535 or not 0 <= session <= 2:
            raise CommandError(6)
        peer = ports.outgoing[handle] = PeerHandle(c.machine, handle, address, number, UDP if session == UDP else TCP)
        peer.open_handle()
        return None

    return run_command


def _close_handle(c: CommandContext, handle: str, mode: int) -> Outcome:
    ports = c.machine.ports
    if mode not in (-1, -2):
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
            peer.close_handle()
        port = ports.handles.get(name)
        if port is not None:
            if port is c.port:
                port.accept_command(None)
            port.close_from_controller()
    return None


@register_command("HS")
def _compile_swap_handles(text: str) -> Runner:
    first, mark, second = text.partition("=")
    if not mark or first not in (*HANDLES, "S") or second not in (*HANDLES, "S"):
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        own = c.port.name if c.port is not None else ""
        first_handle, second_handle = (own if name == "S" else name for name in (first, second))
        if not first_handle or not second_handle:
            raise CommandError(4)
        c.machine.ports.swap_handles(first_handle, second_handle)
        return None

    return run_command


Field = Callable[[CommandContext], str]


def _send_field(text: str) -> Field:
    """Parse a field: a string is sent as it is, a number without padding (L9751-L9757)."""
    if text.startswith('"'):
        if len(text) < 2 or not text.endswith('"') or len(text) - 2 > fixed.STRING_LENGTH:
            raise CommandError(52)
        return lambda c: text[1:-1]
    value = compile_expression(text)
    return lambda c: _format_plain(value(c))


def _format_plain(raw: int) -> str:
    return f"{raw / fixed.ONE:.4f}".rstrip("0").rstrip(".")


@register_command("SA")
def _compile_send_command(text: str) -> Runner:
    """`SAh="KI",2`: the first field, followed by the others, separated by commas (L1796-L1806)."""
    handle, mark, tail = text.partition("=")
    if not mark or handle not in HANDLES or len(handle) != 1:
        raise CommandError(4)
    parts = split_fields(tail)
    if len(parts) > FIELDS or not tail:
        raise CommandError(50)
    fields = [_send_field(part) for part in parts]

    def run_command(c: CommandContext) -> Outcome:
        first, *texts = [field(c) for field in fields]
        _find_peer(c, handle).send_command(first + ",".join(texts))
        return None

    return run_command


def _find_peer(c: CommandContext, handle: str) -> PeerHandle:
    peer = c.machine.ports.outgoing.get(handle)
    if peer is None:
        raise CommandError(126)
    return peer


@register_command("MB")
def _compile_modbus(text: str) -> Runner:
    """Send a packet to a Modbus device (L7296-L7332); the command waits for the answer, unless MW is 0 (L7739)."""
    handle, mark, tail = text.partition("=")
    if not mark or handle not in HANDLES or len(handle) != 1:
        raise CommandError(4)
    parts = split_fields(tail)
    name = array_name(parts.pop()) if parts[-1].endswith("]") else ""
    if not parts or not all(parts):
        raise CommandError(50)
    numbers = [compile_integer(part) for part in parts]

    def run_command(c: CommandContext) -> Outcome:
        values = [number(c) for number in numbers]
        if values[0] == RAW:
            values.insert(0, HANDLES.index(handle) + 1)
        if len(values) < 2:
            raise CommandError(50)
        if values[1] not in FUNCTIONS:
            raise CommandError(127)
        peer = _find_peer(c, handle)
        _transmit_modbus(peer, values, c.machine.data.get_array(name) if name else [])
        if not c.machine.modbus_wait:
            return None
        return when_passed(lambda machine, sample: peer.send_state != WAITING)

    return run_command


def _transmit_modbus(peer: PeerHandle, given: list[int], array: list[int]) -> None:
    """Build the packet of a function from its numbers, and store the reply in the array."""
    unit, function, *numbers = given
    words = [fixed.to_integer(raw) for raw in array]
    if len(numbers) != NUMBERS[function]:
        raise CommandError(50)
    start, count = [*numbers, 0, 0][:2]
    if function == RAW:
        peer.send_packet(bytes(word & 0xFF for word in words[:start]), lambda reply: _store_values(array, list(reply)))
        return
    payload = struct.pack(">HH", start & 0xFFFF, count & 0xFFFF) if numbers else b""
    if function == 5:
        payload = struct.pack(">HH", start & 0xFFFF, 0xFF00 if count else 0)
    elif function == 15:
        data = pack_bits(words[:count])
        payload += bytes([len(data)]) + data
    elif function == 16:
        payload += bytes([2 * count]) + b"".join(struct.pack(">H", word & 0xFFFF) for word in words[:count])

    def store_reply(data: bytes) -> None:
        if function in (1, 2):
            _store_values(array, unpack_bits(data[1:], count))
        elif function in (3, 4):
            _store_values(array, [word for (word,) in struct.iter_unpack(">H", data[1 : 1 + len(data[1:]) // 2 * 2])])
        elif function in (7, 17):
            _store_values(array, list(data))

    send_request(peer, build_request(unit & 0xFF, function, payload), store_reply)


def _store_values(array: list[int], values: list[int]) -> bool:
    for index, value in enumerate(values[: len(array)]):
        array[index] = fixed.from_integer(value)
    return True


NUMBERS = {RAW: 1, 1: 2, 2: 2, 3: 2, 4: 2, 5: 2, 6: 2, 7: 0, 15: 2, 16: 2, 17: 0}
"""Numbers after the function; the array is not among them."""


@register_command("TH")
def _compile_tell_handles(text: str) -> Runner:
    require_bare(text)

    def run_command(c: CommandContext) -> Outcome:
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
                host, number = port.host
                lines.append(f"IH{name} {port.kind.upper()} PORT 23 TO IP ADDRESS {address_text(host)} PORT {number}")
            elif peer is not None:
                kind = "UDP" if peer.kind == UDP else "TCP"
                lines.append(f"IH{name} {kind} PORT 0 TO IP ADDRESS {address_text(peer.address)} PORT {peer.number}")
            else:
                lines.append(f"IH{name} AVAILABLE")
        message = "\r\n".join(lines)
        return report_text(c, message)

    return run_command


@register_command("WH")
def _compile_which_handle(text: str) -> Runner:
    require_bare(text)
    return lambda c: report_text(c, "RS232" if c.port is None or c.port.name == "S" else f"IH{c.port.name}")
