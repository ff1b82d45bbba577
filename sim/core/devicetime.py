"""Local time of a device: nanoseconds of its crystal, and timers on that time."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import Clock, ClockTimer
from sim.core.oscillator import Oscillator

_STRIDE_NS = 600_000_000_000
_RATE_SPAN_NS = 100_000_000


class _FarTimer:
    """A timer more than a stride ahead, reached in strides.

    A wandering crystal is computed second by second up to the instant requested. Motions and programs set timers that
    may be years ahead and are usually cancelled long before; their true instants, computed now, would cost and keep all
    those seconds.
    """

    def __init__(self, time: "DeviceTime", at_ns: int, callback: Callable[[], None]) -> None:
        self._time = time
        self._at_ns = at_ns
        self._callback = callback
        self._timer: ClockTimer
        self._advance_stride()

    def _advance_stride(self) -> None:
        now_ns = self._time.now_ns()
        is_far = self._at_ns - now_ns > _STRIDE_NS
        at_ns = now_ns + _STRIDE_NS if is_far else self._at_ns
        self._timer = self._time.clock.call_at_ns(
            self._time.true_ns(at_ns), self._advance_stride if is_far else self._callback
        )

    def cancel(self) -> None:
        self._timer.cancel()


@dataclass(frozen=True, slots=True)
class DeviceTime:
    """Local time of one device, in nanoseconds of its crystal. Every instant here is local unless called true.

    clock: true time.
    oscillator: the device's crystal relative to it.
    """

    clock: Clock
    oscillator: Oscillator

    def now_ns(self) -> int:
        """Current device time."""
        return self.oscillator.device_ns(self.clock.now_ns())

    def true_ns(self, at_ns: int) -> int:
        """Convert device instant `at_ns`, which should not be far ahead, to true time."""
        return self.oscillator.true_ns(at_ns)

    def call_at(self, at_ns: int, callback: Callable[[], None]) -> ClockTimer:
        """Call back at device instant `at_ns`, however far ahead."""
        if at_ns - self.now_ns() > _STRIDE_NS:
            return _FarTimer(self, at_ns, callback)
        return self.clock.call_at_ns(self.true_ns(at_ns), callback)

    def call_after(self, delay_ns: int, callback: Callable[[], None]) -> ClockTimer:
        """Call back after `delay_ns` of device time, of any length."""
        return self.call_at(self.now_ns() + delay_ns, callback)

    def clock_rate(self) -> float:
        """Current rate in device seconds per true second."""
        now_ns = self.clock.now_ns()
        oscillator = self.oscillator
        return (oscillator.device_ns(now_ns + _RATE_SPAN_NS) - oscillator.device_ns(now_ns)) / _RATE_SPAN_NS
