"""A unit's own time: nanoseconds of its crystal, and calls at an instant of it."""

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

    def true_ns(self) -> int:
        """The present true instant."""
        return self.clock.now_ns()

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


class Tempo:
    """The one thing a program waits for by time: its next line, a delay, a start latency. The Stop input halts it."""

    def __init__(self, time: DeviceTime) -> None:
        self._time = time
        self._timer: Timer | None = None
        self._callback: Callable[[], None] | None = None
        self._due_ns = 0
        self._left_ns = 0
        self.halted = False

    def after(self, delay_ns: int, callback: Callable[[], None]) -> None:
        """Call back when `delay_ns` of device time have passed that were not halted."""
        self._callback = callback
        self._left_ns = delay_ns
        if not self.halted:
            self._arm()

    def cancel(self) -> None:
        self._callback = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def halt(self) -> None:
        self.halted = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
            self._left_ns = max(0, self._due_ns - self._time.now_ns())

    def resume(self) -> None:
        self.halted = False
        if self._callback is not None:
            self._arm()

    def _arm(self) -> None:
        self._due_ns = self._time.now_ns() + self._left_ns
        self._timer = self._time.call_at(self._due_ns, self._due)

    def _due(self) -> None:
        self._timer = None
        callback, self._callback = self._callback, None
        if callback is not None:
            callback()
