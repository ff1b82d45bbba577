"""A unit's own time: nanoseconds of its crystal, and calls at an instant of it."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock, Timer
from sim.core.oscillator import Oscillator

_STRIDE_NS = 600_000_000_000
_RATE_SPAN_NS = 100_000_000


class _FarTimer:
    """A call more than a stride ahead: goes there in strides.

    A wandering crystal is computed second by second up to the instant asked for. Motions and programs set calls that
    may be years ahead and are mostly cancelled long before; asking for their true instants now would compute, and
    keep, all those seconds.
    """

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
    """Device time of one unit, in nanoseconds of its crystal. Every instant here is of that time unless called true.

    clock: true time. oscillator: the unit's crystal against it.
    """

    clock: Clock
    oscillator: Oscillator

    def now_ns(self) -> int:
        """The present device instant."""
        return self.oscillator.device_ns(self.clock.now_ns())

    def true_ns(self, at_ns: int) -> int:
        """The true instant of device instant `at_ns`, which should not be far ahead."""
        return self.oscillator.true_ns(at_ns)

    def call_at(self, at_ns: int, callback: Callable[[], None]) -> Timer:
        """Call back at device instant `at_ns`, however far ahead."""
        if at_ns - self.now_ns() > _STRIDE_NS:
            return _FarTimer(self, at_ns, callback)
        return self.clock.call_at_ns(self.true_ns(at_ns), callback)

    def call_after(self, delay_ns: int, callback: Callable[[], None]) -> Timer:
        """Call back `delay_ns` of device time from now, however long that is."""
        return self.call_at(self.now_ns() + delay_ns, callback)

    def rate(self) -> float:
        """Device seconds per true second, now."""
        now_ns = self.clock.now_ns()
        oscillator = self.oscillator
        return (oscillator.device_ns(now_ns + _RATE_SPAN_NS) - oscillator.device_ns(now_ns)) / _RATE_SPAN_NS
