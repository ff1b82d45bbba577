"""How bodies that stand too near to each other are taken apart by one axis."""

from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import RuleCheck

STEPS = 64
"""Of the range of an axis, at which it is tried."""


@dataclass(frozen=True, slots=True)
class Exit:
    """The nearest place of an axis at which a rule holds, as far as the steps show it. way: from where it stands."""

    axis: str
    way: float
    unit: str

    def describe(self) -> str:
        """What to do, in words."""
        direction = "positive" if self.way > 0 else "negative"
        return f"jog {self.axis} by about {abs(self.way):.3g} {self.unit} in the {direction} direction first"


def find_exit(zones: FleetZones, rule: RuleCheck, positions: Mapping[str, float]) -> Exit | None:
    """The shortest way out, by the range of its axis; None: no axis leads out alone. positions: of all axes of the
    rule."""
    margins = zones.margins
    box: Box = {axis: (positions[axis] - margins[axis], positions[axis] + margins[axis]) for axis in positions}
    for number in range(1, STEPS + 1):
        for axis in rule.constraint.axes:
            low, high = zones.ranges[axis]
            for sign in (1, -1):
                position = positions[axis] + sign * (high - low) * number / STEPS
                span = position - margins[axis], position + margins[axis]
                if low <= position <= high and rule.constraint.look({**box, axis: span}).holds:
                    return Exit(axis, position - positions[axis], zones.units[axis])
    return None
