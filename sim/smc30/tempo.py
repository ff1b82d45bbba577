"""Timer of a program."""

from collections.abc import Callable

from orchestrator.clock.base import ClockTimer
from sim.core.devicetime import DeviceTime


class PausableTimer:
    """The single timer of a program: its next line, a delay, or a start latency. The Stop input pauses it."""

    def __init__(self, time: DeviceTime) -> None:
        self.time = time
        self._timer: ClockTimer | None = None
        self._callback: Callable[[], None] | None = None
        self._due_ns = 0
        self._left_ns = 0
        self.halted = False

    def call_after(self, delay_ns: int, callback: Callable[[], None]) -> None:
        """Call back after `delay_ns` of device time, not counting paused time."""
        self._callback = callback
        self._left_ns = delay_ns
        if not self.halted:
            self._arm_timer()

    def cancel_call(self) -> None:
        self._callback = None
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def pause_timer(self) -> None:
        self.halted = True
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
            self._left_ns = max(0, self._due_ns - self.time.now_ns())

    def resume_timer(self) -> None:
        self.halted = False
        if self._callback is not None:
            self._arm_timer()

    def _arm_timer(self) -> None:
        self._due_ns = self.time.now_ns() + self._left_ns
        self._timer = self.time.call_at(self._due_ns, self._handle_due)

    def _handle_due(self) -> None:
        self._timer = None
        callback, self._callback = self._callback, None
        if callback is not None:
            callback()
