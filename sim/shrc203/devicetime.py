"""The unit's own time: nanoseconds of its crystal, and calls at an instant of it."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock, Timer
from sim.core.oscillator import Oscillator

_FAR_NS = 600_000_000_000
_RATE_SPAN_NS = 100_000_000


class _FarTimer:
    """A call too far ahead to be worth converting to true time now: goes there in strides."""

    def __init__(self, time: "DeviceTime", at_ns: int, callback: Callable[[], None]) -> None:
        self._time = time
        self._at_ns = at_ns
        self._callback = callback
        self._timer: Timer
        self._stride()

    def _stride(self) -> None:
        now_ns = self._time.now_ns()
        if self._at_ns - now_ns > _FAR_NS:
            self._timer = self._time.direct(now_ns + _FAR_NS, self._stride)
        else:
            self._timer = self._time.direct(self._at_ns, self._callback)

    def cancel(self) -> None:
        self._timer.cancel()


@dataclass(frozen=True, slots=True)
class DeviceTime:
    """Device time of one unit. All instants here are device nanoseconds unless they are called true."""

    clock: Clock
    oscillator: Oscillator

    def now_ns(self) -> int:
        return self.oscillator.device_ns(self.clock.now_ns())

    def true_ns(self, at_ns: int) -> int:
        """The true instant of device instant `at_ns`."""
        return self.oscillator.true_ns(at_ns)

    def direct(self, at_ns: int, callback: Callable[[], None]) -> Timer:
        """Call back at device instant `at_ns`, not far ahead."""
        return self.clock.call_at_ns(self.oscillator.true_ns(at_ns), callback)

    def call_at(self, at_ns: int, callback: Callable[[], None]) -> Timer:
        """Call back at device instant `at_ns`, however far ahead."""
        if at_ns - self.now_ns() > _FAR_NS:
            return _FarTimer(self, at_ns, callback)
        return self.direct(at_ns, callback)

    def rate(self) -> float:
        """Device seconds per true second, now."""
        now_ns = self.clock.now_ns()
        oscillator = self.oscillator
        return (oscillator.device_ns(now_ns + _RATE_SPAN_NS) - oscillator.device_ns(now_ns)) / _RATE_SPAN_NS
