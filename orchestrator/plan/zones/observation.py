"""The zones of a fleet as they are now: where bodies are, and what each rule says to that."""

from collections.abc import Mapping

from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.zone_state import BodyOutline, RuleReading, ZoneState
from orchestrator.model.zone_fields import Vector, ZoneShape
from orchestrator.plan.zones.chain import Body
from orchestrator.plan.zones.clearance import PairClearance
from orchestrator.plan.zones.outlines import make_wire
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import RuleCheck
from orchestrator.plan.zones.vectors import scale


def observe_zones(
    fleet: Fleet, zones: FleetZones, positions: Mapping[str, float], unknown: Mapping[str, str]
) -> ZoneState:
    """The state of zones. positions: motor positions of real axes that rules depend on, in their units; unknown: why
    the others have none."""
    assert fleet.zones is not None, "the fleet has zones"
    specs = fleet.zones
    drawn_positions = {axis: positions.get(axis, sum(ends) / 2) for axis, ends in zones.ranges.items()}
    return ZoneState(
        bodies={
            name: _outline(specs.bodies[name], body, drawn_positions, unknown, specs.bodies[name].description)
            for name, body in zones.bodies.items()
        },
        regions={
            name: _outline(rule.keep_out.region, None, drawn_positions, unknown)
            for name, rule in specs.rules.items()
            if rule.keep_out is not None
        },
        rules=[_read_rule(rule, zones, positions, unknown) for rule in zones.rules],
        positions=dict(positions),
        unknown=dict(unknown),
        ways=_find_ways(zones),
    )


def _outline(
    spec: ZoneShape, body: Body | None, positions: Mapping[str, float], unknown: Mapping[str, str], text: str = ""
) -> BodyOutline:
    wire = make_wire(spec)
    if body is not None:
        wire = wire.place(body, positions)
    return BodyOutline(
        corners=[(round(x, 3), round(y, 3), round(z, 3)) for x, y, z in wire.corners],
        edges=wire.edges,
        radius=wire.radius,
        certain=body is None or unknown.keys().isdisjoint(body.axes),
        description=text,
    )


def _read_rule(
    rule: RuleCheck, zones: FleetZones, positions: Mapping[str, float], unknown: Mapping[str, str]
) -> RuleReading:
    constraint = rule.constraint
    bodies, least = list[str](), None
    if isinstance(constraint, PairClearance):
        names = [body.name for body in constraint.bodies]
        bodies, least = [name if name in zones.bodies else rule.name for name in names], constraint.distance
    lost_axes = [axis for axis in constraint.axes if axis not in positions]
    stands = {axis: (position, position) for axis, position in positions.items()}
    box = {axis: stands.get(axis, zones.ranges[axis]) for axis in constraint.axes}
    holds = constraint.look(box).holds
    distance, text = None, ""
    if not lost_axes:
        text = constraint.describe(positions)
        if isinstance(constraint, PairClearance):
            distance = constraint.find_distance(positions)[0]
    else:
        holds = True if holds else None
        causes = " and ".join(f"{axis} ({unknown.get(axis, 'not known')})" for axis in lost_axes)
        text = f"{causes} may be anywhere in its range" + (", and the rule holds everywhere there" if holds else "")
    return RuleReading(
        rule=rule.name,
        bodies=bodies,
        holds=holds,
        distance=distance,
        least=least,
        trust_step=rule.trust_step,
        text=text,
    )


def _find_ways(zones: FleetZones) -> dict[str, Vector]:
    """Where a positive motion of an axis leads, by the first body that it moves without turning it before."""
    ways: dict[str, Vector] = {}
    for body in zones.bodies.values():
        for joint in body.joints:
            if joint.through is not None:
                break  # what is behind it moves in a direction that changes
            for axis, factor in joint.way.factors:
                ways.setdefault(axis, scale(joint.direction, factor))
    return ways
