"""The refusal of a step that may break a rule, with what would fit."""

from collections.abc import Iterable, Iterator
from itertools import permutations
from math import isfinite

from orchestrator.model.errors import Refusal
from orchestrator.plan.zones.clearance import MAX_LOOKS, find_middle
from orchestrator.plan.zones.course import Course
from orchestrator.plan.zones.exits import find_exit
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import Violation, find_rule_violation

SLOWER = (2, 4, 8)
"""By how much slower a step is tried, to say what would fit."""
MOST_ORDERED = 3
"""Axes whose orders are tried."""


class ZoneRefusal(Refusal):
    """The refusal of a step that may break a rule: code `zone`. axes: of the rule."""

    def __init__(self, text: str, remedy: str, axes: Iterable[str]) -> None:
        super().__init__("zone", text, remedy)
        self.axes = frozenset(axes)


def make_refusal(zones: FleetZones, course: Course, violation: Violation) -> ZoneRefusal:
    """The refusal of a step that may break a rule."""
    text, remedy = _find_words(zones, course, violation)
    return ZoneRefusal(text, remedy, violation.rule.constraint.axes)


def _find_words(zones: FleetZones, course: Course, violation: Violation) -> tuple[str, str]:
    """What the refusal of a step says, and what to do."""
    rule = violation.rule
    text = f"zone {rule.name}: {_describe(zones, course, violation)}"
    unknown_axes = [axis for axis in rule.constraint.axes if axis in course.unknown]
    if unknown_axes:
        axes = ", ".join(unknown_axes)
        text += f"; the position of {axes} is not known (not referenced, offline, or in use by something else)"
        text += ", and counts as anywhere in its range"
        return text, f"home {axes}, or wait until what uses it has ended"
    if violation.positions is None:
        return text, "move in shorter steps, or give the bodies fewer parts that turn"
    if not course.moving:
        return text, "move the other axes of this zone away first"
    begin_box = course.find_box(rule.constraint.axes, 0.0, 0.0, trust_step=True)
    if rule.constraint.look(begin_box).holds is False:
        middle = find_middle({axis: begin_box[axis] for axis in rule.constraint.axes})
        way_out = find_exit(zones, rule, middle)
        words = "jog them apart first" if way_out is None else way_out.describe()
        return text, f"they stand so where the step begins: {words}"
    is_trusted = rule.trust_step or find_rule_violation(rule, course, trust_step=True) is not None
    if not is_trusted:
        text += "; it does while all axes keep step, and not where one of them stops and the others go on"
    return text, _find_remedy(zones, course, trusted=is_trusted)


def _describe(zones: FleetZones, course: Course, violation: Violation) -> str:
    """When and where a step may break a rule."""
    if violation.positions is None:
        nearest = f"; nearest known distance {violation.nearest:.4g} mm" if isfinite(violation.nearest) else ""
        return f"cannot be decided within {MAX_LOOKS} looks{nearest}"
    constraint = violation.rule.constraint
    places = [f"{axis} {violation.positions[axis]:.6g} {zones.units[axis]}" for axis in constraint.axes]
    instant_text = f"{violation.instant_s:.3g} s after its start" if course.moving else "somewhere on its way"
    return f"{instant_text} {constraint.describe(violation.positions)} ({', '.join(places)})"


def _find_remedy(zones: FleetZones, course: Course, *, trusted: bool) -> str:
    """What would fit, tried by the same check."""
    remedies = list(_list_fitting(zones, course))
    if not trusted:
        remedies.append("state `trust_step: true` on the rule, which relies on no axis stopping alone")
    return (
        "; or ".join(remedies) if remedies else "move another way: first away from the other body, or to other targets"
    )


def _list_fitting(zones: FleetZones, course: Course) -> Iterator[str]:
    if len(course.moving) > 1:
        for factor in SLOWER:
            if zones.is_clear(course.stretch(factor)):
                yield f"move at 1/{factor} of the speed (`speed`)"
                break
        order = None if course.is_path else _find_order(zones, course)
        if order is not None:
            yield f"move {', then '.join(order)}, each in a step of its own"


def _find_order(zones: FleetZones, course: Course) -> tuple[str, ...] | None:
    """An order in which the axes can move one after another."""
    if len(course.moving) > MOST_ORDERED:
        return None
    for order in permutations(course.moving):
        rest_course, is_clear = course, True
        for axis in order:
            first_course, rest_course = rest_course.take_alone(axis)
            is_clear = is_clear and zones.is_clear(first_course)
        if is_clear:
            return order
    return None
