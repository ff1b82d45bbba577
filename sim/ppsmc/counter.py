"""The pulse counter 9000.07: counts over intervals, and from a start to a stop."""

from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_S, ClockTimer
from sim.core.devicetime import DeviceTime


@dataclass(slots=True)
class PulseCounter:
    """Counts pulses of a steady source, `rate_hz`, and keeps the results (L3885-L3975)."""

    time: DeviceTime
    rate_hz: float
    memory: list[int] = field(default_factory=list[int])
    last: int = 0
    _since_ns: int | None = None
    _timer: ClockTimer | None = None

    @property
    def is_counting(self) -> bool:
        return self._since_ns is not None

    def begin_count(self) -> None:
        """Count until `stop_count`."""
        self._since_ns = self.time.now_ns()

    def count_interval(self, interval_ns: int, done: Callable[[int], None]) -> None:
        """Count for an interval, then pass on the result."""
        self.begin_count()
        self._timer = self.time.call_after(interval_ns, lambda: done(self.stop_count()))

    def stop_count(self) -> int:
        """End the count; the result is stored."""
        since_ns = self._since_ns
        self.cancel_count()
        if since_ns is not None:
            self.last = round((self.time.now_ns() - since_ns) / NS_PER_S * self.rate_hz)
            self.memory.append(self.last)
        return self.last

    def cancel_count(self) -> None:
        """Discard a running count."""
        if self._timer is not None:
            self._timer.cancel()
        self._timer = self._since_ns = None

    def clear_memory(self) -> None:
        """ccnt (L1437)."""
        self.memory.clear()
        self.last = 0
