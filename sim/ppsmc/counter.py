"""The pulse counter 9000.07: counts of intervals, and of the time until something stops it."""

from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_S, Timer
from sim.core.devicetime import DeviceTime


@dataclass(slots=True)
class Counter:
    """Counts pulses of a steady source, `rate_hz`, and keeps the results (L3885-L3975)."""

    time: DeviceTime
    rate_hz: float
    memory: list[int] = field(default_factory=list[int])
    last: int = 0
    _since_ns: int | None = None
    _timer: Timer | None = None

    @property
    def counting(self) -> bool:
        return self._since_ns is not None

    def begin(self) -> None:
        """Count until `stop`."""
        self._since_ns = self.time.now_ns()

    def count(self, interval_ns: int, done: Callable[[int], None]) -> None:
        """Count for an interval, then hand over the result."""
        self.begin()
        self._timer = self.time.call_after(interval_ns, lambda: done(self.stop()))

    def stop(self) -> int:
        """End the count; the result is stored."""
        since_ns = self._since_ns
        self.cancel()
        if since_ns is not None:
            self.last = round((self.time.now_ns() - since_ns) / NS_PER_S * self.rate_hz)
            self.memory.append(self.last)
        return self.last

    def cancel(self) -> None:
        """Forget a count that runs."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._since_ns = None

    def clear(self) -> None:
        """ccnt (L1437)."""
        self.memory.clear()
        self.last = 0
