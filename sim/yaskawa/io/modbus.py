"""Modbus over the controller's own handles: packets of MB, and points of I/O devices (L1824-L1898, L7277-L7380)."""

import struct
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.io.network import ACCEPTED, WAITING, PeerHandle

RAW = -1
FUNCTIONS = (RAW, 1, 2, 3, 4, 5, 6, 7, 15, 16, 17)
READ_COILS, READ_INPUTS, READ_REGISTERS, WRITE_COIL, WRITE_REGISTER = 1, 2, 4, 5, 6
POINTS = 1000
"""Point numbers of one handle (L1893)."""
_HEADER = struct.Struct(">HHHB")
_COIL_ON = 0xFF00
_FULL_SCALE, _FULL_VOLTS = 0x7FFF, 10.0
_EXCEPTION = 0x80


def build_request(unit: int, function: int, payload: bytes) -> bytes:
    """Build a packet of the second level: header of Modbus on TCP, function, and its payload."""
    return _HEADER.pack(0, 0, len(payload) + 2, unit) + bytes([function]) + payload


def parse_reply(received: bytes) -> bytes | None:
    """Return function and data of a complete reply; None before it is complete."""
    if len(received) < _HEADER.size:
        return None
    length = _HEADER.unpack_from(received)[2]
    return received[_HEADER.size :] if len(received) >= _HEADER.size - 1 + length else None


def unpack_bits(data: bytes, count: int) -> list[int]:
    """Return the first `count` bits, lowest first."""
    return [data[number // 8] >> number % 8 & 1 for number in range(min(count, 8 * len(data)))]


def pack_bits(values: list[int]) -> bytes:
    """Pack bits into bytes, lowest first."""
    count = (len(values) + 7) // 8
    return sum(bool(value) << number for number, value in enumerate(values)).to_bytes(count, "little")


def send_request(peer: PeerHandle, packet: bytes, take: Callable[[bytes], None]) -> None:
    """Send a packet of the second level, and pass the data of its reply to `take`; an exception is code 121."""

    def handle_reply(received: bytes) -> bool:
        reply = parse_reply(received)
        if reply is None:
            return False
        if reply[0] & _EXCEPTION:
            peer.machine.refuse_command(121)
        else:
            take(reply[1:])
        return True

    peer.send_packet(packet, handle_reply)


class RemotePoints:
    """Points `1000 * handle + number` of devices on own handles; `number` counts from 1 (D53)."""

    def __init__(self, peer_of: Callable[[str], PeerHandle | None], handles: str) -> None:
        self._peer_of = peer_of
        self._handles = handles

    def _locate_point(self, number: int) -> tuple[PeerHandle, int, int]:
        """Return the device, its slave address (that of the handle), and the point from 0; 126 when the handle is
        closed."""
        handle, point = divmod(number, POINTS)
        peer = self._peer_of(self._handles[handle - 1]) if 1 <= handle <= len(self._handles) else None
        if peer is None:
            raise CommandError(126)
        return peer, handle, max(point - 1, 0)

    def write_point(self, number: int, *, level: bool) -> None:
        """`SB`, `CB`, `OB`."""
        peer, unit, point = self._locate_point(number)
        payload = struct.pack(">HH", point, _COIL_ON if level else 0)
        send_request(peer, build_request(unit, WRITE_COIL, payload), lambda data: None)

    def write_volts(self, number: int, volts: float) -> None:
        """`AO`."""
        peer, unit, point = self._locate_point(number)
        word = round(volts / _FULL_VOLTS * _FULL_SCALE) & 0xFFFF
        send_request(peer, build_request(unit, WRITE_REGISTER, struct.pack(">HH", point, word)), lambda data: None)

    def read_point(self, number: int, function: int) -> int:
        """`@IN`, `@OUT`: an expression cannot wait, so only a device that answers at once can be read."""
        return unpack_bits(self._read_reply(number, function), 1)[0]

    def read_volts(self, number: int) -> int:
        """`@AN`, raw."""
        word = struct.unpack(">h", self._read_reply(number, READ_REGISTERS)[:2])[0]
        return fixed.from_real(word / _FULL_SCALE * _FULL_VOLTS)

    def _read_reply(self, number: int, function: int) -> bytes:
        peer, unit, point = self._locate_point(number)
        registers: list[bytes] = []
        send_request(
            peer, build_request(unit, function, struct.pack(">HH", point, 1)), lambda data: registers.append(data[1:])
        )
        if peer.send_state == WAITING or peer.send_state != ACCEPTED or not registers or not registers[0]:
            raise CommandError(121)
        return registers[0]
