"""The watch on keep-out zones: whether axes that move must be stopped, by where they were read last."""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.clearance import (
    ROUNDING,
    Constraint,
    OutOfWork,
    PairClearance,
    RelationConstraint,
    Search,
    find_middle,
    find_violation,
)
from orchestrator.plan.zones.vectors import ORIGIN, length

MAX_LOOKS = 50
"""Boxes that are looked at for one rule and one reading: the watch takes little of the coordinator's time."""


@dataclass(frozen=True, slots=True)
class AxisSight:
    """What is seen of a real axis. position: its motor position; None: it may be anywhere in its range. cause: why.

    unchecked: no plan that was checked knows of it: it moves by another's doing, or its position was lost while others
    moved. reach: how far an axis that moves may come before it stands, in its unit; drift: how far it may move until it
    is read again.
    """

    position: float | None
    moving: bool
    unchecked: bool = False
    reach: float = 0.0
    drift: float = 0.0
    cause: str = ""


@dataclass(frozen=True, slots=True)
class Danger:
    """Why axes must be stopped, in words. moving: those of the rule that move. broken: the rule is surely broken where
    they were read; else it may be before they stand."""

    text: str
    moving: tuple[str, ...]
    broken: bool


@dataclass(frozen=True, slots=True)
class RuleSight:
    """What the watch finds of a rule. free: by how many mm bodies may still approach each other before the rule can be
    broken; 0 where that is not known."""

    danger: Danger | None = None
    free: float = 0.0


def look_at_rule(
    constraint: Constraint, sights: Mapping[str, AxisSight], ranges: Box, *, trust_step: bool = False
) -> RuleSight:
    """Whether a rule is broken, or may be before axes stand. sights: of all its axes. ranges: where an axis can be.
    trust_step: the rule relies on axes that keep step; those are read at different instants, so that they may be
    farther from each other than their readings.

    Where all motion was checked ahead, with all its uncertainties, axes count where they are. Where the plan did not
    know of one, all that moves may go on as fast as it may, in either direction, until it stands.
    """
    axes = constraint.axes
    moving_axes = tuple(axis for axis in axes if sights[axis].moving)
    positions = {axis: position for axis in axes if (position := sights[axis].position) is not None}
    is_known = len(positions) == len(axes)
    if not any(sights[axis].unchecked for axis in axes):
        drifts = _find_drifts(sights, moving_axes if trust_step else ())
        return _look_at_point(constraint, positions, moving_axes, drifts) if is_known else RuleSight()
    box = {axis: _find_ends(sights[axis], ranges[axis]) for axis in axes}
    if _find_gap(constraint, box) > 0.0:
        return RuleSight()
    sight = _look_at_point(constraint, positions, moving_axes, {}) if is_known else RuleSight()
    if sight.danger is not None or not moving_axes:
        return RuleSight(sight.danger)
    violation = _find_place(constraint, box)
    if violation is None:
        return RuleSight()
    text = f"{_describe_causes(axes, sights)}; then {constraint.describe(violation)}"
    return RuleSight(Danger(text, moving_axes, broken=False))


def _find_drifts(sights: Mapping[str, AxisSight], moving_axes: tuple[str, ...]) -> Mapping[str, float]:
    """How far axes that move together may have moved since they were read; none of one that moves alone."""
    drifting_axes = moving_axes if len(moving_axes) > 1 else ()
    return {axis: sights[axis].drift for axis in drifting_axes}


def _find_place(constraint: Constraint, box: Box) -> Mapping[str, float] | None:
    """Positions in a box at which a rule is broken, or its middle where that is not decided with the allowed work."""
    try:
        return find_violation(Search(MAX_LOOKS), constraint, box)
    except OutOfWork:
        return find_middle(box)


def _describe_causes(axes: Iterable[str], sights: Mapping[str, AxisSight]) -> str:
    causes: list[str] = []
    for axis in axes:
        sight = sights[axis]
        if sight.position is None:
            causes.append(f"{axis} ({sight.cause}) may be anywhere in its range")
        elif sight.reach:
            causes.append(f"{axis} may come {sight.reach:.3g} farther before it stands")
    return ", ".join(causes)


def find_closing_speed(constraint: Constraint, ranges: Box, speeds: Mapping[str, float]) -> float:
    """How fast the bodies of a rule approach each other at most, mm/s; infinite for a relation. speeds: of axes, in
    their units."""
    if not isinstance(constraint, PairClearance):
        return math.inf
    rates = [body.find_rates(ranges) for body in (constraint.first, constraint.second)]
    return sum(
        (length(rate.along.get(axis, ORIGIN)) + rate.beside.get(axis, 0.0)) * speeds[axis]
        for rate in rates
        for axis in constraint.axes
    )


def _look_at_point(
    constraint: Constraint,
    positions: Mapping[str, float],
    moving_axes: tuple[str, ...],
    drifts: Mapping[str, float],
) -> RuleSight:
    """Whether a rule is broken at positions by more than axes have moved meanwhile, `drifts`."""
    box = {axis: (position, position) for axis, position in positions.items()}
    gap = _find_gap(constraint, box)
    if gap > 0.0:
        return RuleSight(free=gap)
    free = 0.0
    if isinstance(constraint, PairClearance):
        least, most = constraint.find_distance(positions)
        drift = find_closing_speed(constraint, box, {**dict.fromkeys(constraint.axes, 0.0), **drifts})
        is_broken, free = most < constraint.distance - drift - ROUNDING, max(least - constraint.distance, 0.0)
    elif isinstance(constraint, RelationConstraint):
        is_broken = constraint.find_depth(positions) > sum(drifts.values())
    else:
        is_broken = constraint.look(box).holds is False
    return RuleSight(Danger(constraint.describe(positions), moving_axes, broken=True) if is_broken else None, free)


def _find_ends(sight: AxisSight, ends: tuple[float, float]) -> tuple[float, float]:
    if sight.position is None:
        return ends
    return sight.position - sight.reach, sight.position + sight.reach


def _find_gap(constraint: Constraint, box: Box) -> float:
    """How much farther than they must be two bodies surely are, by balls around them, mm; 0: balls do not show it."""
    if not isinstance(constraint, PairClearance):
        return 0.0
    return max(constraint.find_gap(body.find_ball(box) for body in (constraint.first, constraint.second)), 0.0)
