"""The unit's own time: nanoseconds of its crystal, and calls at an instant of it."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock, Timer
from sim.core.oscillator import Oscillator

_STRIDE_NS = 600_000_000_000
_RATE_SPAN_NS = 100_000_000


class _FarTimer:
    """A call too far ahead for a wandering crystal to be followed now: goes there in strides."""

    def __init__(self, time: "DeviceTime", at_ns: int, callback: Callable[[], None]) -> None:
        self._time = time
        self._at_ns = at_ns
        self._callback = callback
        self._timer: Timer
        self._stride()

    def _stride(self) -> None:
        now_ns = self._time.now_ns()
        far = self._at_ns - now_ns > _STRIDE_NS
        at_ns = now_ns + _STRIDE_NS if far else self._at_ns
        self._timer = self._time.clock.call_at_ns(self._time.true_ns(at_ns), self._stride if far else self._callback)

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

    def call_at(self, at_ns: int, callback: Callable[[], None]) -> Timer:
        """Call back at device instant `at_ns`."""
        if at_ns - self.now_ns() > _STRIDE_NS:
            return _FarTimer(self, at_ns, callback)
        return self.clock.call_at_ns(self.true_ns(at_ns), callback)

    def call_after(self, delay_ns: int, callback: Callable[[], None]) -> Timer:
        """Call back `delay_ns` of device time from now."""
        return self.call_at(self.now_ns() + delay_ns, callback)

    def rate(self) -> float:
        """Device seconds per true second, now."""
        now_ns = self.clock.now_ns()
        oscillator = self.oscillator
        return (oscillator.device_ns(now_ns + _RATE_SPAN_NS) - oscillator.device_ns(now_ns)) / _RATE_SPAN_NS
