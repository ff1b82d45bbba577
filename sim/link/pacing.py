"""One direction of a serial line: bytes arrive when their last bit would have."""

from collections import deque
from collections.abc import Callable

from orchestrator.clock.base import Clock, Timer
from orchestrator.link.supply import Supply


class PacedLine:
    """Hands bytes on to `deliver`, in order, one character every `char_ns` at the most."""

    def __init__(self, clock: Clock, char_ns: int, deliver: Callable[[bytes], None]) -> None:
        self._clock = clock
        self._char_ns = char_ns
        self._deliver = deliver
        self._free_ns = 0
        self._cut = Supply()
        self._next: Timer | None = None
        self._underway: deque[tuple[int, bytes]] = deque()
        self.waiting = 0
        """Bytes that are still on the line."""

    def put(self, data: bytes) -> None:
        """Start to transmit, behind what is on the line already."""
        self._free_ns = max(self._free_ns, self._clock.now_ns()) + len(data) * self._char_ns
        self._underway.append((self._free_ns, data))
        self.waiting += len(data)
        if len(self._underway) == 1:
            self._next = self._clock.call_at_ns(self._free_ns, self._arrive)

    def put_lines(self, data: bytes) -> None:
        """The same, with each line arriving at its own end: a command takes effect at its own terminator."""
        for line in data.splitlines(keepends=True):
            self.put(line)

    def fell_silent(self, at_ns: int) -> None:
        """The sender has lost its power at `at_ns`, or longer ago: what had not left by then never does."""
        if at_ns <= self._cut.lost_ns:
            return
        self._cut.switched(False, at_ns)
        if self._underway and self._next is not None:
            self._next.cancel()
            ends_ns, data = self._underway[0]
            self._underway.clear()
            self.waiting = 0
            left = self._cut.left(data, ends_ns - len(data) * self._char_ns, ends_ns, self._char_ns)
            if left:
                self._deliver(left)
        self._free_ns = min(self._free_ns, at_ns)

    def _arrive(self) -> None:
        _, data = self._underway.popleft()
        self.waiting -= len(data)
        if self._underway:
            self._next = self._clock.call_at_ns(self._underway[0][0], self._arrive)
        self._deliver(data)
