"""What a program waits for by time."""

from collections.abc import Callable

from orchestrator.clock.base import Timer
from sim.core.devicetime import DeviceTime


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
