"""Lines on a connection: ended by CR, with or without LF (L198)."""

from dataclasses import dataclass, field

_CR = b"\r"


@dataclass(frozen=True, slots=True)
class CommandLine:
    """One received line; `whole` unless it was longer than the limit."""

    text: str
    whole: bool


@dataclass(slots=True)
class LineReader:
    """Cuts bytes into lines. LF never ends a line and is dropped; half a line waits for its other half."""

    limit: int
    _pending: bytearray = field(default_factory=bytearray)

    def lines(self, data: bytes) -> list[CommandLine]:
        """Lines that `data` completes."""
        found: list[CommandLine] = []
        *complete, rest = data.replace(b"\n", b"").split(_CR)
        for piece in complete:
            self._keep(piece)
            text = self._pending.decode("latin-1")
            self._pending.clear()
            found.append(CommandLine(text, len(text) <= self.limit))
        self._keep(rest)
        return found

    def clear(self) -> None:
        """Forget half a line."""
        self._pending.clear()

    def _keep(self, piece: bytes) -> None:
        # One byte over the limit is enough to know.
        self._pending += piece[: max(0, self.limit + 1 - len(self._pending))]
