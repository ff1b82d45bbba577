"""Timers of one node, by name, and its counter of microseconds."""

from collections.abc import Callable

from orchestrator.clock.base import NS_PER_US, ClockTimer
from sim.core.devicetime import DeviceTime


class NodeTimers:
    """Timers that a restart of the node cancels."""

    def __init__(self, time: DeviceTime) -> None:
        self._time = time
        self._timers: dict[str, ClockTimer] = {}

    def call_later(self, name: str, after_ns: int, callback: Callable[[], None]) -> None:
        """Call back unless this node is restarted before, or the timer of this name is set again."""
        old = self._timers.pop(name, None)
        if old is not None:
            old.cancel()
        self._timers[name] = self._time.call_after(after_ns, callback)

    def cancel_timer(self, name: str) -> None:
        """Cancel the timer of this name, if there is one."""
        timer = self._timers.pop(name, None)
        if timer is not None:
            timer.cancel()

    def cancel_all(self) -> None:
        """Cancel all timers."""
        for timer in self._timers.values():
            timer.cancel()
        self._timers.clear()

    def is_set(self, name: str) -> bool:
        """Return whether the timer of this name is set."""
        return name in self._timers


class MicrosecondCounter:
    """Object 0x1013: 32 bits, which a client can set."""

    def __init__(self, time: DeviceTime) -> None:
        self._time = time
        self._ahead = 0

    def read_counter(self) -> int:
        """Return the microseconds now."""
        return (self._time.now_ns() // NS_PER_US + self._ahead) % (1 << 32)

    def set_counter(self, value: int) -> None:
        """Count on from `value`."""
        self._ahead = value - self._time.now_ns() // NS_PER_US
