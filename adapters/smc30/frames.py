"""Lines on the wire: `[address] command [checksum] CR` out, `reply [checksum] CR` back (L1014-L1087, L1504-L1573)."""

from collections.abc import Iterator
from dataclasses import dataclass

CR = 13
_LONGEST = 400  # characters without an end: garbage


@dataclass(frozen=True, slots=True)
class Reply:
    """One line as it came; text is None when parity, checksum or a strange character show that it is garbled.

    at_ns: host time when its end was taken from the operating system. characters: of it, with checksum and CR.
    """

    text: str | None
    at_ns: int
    characters: int


def checksum(data: bytes) -> int:
    """Sum of the character codes modulo 128, sent as one character (L1066-L1081)."""
    return sum(data) % 128


def line(text: str, unit: int | None, with_checksum: bool) -> bytes:
    """`text` for the unit with this address; None: one that has none."""
    data = f"{'' if unit is None else unit}{text}".encode("ascii")
    return data + (bytes((checksum(data),)) if with_checksum else b"") + b"\r"


class ReplyReader:
    """Cuts what comes into replies. A checksum that is itself a CR is followed by the CR that ends its line."""

    def __init__(self, with_checksum: bool) -> None:
        self._with_checksum = with_checksum
        self._rest = b""
        self._held: bytes | None = None

    def clear(self) -> None:
        self._rest, self._held = b"", None

    def feed(self, data: bytes, at_ns: int) -> Iterator[Reply]:
        """The replies that `data` completes."""
        *pieces, self._rest = (self._rest + data).split(b"\r")
        for piece in pieces:
            yield from self._whole(piece, at_ns)
        if len(self._rest) > _LONGEST:
            self._rest = b""
            yield Reply(None, at_ns, _LONGEST)

    def _whole(self, piece: bytes, at_ns: int) -> Iterator[Reply]:
        held, self._held = self._held, None
        if held is not None:
            whole = not piece
            yield Reply(_text(held) if whole else None, at_ns, len(held) + 2)
            if whole:
                return
        piece = piece.lstrip(b"\n\0") if not self._with_checksum else piece
        if not piece:
            return
        if not self._with_checksum:
            yield Reply(_text(piece), at_ns, len(piece) + 1)
        elif len(piece) > 1 and piece[-1] == checksum(piece[:-1]):
            yield Reply(_text(piece[:-1]), at_ns, len(piece) + 1)
        elif checksum(piece) == CR:
            self._held = piece
        else:
            yield Reply(None, at_ns, len(piece) + 1)


def _text(data: bytes) -> str | None:
    """A line of printable characters, without blanks; None for anything else."""
    if not data.isascii():
        return None
    text = data.decode("ascii")
    return text.replace(" ", "") if text.isprintable() else None
