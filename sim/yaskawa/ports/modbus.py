"""Modbus over the controller's own handles: packets of MB, and points of I/O devices (L1824-L1898, L7277-L7380)."""

import struct
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.ports.network import ACCEPTED, WAITING, Peer

RAW = -1
FUNCTIONS = (RAW, 1, 2, 3, 4, 5, 6, 7, 15, 16, 17)
READ_COILS, READ_INPUTS, READ_REGISTERS, WRITE_COIL, WRITE_REGISTER = 1, 2, 4, 5, 6
POINTS = 1000
"""Numbers of points of one handle (L1893)."""
_HEADER = struct.Struct(">HHHB")
_COIL_ON = 0xFF00
_FULL_SCALE, _FULL_VOLTS = 0x7FFF, 10.0
_EXCEPTION = 0x80


def request(unit: int, function: int, payload: bytes) -> bytes:
    """A packet of the second level: header of Modbus on TCP, function, what belongs to it."""
    return _HEADER.pack(0, 0, len(payload) + 2, unit) + bytes([function]) + payload


def reply_of(heard: bytes) -> bytes | None:
    """Function and data of a complete reply; None before it is."""
    if len(heard) < _HEADER.size:
        return None
    length = _HEADER.unpack_from(heard)[2]
    return heard[_HEADER.size :] if len(heard) >= _HEADER.size - 1 + length else None


def bits(data: bytes, count: int) -> list[int]:
    """The first `count` bits, lowest first."""
    return [data[number // 8] >> number % 8 & 1 for number in range(min(count, 8 * len(data)))]


def packed(values: list[int]) -> bytes:
    """Bits to bytes, lowest first."""
    count = (len(values) + 7) // 8
    return sum(bool(value) << number for number, value in enumerate(values)).to_bytes(count, "little")


def transact(peer: Peer, packet: bytes, take: Callable[[bytes], None]) -> None:
    """Send a packet of the second level, and let `take` have the data of its reply; an exception is code 121."""

    def taken(heard: bytes) -> bool:
        reply = reply_of(heard)
        if reply is None:
            return False
        if reply[0] & _EXCEPTION:
            peer.machine.fail(121)
        else:
            take(reply[1:])
        return True

    peer.exchange(packet, taken)


class RemotePoints:
    """Points `1000 * handle + number` of devices on own handles; `number` counts from 1 (D53)."""

    def __init__(self, peer_of: Callable[[str], Peer | None], handles: str) -> None:
        self._peer_of = peer_of
        self._handles = handles

    def _place(self, number: int) -> tuple[Peer, int, int]:
        """The device, its slave address (that of the handle), and the point from 0; 126 when the handle is closed."""
        handle, point = divmod(number, POINTS)
        peer = self._peer_of(self._handles[handle - 1]) if 1 <= handle <= len(self._handles) else None
        if peer is None:
            raise CommandError(126)
        return peer, handle, max(point - 1, 0)

    def write(self, number: int, level: bool) -> None:
        """`SB`, `CB`, `OB`."""
        peer, unit, point = self._place(number)
        payload = struct.pack(">HH", point, _COIL_ON if level else 0)
        transact(peer, request(unit, WRITE_COIL, payload), lambda data: None)

    def write_volts(self, number: int, volts: float) -> None:
        """`AO`."""
        peer, unit, point = self._place(number)
        word = round(volts / _FULL_VOLTS * _FULL_SCALE) & 0xFFFF
        transact(peer, request(unit, WRITE_REGISTER, struct.pack(">HH", point, word)), lambda data: None)

    def read(self, number: int, function: int) -> int:
        """`@IN`, `@OUT`: an expression can not wait, so only a device that answers at once can be read."""
        return bits(self._read(number, function), 1)[0]

    def read_volts(self, number: int) -> int:
        """`@AN`, raw."""
        word = struct.unpack(">h", self._read(number, READ_REGISTERS)[:2])[0]
        return fixed.of(word / _FULL_SCALE * _FULL_VOLTS)

    def _read(self, number: int, function: int) -> bytes:
        peer, unit, point = self._place(number)
        found: list[bytes] = []
        transact(peer, request(unit, function, struct.pack(">HH", point, 1)), lambda data: found.append(data[1:]))
        if peer.asked == WAITING or peer.asked != ACCEPTED or not found or not found[0]:
            raise CommandError(121)
        return found[0]
