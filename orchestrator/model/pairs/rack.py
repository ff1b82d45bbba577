"""How far the two motors of an axis may be apart.

A motor that stops dead, because it is blocked or off or no longer coupled, is left behind by the other one. The watch
sees that at the first reading behind `watched`, the deviation that is allowed; at most `REACTION_S` later the stop
acts, and the axis brakes by its ramp. Until then the other motor goes on at speed v, and then by v²/2a, with a its
deceleration: they are at most

    watched + v · REACTION_S + v² / 2a

apart. That holds for a motor that is switched off, too: it is seen earlier, by the state of the motor. A stop, an
e-stop, and the loss of a link or a host stop both motors by one ramp.
"""

from dataclasses import dataclass
from math import sqrt

WATCH_HZ = 50.0
"""How often a controller with an axis of two motors is read at least while it moves."""
STOP_S = 0.02
"""From the instant for which a reading holds until the stop that it causes acts; a make must not need more."""
REACTION_S = 1 / WATCH_HZ + STOP_S
DEFAULT_RATIO = 2.0
"""`may_rack` in `max_deviation`, where the fleet file does not state it: the first contains the second."""


@dataclass(frozen=True, slots=True)
class MotorRack:
    """Two motors of one axis; all lengths in its unit. watched: the largest deviation without a reaction. most: the
    largest one after a single fault."""

    watched: float
    most: float

    @classmethod
    def of(cls, max_deviation: float, following_error: float | None, may_rack: float | None) -> "MotorRack":
        """By the fields of an axis. The other motor may be behind its command by `following_error` and catch up."""
        return cls(max_deviation + (following_error or 0.0), may_rack or DEFAULT_RATIO * max_deviation)

    def at_speed(self, speed: float, ramp: float) -> float:
        """How far they may be apart after a single fault at `speed` (unit/s), with stops by `ramp` (unit/s²)."""
        return self.watched + speed * REACTION_S + speed * speed / (2 * ramp)

    def fastest(self, ramp: float) -> float:
        """The highest speed, unit/s, at which that is at most `most`."""
        lag = ramp * REACTION_S
        return sqrt(lag * lag + 2 * ramp * (self.most - self.watched)) - lag
