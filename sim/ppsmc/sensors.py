"""Switches along the travel of one axis: limits EL-/EL+, ORG, SD, encoder index."""

import math
from dataclasses import dataclass, field
from enum import Enum


class TravelSwitch(Enum):
    """The inputs that a motion can reach."""

    EL_MINUS = "reverse"
    EL_PLUS = "forward"
    ORG = "org"
    SD = "sd"
    INDEX = "index"


def limit_switch(sign: int) -> TravelSwitch:
    """Return the limit switch at the `sign` end of the travel."""
    return TravelSwitch.EL_PLUS if sign > 0 else TravelSwitch.EL_MINUS


@dataclass(frozen=True, slots=True)
class UntilSwitch:
    """End condition of a motion: `switch` is `on`."""

    switch: TravelSwitch
    on: bool


@dataclass(slots=True)
class TravelSwitches:
    """Zone of each switch, in mechanical positions (motor steps); `held` ones are pressed from outside."""

    zones: dict[TravelSwitch, tuple[float, float]] = field(default_factory=dict[TravelSwitch, tuple[float, float]])
    held: dict[TravelSwitch, bool] = field(default_factory=dict[TravelSwitch, bool])

    def is_on(self, switch: TravelSwitch, place: float) -> bool:
        """Return whether the switch is on with the stage at `place`."""
        if switch in self.held:
            return self.held[switch]
        low, high = self.zones.get(switch, (math.inf, -math.inf))
        return low <= place <= high

    def find_bound(self, until: UntilSwitch, place: float, sign: int) -> float | None:
        """Return where motion from `place` in direction `sign` first reaches `until`, which does not hold at
        `place`."""
        if until.switch in self.held or until.switch not in self.zones:
            return None
        low, high = self.zones[until.switch]
        entry, leave = (low, high + 1) if sign > 0 else (high, low - 1)
        bound = entry if until.on else leave
        return bound if math.isfinite(bound) and sign * (bound - place) >= 0 else None
