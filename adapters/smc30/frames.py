"""Command and reply frames: `[address] command [checksum] CR` sent, `reply [checksum] CR` received (L1014-L1087,
L1504-L1573)."""

from collections.abc import Iterator
from dataclasses import dataclass

CR = 13
_LONGEST = 400  # characters without an end: garbage


@dataclass(frozen=True, slots=True)
class ReceivedReply:
    """One received line; text is None when parity, checksum or an unexpected character show that it is garbled.

    at_ns: host time when its end was taken from the operating system. characters: its length, with checksum and CR.
    """

    text: str | None
    at_ns: int
    characters: int


def line_checksum(data: bytes) -> int:
    """Return the sum of the character codes modulo 128, sent as one character (L1066-L1081)."""
    return sum(data) % 128


def frame_line(text: str, address: int | None, *, with_checksum: bool) -> bytes:
    """Return the frame of `text` for the controller with this address; None: a controller without address."""
    data = f"{'' if address is None else address}{text}".encode("ascii")
    return data + (bytes((line_checksum(data),)) if with_checksum else b"") + b"\r"


class ReplyReader:
    """Split received bytes into replies. A checksum that is itself a CR is followed by the CR that ends its line."""

    def __init__(self, *, with_checksum: bool) -> None:
        self._with_checksum = with_checksum
        self._rest = b""
        self._held: bytes | None = None

    def clear(self) -> None:
        self._rest, self._held = b"", None

    def feed_bytes(self, data: bytes, at_ns: int) -> Iterator[ReceivedReply]:
        """Yield the replies that `data` completes."""
        *pieces, self._rest = (self._rest + data).split(b"\r")
        for piece in pieces:
            yield from self._parse_line(piece, at_ns)
        if len(self._rest) > _LONGEST:
            self._rest = b""
            yield ReceivedReply(None, at_ns, _LONGEST)

    def _parse_line(self, piece: bytes, at_ns: int) -> Iterator[ReceivedReply]:
        held_line, self._held = self._held, None
        if held_line is not None:
            is_whole = not piece
            yield ReceivedReply(_printable_text(held_line) if is_whole else None, at_ns, len(held_line) + 2)
            if is_whole:
                return
        piece = piece.lstrip(b"\n\0") if not self._with_checksum else piece
        if not piece:
            return
        if not self._with_checksum:
            yield ReceivedReply(_printable_text(piece), at_ns, len(piece) + 1)
        elif len(piece) > 1 and piece[-1] == line_checksum(piece[:-1]):
            yield ReceivedReply(_printable_text(piece[:-1]), at_ns, len(piece) + 1)
        elif line_checksum(piece) == CR:
            self._held = piece
        else:
            yield ReceivedReply(None, at_ns, len(piece) + 1)


def _printable_text(data: bytes) -> str | None:
    """Return a line of printable characters, without blanks; None for anything else."""
    if not data.isascii():
        return None
    text = data.decode("ascii")
    return text.replace(" ", "") if text.isprintable() else None
