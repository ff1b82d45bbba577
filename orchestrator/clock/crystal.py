"""The clock of one computer in virtual time: its crystal is not that of the others."""

from collections.abc import Callable
from contextvars import Context

from orchestrator.clock.base import ClockTimer
from orchestrator.clock.virtual import VirtualClock

PPB = 1_000_000_000


class ComputerClock:
    """The `Clock` of a computer: begun `offset_ns` before virtual time did, and `rate_ppm` faster than it. Both are
    exact to parts per billion.

    Other computers do not know either. `step_clock` is what a suspension does, or a virtual machine that is moved.
    """

    def __init__(self, true: VirtualClock, computer: str, offset_ns: int = 0, rate_ppm: float = 0.0) -> None:
        self._true = true
        self._computer = computer
        self._offset_ns = offset_ns
        self._ppb = round(rate_ppm * 1000)

    @property
    def kernel_id(self) -> str:
        return f"virtual-{self._computer}"

    def step_clock(self, step_ns: int) -> None:
        """Set the clock forward by `step_ns`, or back. Timers that run keep their true instants."""
        self._offset_ns += step_ns

    def now_ns(self) -> int:
        return self._at_true_ns(self._true.now_ns())

    def utc(self) -> str:
        return self._true.utc()

    def call_at_ns(
        self, at_ns: int, callback: Callable[[], None], leeway_ns: int = 0, context: Context | None = None
    ) -> ClockTimer:
        true_ns = (at_ns - self._offset_ns) * PPB // (PPB + self._ppb)
        while self._at_true_ns(true_ns) < at_ns:
            true_ns += 1
        return self._true.call_at_ns(true_ns, callback, leeway_ns, context)

    def _at_true_ns(self, true_ns: int) -> int:
        return self._offset_ns + true_ns + true_ns * self._ppb // PPB
