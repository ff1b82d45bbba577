"""One direction of a serial line: bytes arrive when their last bit would have."""

from collections import deque
from collections.abc import Callable

from orchestrator.clock.base import Clock


class PacedLine:
    """Hands bytes on to `deliver`, in order, one character every `char_ns` at the most."""

    def __init__(self, clock: Clock, char_ns: int, deliver: Callable[[bytes], None]) -> None:
        self._clock = clock
        self._char_ns = char_ns
        self._deliver = deliver
        self._free_ns = 0
        self._underway: deque[tuple[int, bytes]] = deque()
        self.waiting = 0
        """Bytes that are still on the line."""

    def put(self, data: bytes) -> None:
        """Start to transmit, behind what is on the line already."""
        self._free_ns = max(self._free_ns, self._clock.now_ns()) + len(data) * self._char_ns
        self._underway.append((self._free_ns, data))
        self.waiting += len(data)
        if len(self._underway) == 1:
            self._clock.call_at_ns(self._free_ns, self._arrive)

    def put_lines(self, data: bytes) -> None:
        """The same, with each line arriving at its own end: a command takes effect at its own terminator."""
        for line in data.splitlines(keepends=True):
            self.put(line)

    def _arrive(self) -> None:
        _, data = self._underway.popleft()
        self.waiting -= len(data)
        if self._underway:
            self._clock.call_at_ns(self._underway[0][0], self._arrive)
        self._deliver(data)
