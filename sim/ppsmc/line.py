"""Lines on a connection: ended by CR, with or without LF (L198)."""

from dataclasses import dataclass, field

_CR = b"\r"


@dataclass(frozen=True, slots=True)
class ClientLine:
    """One received line.

    whole: not longer than the limit."""

    text: str
    whole: bool


@dataclass(slots=True)
class ClientLineReader:
    """Splits bytes into lines. LF never ends a line and is dropped; a partial line waits for its other part."""

    limit: int
    _pending: bytearray = field(default_factory=bytearray)

    def read_lines(self, data: bytes) -> list[ClientLine]:
        """Return the lines that `data` completes."""
        lines: list[ClientLine] = []
        *complete, tail = data.replace(b"\n", b"").split(_CR)
        for piece in complete:
            self._append_piece(piece)
            text = self._pending.decode("latin-1")
            self._pending.clear()
            lines.append(ClientLine(text, len(text) <= self.limit))
        self._append_piece(tail)
        return lines

    def discard_partial(self) -> None:
        """Discard a partial line."""
        self._pending.clear()

    def _append_piece(self, piece: bytes) -> None:
        # One byte above the limit is enough to detect it.
        self._pending += piece[: max(0, self.limit + 1 - len(self._pending))]
