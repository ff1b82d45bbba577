"""General-purpose inputs and outputs, and waiting for an input pattern.

The unit scans its inputs every millisecond of its own time (decision 43) and compares all six at once. No scan
is scheduled unless the pattern that somebody waits for is there: only then can the next one matter.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_MS, Timer
from sim.core.devicetime import DeviceTime

LINES = 6
"""IN1-IN6 and OUT1-OUT6 (L5270-L5357)."""


def bit(number: int) -> int:
    """The mask of input or output `number` (L5274)."""
    if not 1 <= number <= LINES:
        raise ValueError(f"there is no general-purpose line {number}; they are 1 to {LINES}")
    return 1 << (number - 1)


@dataclass(slots=True)
class Inputs:
    """The six inputs. `phase_ns`: device time of the first scan, below 1 ms."""

    time: DeviceTime
    phase_ns: int = 0
    value: int = 0
    _waits: dict[object, tuple[int, Callable[[int], None]]] = field(
        default_factory=dict[object, tuple[int, Callable[[int], None]]]
    )
    _timer: Timer | None = None

    def set(self, number: int, level: bool) -> None:
        mask = bit(number)
        self.value = self.value | mask if level else self.value & ~mask
        self._arm()

    def wait(self, who: object, pattern: int, released: Callable[[int], None]) -> None:
        """Call `released` with the device instant of the first scan that sees `pattern` (0-63)."""
        self._waits[who] = (pattern, released)
        self._arm()

    def forget(self, who: object) -> None:
        self._waits.pop(who, None)

    def _arm(self) -> None:
        if self._timer is None and any(pattern == self.value for pattern, _ in self._waits.values()):
            scans = -(-(self.time.now_ns() - self.phase_ns) // NS_PER_MS)
            at_ns = self.phase_ns + scans * NS_PER_MS
            self._timer = self.time.call_at(at_ns, lambda: self._scan(at_ns))

    def _scan(self, at_ns: int) -> None:
        self._timer = None
        seen = [(who, released) for who, (pattern, released) in self._waits.items() if pattern == self.value]
        for who, _ in seen:
            del self._waits[who]
        for _, released in seen:
            released(at_ns)


@dataclass(slots=True)
class Outputs:
    """The six outputs; they hold until changed (L5359)."""

    value: int = 0
    listeners: list[Callable[[int, bool], None]] = field(default_factory=list[Callable[[int, bool], None]])

    def set(self, value: int) -> None:
        changed, self.value = self.value ^ value, value
        for number in range(1, LINES + 1):
            if changed & bit(number):
                for listener in self.listeners:
                    listener(number, bool(value & bit(number)))
