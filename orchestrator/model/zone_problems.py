"""What is wrong with the zones of a fleet file, by its bodies and axes."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from typing import TYPE_CHECKING

from orchestrator.model.linear_map import CorrectedMap, LinearMap
from orchestrator.model.names import split_name
from orchestrator.model.problems import Problem
from orchestrator.model.units import UnitError, find_dimension, parse_quantity
from orchestrator.model.zone_fields import Carrier, ZoneBody, ZoneRule, Zones, find_relation_axis, read_relation

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet


def find_zone_problems(zones: Zones, fleet: "Fleet") -> list[Problem]:
    """All of them, with places below `zones`. fleet: one whose axes and maps are valid."""
    problems = [
        *_find_body_problems(zones),
        *_find_carrier_problems(zones, fleet),
        *_find_relation_problems(zones, fleet),
        *_find_range_problems(zones, fleet),
        *_find_away_problems(zones, fleet),
    ]
    # Which axes the rules depend on is known where all names are.
    return problems or list(_find_missing_ranges(zones, fleet))


def _find_body_problems(zones: Zones) -> Iterator[Problem]:
    """Names of bodies that do not exist, and bodies that ride on themselves."""
    body_list = f"bodies: {', '.join(zones.bodies) or 'none'}"
    for name, body in zones.bodies.items():
        carrier = body.on[0].body if body.on else None
        if carrier is not None and carrier not in zones.bodies:
            yield Problem(("bodies", name, "on", 0, "body"), f"there is no body {carrier}; {body_list}", carrier)
        elif name in list_carriers(zones.bodies, name):
            yield Problem(("bodies", name, "on", 0, "body"), f"body {name} rides on itself; remove one `body`", carrier)
    for name, rule in zones.rules.items():
        if rule.apart is not None:
            for number, body in enumerate(rule.apart.bodies):
                if body not in zones.bodies:
                    text = f"there is no body {body}; {body_list}"
                    yield Problem(("rules", name, "apart", "bodies", number), text, body)
        if rule.keep_out is not None and rule.keep_out.body not in zones.bodies:
            body = rule.keep_out.body
            yield Problem(("rules", name, "keep_out", "body"), f"there is no body {body}; {body_list}", body)


def list_carriers(bodies: Mapping[str, ZoneBody], name: str) -> list[str]:
    """The bodies on which a body rides, from the nearest one; in a circle each once."""
    carriers: list[str] = []
    while (body := bodies.get(name)) is not None and body.on and (carrier := body.on[0].body) is not None:
        if carrier in carriers:
            break
        carriers.append(carrier)
        name = carrier
    return carriers


def list_zone_axes(zones: Zones, fleet: "Fleet") -> list[str]:
    """The real axes on which its rules depend, each once."""
    bodies = dict.fromkeys(name for rule in zones.rules.values() for name in rule.list_bodies())
    chains = dict.fromkeys(part for name in bodies for part in (name, *list_carriers(zones.bodies, name)))
    names = [carrier.axis for name in chains for carrier in zones.bodies[name].on if carrier.axis is not None]
    names += [find_relation_axis(text) for rule in zones.rules.values() for text in (rule.when, rule.forbid) if text]
    return fleet.find_real_axes(names)


def _find_carrier_problems(zones: Zones, fleet: "Fleet") -> Iterator[Problem]:
    for name, body in zones.bodies.items():
        for number, carrier in enumerate(body.on):
            if carrier.axis is not None:
                text = explain_axis(fleet, carrier.axis) or _explain_direction(fleet, carrier)
                if text is not None:
                    yield Problem(("bodies", name, "on", number, "axis"), text, carrier.axis)


def explain_axis(fleet: "Fleet", name: str) -> str | None:
    """Why no body rides on an axis, and no relation names it; None if that is possible."""
    unknown = fleet.names.explain_unknown(name, "target")
    if unknown is not None or name not in fleet.names.virtual:
        return unknown
    virtual_map = fleet.virtual_axes.maps[split_name(name)[0]]
    if isinstance(virtual_map, LinearMap) and not isinstance(virtual_map, CorrectedMap):
        return None
    return f"zones follow linear virtual axes only, and {name} is curved or corrected; name its real axes"


def _explain_direction(fleet: "Fleet", carrier: Carrier) -> str | None:
    assert carrier.axis is not None
    unit = fleet.unit_of(carrier.axis)
    field, dimension = ("about", "angle") if carrier.along is None else ("along", "length")
    if find_dimension(unit) == dimension:
        return None
    return f"`{field}` needs an axis of {dimension}, and {carrier.axis} is in {unit}"


def _find_relation_problems(zones: Zones, fleet: "Fleet") -> Iterator[Problem]:
    for name, rule in zones.rules.items():
        for field, relation in (("when", rule.when), ("forbid", rule.forbid)):
            text = None if relation is None else _explain_relation(relation, fleet)
            if text is not None:
                yield Problem(("rules", name, field), text, relation)
        text = _explain_hysteresis(rule, fleet)
        if text is not None:
            yield Problem(("rules", name, "hysteresis"), text, rule.hysteresis)


def _explain_relation(relation: str, fleet: "Fleet") -> str | None:
    """Why a relation cannot be checked; None if it can."""
    axis = find_relation_axis(relation)
    text = explain_axis(fleet, axis)
    if text is not None:
        return text
    if any(fleet.axis(name).wrap is not None for name in fleet.expand_name(axis)):
        return f"{axis} wraps, so that it is on both sides of each end; use bodies"
    try:
        read_relation(relation, fleet.unit_of(axis))
    except UnitError as error:
        return str(error)
    return None


def _explain_hysteresis(rule: ZoneRule, fleet: "Fleet") -> str | None:
    """Why the hysteresis of a relation, whose axis exists, is none; None if it is one."""
    axis = None if rule.when is None else find_relation_axis(rule.when)
    if axis is None or rule.hysteresis is None or explain_axis(fleet, axis) is not None:
        return None
    try:
        width = parse_quantity(rule.hysteresis, fleet.unit_of(axis), axis)
    except UnitError as error:
        return str(error)
    return f"hysteresis is {rule.hysteresis}; it must not be below 0" if width < 0 else None


def _find_range_problems(zones: Zones, fleet: "Fleet") -> Iterator[Problem]:
    for axis, ends in zones.ranges.items():
        text = fleet.names.explain_unknown(axis, "axis")
        if text is None:
            try:
                low, high = (parse_quantity(end, fleet.axis(axis).unit, axis) for end in ends)
                text = None if low < high else f"{ends[0]} is not below {ends[1]}; swap them"
            except UnitError as error:
                text = str(error)
        if text is not None:
            yield Problem(("ranges", axis), text, ends)


def _find_away_problems(zones: Zones, fleet: "Fleet") -> Iterator[Problem]:
    for number, axis in enumerate(zones.homes_away):
        text = fleet.names.explain_unknown(axis, "axis")
        if text is not None:
            yield Problem(("homes_away", number), text, axis)


def _find_missing_ranges(zones: Zones, fleet: "Fleet") -> Iterator[Problem]:
    """Each real axis that a rule depends on needs a range, for the times when its position is not known."""
    for axis in list_zone_axes(zones, fleet):
        if find_range(zones, fleet, axis) is None:
            text = f"a rule depends on {axis}, which has no soft limits; state where it can be at all: {axis}: [.., ..]"
            yield Problem(("ranges",), text)


def find_range(zones: Zones, fleet: "Fleet", name: str) -> tuple[Fraction, Fraction] | None:
    """Where a real axis can be, in its unit; None: that is not stated."""
    axis = fleet.axis(name)
    if name in zones.ranges:
        low, high = (parse_quantity(end, axis.unit) for end in zones.ranges[name])
        return low, high
    if axis.turn_length is not None:
        return Fraction(0), axis.turn_length
    return None if axis.soft_limits is None else axis.soft_limits.in_unit(axis.unit)
