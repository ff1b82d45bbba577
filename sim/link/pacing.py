"""One direction of a serial line: bytes arrive when their last bit arrives."""

from collections import deque
from collections.abc import Callable

from orchestrator.clock.base import Clock, ClockTimer
from orchestrator.link.supply import PowerSupply


class PacedLine:
    """Pass bytes on to `deliver`, in order, at most one character every `char_ns`."""

    def __init__(self, clock: Clock, char_ns: int, deliver: Callable[[bytes], None]) -> None:
        self._clock = clock
        self._char_ns = char_ns
        self._deliver = deliver
        self._free_ns = 0
        self._cut = PowerSupply()
        self._next: ClockTimer | None = None
        self._underway: deque[tuple[int, bytes]] = deque()
        self.waiting = 0
        """Bytes that are still on the line."""

    def queue_bytes(self, data: bytes) -> None:
        """Start to transmit, after the bytes that are on the line already."""
        self._free_ns = max(self._free_ns, self._clock.now_ns()) + len(data) * self._char_ns
        self._underway.append((self._free_ns, data))
        self.waiting += len(data)
        if len(self._underway) == 1:
            self._next = self._clock.call_at_ns(self._free_ns, self._deliver_next)

    def queue_lines(self, data: bytes) -> None:
        """Transmit, but deliver each line as a whole at its end: a command takes effect at its own terminator."""
        for line in data.splitlines(keepends=True):
            self.queue_bytes(line)

    def cut_transmission(self, at_ns: int) -> None:
        """Discard bytes that had not left when the sender lost its power, at `at_ns` or earlier."""
        if at_ns <= self._cut.lost_ns:
            return
        self._cut.set_power(on=False, at_ns=at_ns)
        if self._underway and self._next is not None:
            self._next.cancel()
            ends_ns, data = self._underway[0]
            self._underway.clear()
            self.waiting = 0
            data_left = self._cut.cut_sent(data, ends_ns - len(data) * self._char_ns, ends_ns, self._char_ns)
            if data_left:
                self._deliver(data_left)
        self._free_ns = min(self._free_ns, at_ns)

    def _deliver_next(self) -> None:
        _, data = self._underway.popleft()
        self.waiting -= len(data)
        if self._underway:
            self._next = self._clock.call_at_ns(self._underway[0][0], self._deliver_next)
        self._deliver(data)
