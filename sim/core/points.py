"""Digital inputs and outputs behind their isolation: a change takes effect after a delay."""

from dataclasses import dataclass
from typing import Protocol

from orchestrator.clock.base import Clock, ClockTimer


class LevelListener(Protocol):
    """Called at each effect of a change."""

    def __call__(self, number: int, *, level: bool) -> None: ...


@dataclass(frozen=True, slots=True)
class PointIsolation:
    """An optocoupler or a filter: delays of a rising and a falling level, true ns."""

    clock: Clock
    rise_ns: int = 0
    fall_ns: int = 0


class DelayedLevels:
    """Levels by number. A change takes effect when it has lasted for its delay; a shorter one is never seen.

    initial: level of all before any change. changed: called at each effect, with number and level.
    """

    def __init__(self, isolation: PointIsolation, *, initial: bool, changed: LevelListener) -> None:
        self._isolation = isolation
        self._initial = initial
        self._changed = changed
        self._levels: dict[int, bool] = {}
        self._pending: dict[int, ClockTimer] = {}

    def level(self, number: int) -> bool:
        """Return the level behind the isolation."""
        return self._levels.get(number, self._initial)

    def change_level(self, number: int, *, level: bool) -> None:
        """Change the level before the isolation."""
        pending = self._pending.pop(number, None)
        if pending is not None:
            pending.cancel()
        if level == self.level(number):
            return
        delay_ns = self._isolation.rise_ns if level else self._isolation.fall_ns
        if not delay_ns:
            self._take_effect(number, level=level)
            return
        clock = self._isolation.clock
        self._pending[number] = clock.call_at_ns(
            clock.now_ns() + delay_ns, lambda: self._take_effect(number, level=level)
        )

    def _take_effect(self, number: int, *, level: bool) -> None:
        self._pending.pop(number, None)
        self._levels[number] = level
        self._changed(number, level=level)
