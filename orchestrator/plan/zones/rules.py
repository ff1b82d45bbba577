"""The rules of a fleet file, and whether a step keeps them."""

from collections.abc import Iterator

from orchestrator.model.fleet import Fleet
from orchestrator.model.units import Unit, parse_quantity
from orchestrator.model.zone_fields import LEAST_DISTANCE, Vector, ZoneRule, find_relation_axis, read_relation
from orchestrator.model.zone_problems import find_range, list_zone_axes
from orchestrator.plan.zones.chain import Body, make_body, resolve_axis
from orchestrator.plan.zones.clearance import Constraint, End, PairClearance, RelationConstraint
from orchestrator.plan.zones.course import Course, Sweep, find_margin, make_moving_axis
from orchestrator.plan.zones.search import RuleCheck, Violation, find_rule_violation, leads_out
from orchestrator.plan.zones.shapes import make_shape


class FleetZones:
    """The rules of a fleet, as they are checked. rules: in the order of the file. ranges: where each real axis that a
    rule depends on can be, in its unit; margins: how far it may be from where it is said to be."""

    def __init__(self, fleet: Fleet) -> None:
        zones = fleet.zones
        assert zones is not None, "the fleet has zones"
        self._fleet = fleet
        self.skew_s = zones.step_skew
        self.bodies: dict[str, Body] = {name: make_body(fleet, zones.bodies, name) for name in zones.bodies}
        self.rules = [
            RuleCheck(name, self._make_constraint(fleet, name, rule), rule.trust_step)
            for name, rule in zones.rules.items()
        ]
        self.ranges: dict[str, tuple[float, float]] = {}
        for axis in list_zone_axes(zones, fleet):
            ends = find_range(zones, fleet, axis)
            assert ends is not None, "the zones are valid"
            self.ranges[axis] = float(ends[0]), float(ends[1])
        self.units = {axis: fleet.axis(axis).unit for axis in self.ranges}
        self.margins = {axis: find_margin(fleet.axis(axis)) for axis in self.ranges}

    def _make_constraint(self, fleet: Fleet, name: str, rule: ZoneRule) -> Constraint:
        if rule.apart is not None:
            first, second = (self.bodies[body] for body in rule.apart.bodies)
            return PairClearance(first, second, _find_distance(rule.apart.distance))
        if rule.keep_out is not None:
            region = Body(f"the region of {name}", make_shape(rule.keep_out.region))
            return PairClearance(self.bodies[rule.keep_out.body], region, _find_distance(rule.keep_out.distance))
        assert rule.when is not None and rule.forbid is not None, "the rule is valid"
        width = float(parse_quantity(rule.hysteresis or 0, fleet.unit_of(find_relation_axis(rule.when))))
        words = f"{rule.when} forbids {rule.forbid}"
        return RelationConstraint(_make_end(fleet, rule.when, width), _make_end(fleet, rule.forbid), words)

    def make_course(self, sweep: Sweep) -> Course:
        """The course of a step."""
        profiles, positions, timing, paths = sweep.profiles, sweep.positions, sweep.timing, sweep.paths
        moving_axes = {
            name: make_moving_axis(self._fleet, name, profiles[name], timing, paths.get(name))
            for name in profiles
            if name in self.ranges
        }
        standing: dict[str, tuple[float, float]] = {}
        for name, ends in self.ranges.items():
            low, high = positions.get(name, ends)
            standing[name] = low - self.margins[name], high + self.margins[name]
        duration_s = max((profile.duration_s for profile in profiles.values()), default=0.0)
        unknown = [name for name in self.ranges if name not in positions and name not in profiles]
        skew_s = max(self.skew_s, timing.skew_s) * max((terms.rate for terms in paths.values()), default=1.0)
        return Course(
            moving_axes, standing, duration_s, skew_s, unknown, sweep.adrift, sweep.recent, sweep.begin_s, self.margins
        )

    def find_violations(self, course: Course) -> Iterator[Violation]:
        """Where a step may break each rule that depends on an axis that it moves. Where it may be broken already as the
        step begins, the step may do what leads out."""
        moved_axes = course.moved
        balls = _Balls(course)
        for rule in self.rules:
            if not moved_axes.isdisjoint(rule.constraint.axes) and not balls.show_far(rule):
                violation = find_rule_violation(rule, course)
                if violation is not None and not leads_out(rule, course):
                    yield violation

    def is_clear(self, course: Course) -> bool:
        """Whether a step surely keeps all rules."""
        return next(self.find_violations(course), None) is None


class _Balls:
    """Balls around bodies, which these do not leave in all of a step."""

    def __init__(self, course: Course) -> None:
        self._course = course
        self._balls: dict[str, tuple[Vector, float]] = {}

    def show_far(self, rule: RuleCheck) -> bool:
        """Whether they show that the bodies of a rule are always far enough apart."""
        if not isinstance(rule.constraint, PairClearance):
            return False
        return rule.constraint.find_gap(map(self._find_ball, rule.constraint.bodies)) > 0.0

    def _find_ball(self, body: Body) -> tuple[Vector, float]:
        ball = self._balls.get(body.name)
        if ball is None:
            ball = self._balls[body.name] = body.find_ball(self._course.whole_box)
        return ball


def _find_distance(distance: float | str) -> float:
    return float(max(parse_quantity(distance, Unit.MM), LEAST_DISTANCE))


def _make_end(fleet: Fleet, text: str, hysteresis: float = 0.0) -> End:
    """A side of a relation. hysteresis: by how much more of the way it counts as held: the axis may have been there."""
    name = find_relation_axis(text)
    unit = fleet.unit_of(name)
    relation = read_relation(text, unit)
    end = float(relation.end) + (hysteresis if relation.is_below else -hysteresis)
    return End(name, unit, resolve_axis(fleet, name), relation.is_below, end)
