"""General-purpose inputs and outputs, and waiting for an input pattern.

The controller scans its inputs every millisecond of its own time (decision 43) and compares all six at once. A scan is
scheduled only while an awaited pattern is present: only then can the next scan matter.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_MS, ClockTimer
from sim.core.devicetime import DeviceTime

LINES = 6
"""IN1-IN6 and OUT1-OUT6 (L5270-L5357)."""


def bit_mask(number: int) -> int:
    """Return the mask of input or output `number` (L5274)."""
    if not 1 <= number <= LINES:
        raise ValueError(f"there is no general-purpose input or output {number}; they are 1 to {LINES}")
    return 1 << (number - 1)


@dataclass(slots=True)
class InputScanner:
    """The six inputs.

    phase_ns: device time of the first scan, below 1 ms."""

    time: DeviceTime
    phase_ns: int = 0
    value: int = 0
    _waits: dict[object, tuple[int, Callable[[int], None]]] = field(
        default_factory=dict[object, tuple[int, Callable[[int], None]]]
    )
    _timer: ClockTimer | None = None

    def set_level(self, number: int, *, level: bool) -> None:
        mask = bit_mask(number)
        self.value = self.value | mask if level else self.value & ~mask
        self._arm_scan()

    def wait_for_pattern(self, owner: object, pattern: int, released: Callable[[int], None]) -> None:
        """Call `released` with the device instant of the first scan that sees `pattern` (0-63)."""
        self._waits[owner] = (pattern, released)
        self._arm_scan()

    def cancel_wait(self, owner: object) -> None:
        self._waits.pop(owner, None)

    def _arm_scan(self) -> None:
        if self._timer is None and any(pattern == self.value for pattern, _ in self._waits.values()):
            scans = -(-(self.time.now_ns() - self.phase_ns) // NS_PER_MS)
            at_ns = self.phase_ns + scans * NS_PER_MS
            self._timer = self.time.call_at(at_ns, lambda: self._run_scan(at_ns))

    def _run_scan(self, at_ns: int) -> None:
        self._timer = None
        waiters = [
            (waiter, released_wait) for waiter, (pattern, released_wait) in self._waits.items() if pattern == self.value
        ]
        for owner, _ in waiters:
            del self._waits[owner]
        for _, release in waiters:
            release(at_ns)


@dataclass(slots=True)
class OutputLevels:
    """The six outputs; they stay until changed (L5359)."""

    value: int = 0
    listeners: list[Callable[[int, bool], None]] = field(default_factory=list[Callable[[int, bool], None]])

    def set_levels(self, value: int) -> None:
        changes, self.value = self.value ^ value, value
        for number in range(1, LINES + 1):
            if changes & bit_mask(number):
                for listener in self.listeners:
                    listener(number, bool(value & bit_mask(number)))
