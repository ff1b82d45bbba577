"""CAN frames over a link.

A link to a CAN bus is a `Link` like any other: its bytes are whole frames, each in the 16 bytes of SocketCAN's
`struct can_frame` (identifier with its flags, length, three bytes of padding, eight of data). So whatever works on
bytes (the firing process, a guardian's stop, the trace, faults on a wire) works on frames. `CanLink` is the
interface in frames.
"""

import struct
from collections import deque
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

from orchestrator.link.base import Link

FRAME_BYTES = 16

# Flags in the identifier of a `struct can_frame`, as linux/can.h has them.
_EXTENDED = 0x8000_0000
_REMOTE = 0x4000_0000
_ERROR = 0x2000_0000
_STANDARD_MASK = 0x7FF
_EXTENDED_MASK = 0x1FFF_FFFF

# Classes of error frames: bits of their identifier, as linux/can/error.h has them.
ERROR_PASSIVE = 0x004
"""The CAN controller of this end has become error passive, or is no longer (data[1] tells which)."""
ERROR_NO_ACKNOWLEDGE = 0x020
"""No node on the bus has acknowledged a frame of this end."""
ERROR_BUS_OFF = 0x040
"""The CAN controller of this end has left the bus; nothing is sent until it is restarted."""
ERROR_ON_BUS = 0x080
"""A frame on the bus was destroyed."""
ERROR_RESTARTED = 0x100
"""The CAN controller of this end is back on the bus. Frames that waited to be sent have been discarded."""

# Bits of a frame that can be stuffed (SOF to the end of the CRC, without data), and the bits after them that cannot
# (CRC delimiter, acknowledge slot and delimiter, end of frame, intermission).
STUFFED_BITS = 34
STUFFED_BITS_EXTENDED = 54
FIXED_BITS = 13
INTERMISSION_BITS = 3


@dataclass(frozen=True, slots=True)
class CanFrame:
    """One frame. id: 11 bits, 29 if `extended`. rtr: it requests data; `data` then has the requested length, and its
    content is meaningless. error: it was never on the bus: the CAN controller of this end reports an error, `id`
    names it (`ERROR_…`)."""

    id: int
    data: bytes = b""
    extended: bool = False
    rtr: bool = False
    error: bool = False

    def __post_init__(self) -> None:
        most = _EXTENDED_MASK if self.extended or self.error else _STANDARD_MASK
        if not 0 <= self.id <= most:
            raise ValueError(f"CAN identifier {self.id:#x} is not within 0 to {most:#x}")
        if len(self.data) > 8:
            raise ValueError(f"a CAN frame carries up to 8 bytes, not {len(self.data)}")

    def __str__(self) -> str:
        """In candump's notation: `201#0F00`."""
        name = f"{self.id | _ERROR:08X}" if self.error else f"{self.id:08X}" if self.extended else f"{self.id:03X}"
        return f"{name}#" + (f"R{len(self.data)}" if self.rtr else self.data.hex().upper())


class CanReceived(NamedTuple):
    """A received frame. at_ns: host time when it was read from the operating system."""

    frame: CanFrame
    at_ns: int


def encode_frames(*frames: CanFrame) -> bytes:
    """Encode frames for a link; also for a `TimedWriter` and a make's `stop_bytes`."""
    return b"".join(map(_encode_frame, frames))


@lru_cache(maxsize=4096)
def _encode_frame(frame: CanFrame) -> bytes:
    flags = _EXTENDED * frame.extended | _REMOTE * frame.rtr | _ERROR * frame.error
    return struct.pack("<IB3x8s", frame.id | flags, len(frame.data), frame.data)


def decode_frames(data: bytes) -> list[CanFrame]:
    """Decode the whole frames of `data`. Raises `ValueError` if it is not a multiple of 16 bytes, or not a frame."""
    if len(data) % FRAME_BYTES:
        raise ValueError(f"{len(data)} bytes are not whole CAN frames of {FRAME_BYTES} bytes")
    return [_decode_frame(data[at : at + FRAME_BYTES]) for at in range(0, len(data), FRAME_BYTES)]


@lru_cache(maxsize=4096)
def _decode_frame(data: bytes) -> CanFrame:
    """Cached, because drives at rest repeat the same few frames."""
    word, length, payload = struct.unpack("<IB3x8s", data)
    return CanFrame(
        id=word & _EXTENDED_MASK,
        data=payload[:length],
        extended=bool(word & _EXTENDED),
        rtr=bool(word & _REMOTE),
        error=bool(word & _ERROR),
    )


class FrameReader:
    """Cuts a stream of bytes into frames."""

    def __init__(self) -> None:
        self._rest = b""

    def add_bytes(self, data: bytes) -> list[CanFrame]:
        """Add `data` and return the frames that are complete."""
        self._rest += data
        size = len(self._rest) // FRAME_BYTES * FRAME_BYTES
        frames, self._rest = decode_frames(self._rest[:size]), self._rest[size:]
        return frames


def longest_bits(frame: CanFrame) -> int:
    """Bits of `frame` on the bus with the maximum of stuff bits, and the intermission after it."""
    stuffed_bits = (STUFFED_BITS_EXTENDED if frame.extended else STUFFED_BITS) + (
        0 if frame.rtr else 8 * len(frame.data)
    )
    return stuffed_bits + (stuffed_bits - 1) // 4 + FIXED_BITS


def frame_ns(frame: CanFrame, bitrate: int) -> int:
    """The maximum time of `frame` on a bus of `bitrate` bits/s, with the intermission after it, ns."""
    return -(-longest_bits(frame) * 1_000_000_000 // bitrate)


class CanLink:
    """One open connection to one CAN bus, in frames: `CanLink(await setup.open_link(), setup.config.link.bitrate)`."""

    def __init__(self, link: Link, bitrate: int) -> None:
        self._link = link
        self._bitrate = bitrate
        self._reader = FrameReader()
        self._received: deque[CanReceived] = deque()

    @property
    def endpoint(self) -> str:
        return self._link.endpoint

    @property
    def bitrate(self) -> int:
        """Bits per second."""
        return self._bitrate

    @property
    def byte_link(self) -> Link:
        """The link in bytes, for a `TimedWriter`, which writes `encode_frames(frame)` to it."""
        return self._link

    def frame_ns(self, frame: CanFrame) -> int:
        """The maximum time of `frame` on this bus, ns."""
        return frame_ns(frame, self._bitrate)

    def send_frames(self, *frames: CanFrame) -> int:
        """Pass frames to the CAN controller of this end, in order, without blocking. Returns the host time just
        before.

        It sends each as soon as the bus is free and no frame with a lower identifier waits, and repeats it until it
        is acknowledged. Raises `LinkClosed`.
        """
        return self._link.write(encode_frames(*frames))

    async def read_frame(self) -> CanReceived:
        """Wait for a frame of another node, or an error frame of this end. Raises `LinkClosed`."""
        while not self._received:
            received_bytes = await self._link.read()
            self._received.extend(
                CanReceived(frame, received_bytes.at_ns) for frame in self._reader.add_bytes(received_bytes.data)
            )
        return self._received.popleft()

    async def close(self) -> None:
        """Close; a waiting `read` raises `LinkClosed`. Safe to call twice."""
        await self._link.close()
