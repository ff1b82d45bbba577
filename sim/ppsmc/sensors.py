"""Switches along the travel of one axis: limits EL-/EL+, ORG, SD, encoder index."""

import math
from dataclasses import dataclass, field
from enum import Enum


class Switch(Enum):
    """The inputs that motion can run onto."""

    EL_MINUS = "reverse"
    EL_PLUS = "forward"
    ORG = "org"
    SD = "sd"
    INDEX = "index"


def limit_of(sign: int) -> Switch:
    """The limit switch at the `sign` end of the travel."""
    return Switch.EL_PLUS if sign > 0 else Switch.EL_MINUS


@dataclass(frozen=True, slots=True)
class Until:
    """A motion is to end as soon as `switch` is `on`."""

    switch: Switch
    on: bool


@dataclass(slots=True)
class Switches:
    """Where each switch is on, in mechanical positions (motor steps); `held` ones are pressed from outside."""

    zones: dict[Switch, tuple[float, float]] = field(default_factory=dict[Switch, tuple[float, float]])
    held: dict[Switch, bool] = field(default_factory=dict[Switch, bool])

    def on(self, switch: Switch, place: float) -> bool:
        """Whether the switch is on with the stage at `place`."""
        if switch in self.held:
            return self.held[switch]
        low, high = self.zones.get(switch, (math.inf, -math.inf))
        return low <= place <= high

    def bound(self, until: Until, place: float, sign: int) -> float | None:
        """Where motion from `place` in direction `sign` first meets `until`, which does not hold at `place`."""
        if until.switch in self.held or until.switch not in self.zones:
            return None
        low, high = self.zones[until.switch]
        entry, leave = (low, high + 1) if sign > 0 else (high, low - 1)
        bound = entry if until.on else leave
        return bound if math.isfinite(bound) and sign * (bound - place) >= 0 else None
