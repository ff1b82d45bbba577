"""Replies of a controller that answers anything: wrong, cut off, of another exchange or make, too long, or with numbers
that are none.

The replies are changed on the wire, so the controller itself moves as it is commanded.
"""

import re
from collections import deque
from random import Random

from orchestrator.link.can import CanFrame, decode_frames, encode_frames

UNCHANGED_SHARE = 0.3
KEPT_REPLIES = 20  # earlier replies, which are repeated
MAX_REPETITIONS = 400  # of one that is too long

NO_NUMBERS = (b"nan", b"inf", b"-inf", b"1e999", b"9" * 400, b"-", b"0x7f", b"99999999999")

# Valid replies, of any make.
FOREIGN_REPLIES = (
    b":", b"?", b" 0.0000\r\n:", b" 1, 2\r\n:", b"?005 \r\n", b"OK\r\n", b"NG\r\n", b"0,0,K,K,R\r\n",
    b"-4,2\r\n", b"1\r\n", b"E4y\r", b"v1.0\r", b">", b"#1\r", b"\x00", b"\x1a", b"\r\n",
)  # fmt: skip

# Identifiers of CANopen by function: emergency, process data, replies to service data, heartbeat.
FUNCTIONS = (0x080, 0x180, 0x280, 0x380, 0x480, 0x580, 0x700)


class ArbitraryReplies:
    """Changes replies; each change is drawn."""

    def __init__(self, draw: Random) -> None:
        self._draw = draw
        self._earlier: deque[bytes] = deque(maxlen=KEPT_REPLIES)
        self._earlier_frames: deque[CanFrame] = deque(maxlen=KEPT_REPLIES)

    def change_bytes(self, data: bytes) -> bytes:
        """Return what arrives instead of the bytes of a line or connection."""
        draw = self._draw
        self._earlier.append(data)
        if draw.random() < UNCHANGED_SHARE or not data:
            return data
        match draw.randrange(7):
            case 0:
                return draw.randbytes(draw.randint(1, 2 * len(data)))
            case 1:
                return data[: draw.randrange(len(data))]
            case 2:
                return draw.choice(self._earlier)
            case 3:
                return draw.choice(FOREIGN_REPLIES)
            case 4:
                return re.sub(rb"[0-9][0-9.]*", lambda _: draw.choice(NO_NUMBERS), data)
            case 5:
                return re.sub(rb"[0-9]", lambda _: b"%d" % draw.randrange(10), data)
            case _:
                return data * draw.randint(2, MAX_REPETITIONS)

    def change_frames(self, data: bytes) -> bytes:
        """Return what arrives instead of frames of a CAN bus: they are always whole ones."""
        changed_frames = [new_frame for frame in decode_frames(data) for new_frame in self._change_frame(frame)]
        return encode_frames(*changed_frames)

    def _change_frame(self, frame: CanFrame) -> list[CanFrame]:
        draw = self._draw
        self._earlier_frames.append(frame)
        if draw.random() < UNCHANGED_SHARE:
            return [frame]
        match draw.randrange(6):
            case 0:
                return [CanFrame(frame.id, draw.randbytes(len(frame.data)))]
            case 1:
                return [CanFrame(frame.id, frame.data[: draw.randrange(len(frame.data) + 1)])]
            case 2:
                return [draw.choice(self._earlier_frames)]
            case 3:
                return [CanFrame(draw.choice(FUNCTIONS) + (frame.id & 0x7F), draw.randbytes(draw.randrange(9)))]
            case 4:
                return [CanFrame(frame.id, draw.choice((b"\x00", b"\xff")) * 8)]
            case _:
                return [frame] * draw.randint(0, 20)
