"""Where the bodies of keep-out zones are by truth: by the positions of simulators, with what is behind their motors."""

from collections.abc import Iterator, Mapping

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.names import split_name
from orchestrator.plan.zones.clearance import PairClearance, RelationConstraint
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import RuleCheck
from orchestrator.plan.zones.watch import find_closing_speed
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.mechanics import interpolate

TRUTH = 0.02
"""mm: rounding to counts, and what two homings of an axis differ by."""
NO_ERRORS = [[0.0, 0.0]]
_SAMPLE_NS = 8 * NS_PER_MS
_OVERSPEED = 1.5  # of the limits, at most


class ZoneTruth:
    """The true distances of one fleet. nearest: by rule, how much farther than it must be a body was at least, mm; of a
    relation, how far a position was from its end, in its unit; below 0: the rule was broken. nearest_ns: when, host ns.

    Made while the positions of all axes are known to their controllers: what they lose later changes nothing of it.
    """

    def __init__(self, fleet: VirtualFleet) -> None:
        self.nearest: dict[str, float] = {}
        self.nearest_ns: dict[str, int] = {}
        self._fleet = fleet
        zones = FleetZones(fleet.fleet)
        speeds = {axis: _OVERSPEED * fleet.fleet.axis(axis).limits.velocity for axis in zones.ranges}
        self._rules = {check: _find_closing_speed(check, zones, speeds) for check in zones.rules}
        self._zeros = {axis: self._find_motor(axis) - self._find_counter(axis) for axis in zones.ranges}

    def _find_motor(self, axis: str) -> float:
        controller, motor, scale = self._find_simulator(axis)
        return self._fleet.controllers[controller].physical_position(motor) / scale

    def _find_counter(self, axis: str) -> float:
        controller, motor, scale = self._find_simulator(axis)
        return self._fleet.controllers[controller].position(motor) / scale

    def _find_simulator(self, axis: str) -> tuple[str, str, float]:
        """Of an axis: its controller, its motor, and the counts of a unit."""
        config = self._fleet.fleet.axis(axis)
        return split_name(axis)[0], config.motors[0], float(config.counts_per_unit)

    def _find_place(self, axis: str) -> float:
        """Where an axis is, in its unit, from its reference."""
        controller, local = split_name(axis)
        position = self._find_motor(axis) - self._zeros[axis]
        mechanics = self._fleet.fleet.controllers[controller].simulate.mechanics.get(local)
        return position if mechanics is None else position + interpolate(mechanics.errors or NO_ERRORS, position)

    def find_gaps(self) -> Iterator[tuple[RuleCheck, float]]:
        """By how much each rule is kept now, as in `nearest`."""
        positions = {axis: self._find_place(axis) for axis in self._zeros}
        for check in self._rules:
            match check.constraint:
                case PairClearance() as pair:
                    yield check, pair.find_distance(positions)[1] - pair.distance
                case RelationConstraint() as relation:
                    yield check, -relation.find_depth(positions)
                case _:
                    pass

    async def watch(self) -> None:
        """Look again as soon as a rule can have come nearer to its end than it was at least; until cancelled."""
        while True:
            now_ns, free_s = self._fleet.clock.now_ns(), [1.0]
            for check, gap in self.find_gaps():
                if gap < self.nearest.get(check.name, gap + 1.0):
                    self.nearest[check.name], self.nearest_ns[check.name] = gap, now_ns
                free_s.append((gap - self.nearest[check.name]) / self._rules[check])
            await sleep_ns(self._fleet.clock, max(_SAMPLE_NS, round(min(free_s) * NS_PER_S)))


def _find_closing_speed(check: RuleCheck, zones: FleetZones, speeds: Mapping[str, float]) -> float:
    """How fast a rule comes nearer to its end at most, mm/s or units of the axes of a relation."""
    if isinstance(check.constraint, PairClearance):
        return find_closing_speed(check.constraint, zones.ranges, speeds)
    return sum(speeds[axis] for axis in check.constraint.axes)
