"""Lines on the serial port (decisions 1 and 5) and the destination of answers."""

from collections.abc import Callable
from dataclasses import dataclass, field

Reply = Callable[[str], None]
"""Receives one reply line, without its terminator."""

_NUL = 0
_CR = 13
_LF = 10
_FIRST_NON_ASCII = 128


@dataclass(frozen=True, slots=True)
class ReceivedLine:
    """One received line.

    clean: neither NUL nor non-ASCII bytes in it (L237).
    whole: not over-long."""

    text: str
    clean: bool
    whole: bool


@dataclass(slots=True)
class SerialLineReader:
    """Splits the bytes of one port into lines. A line ends with LF, or CR LF; with `cr_only`, with CR.

    There is no inter-character timeout: a partial line waits for its other part.
    """

    limit: int
    cr_only: bool
    _pending: bytearray = field(default_factory=bytearray)

    def read_lines(self, data: bytes) -> list[ReceivedLine]:
        """Return the lines that `data` completes. Empty ones are dropped."""
        end = _CR if self.cr_only else _LF
        lines: list[ReceivedLine] = []
        *complete, tail = data.split(bytes((end,)))
        for piece in complete:
            self._append_piece(piece)
            line = bytes(self._pending)
            self._pending.clear()
            line = line.removeprefix(b"\n") if self.cr_only else line.removesuffix(b"\r")
            if line:
                clean = not any(byte == _NUL or byte >= _FIRST_NON_ASCII for byte in line)
                lines.append(ReceivedLine(line.decode("latin-1"), clean, len(line) <= self.limit))
        self._append_piece(tail)
        return lines

    def discard_partial(self) -> None:
        """Discard a partial line."""
        self._pending.clear()

    def _append_piece(self, piece: bytes) -> None:
        room = self.limit + 2 - len(self._pending)
        self._pending += piece[: max(0, room)]
        # Characters above the limit are not needed, but whether they spoil the line is.
        if len(piece) > room and any(byte == _NUL or byte >= _FIRST_NON_ASCII for byte in piece[max(0, room) :]):
            self._pending[0] = _NUL
