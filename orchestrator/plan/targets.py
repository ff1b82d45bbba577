"""Targets of moves: the turn of a rotary axis, soft limits, and the move in counts for the planner."""

from fractions import Fraction
from math import floor
from typing import Literal

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import MAX_COUNTS, Axis
from orchestrator.model.units import Quantity, Unit, UnitError, parse_quantity
from orchestrator.plan.step import AxisMove

# Of the acceleration of an axis without a jerk limit: profiles of constant jerk have no steps of it.
LEAST_RAMP_S = 0.02


def find_jerk(axis: Axis) -> float:
    """The jerk limit of an axis on a path, in its unit/s³."""
    return axis.limits.jerk or axis.limits.acceleration / LEAST_RAMP_S


def choose_turn(axis: Axis, here: Fraction, target: Fraction, offset: Fraction) -> Fraction:
    """The motor position of an absolute target. On an axis that wraps it exists once per turn; taken is the one in
    the present turn of user positions or, with `shortest_way`, the one nearest to `here`; inside the soft limits
    if possible."""
    turn = axis.turn_length
    if turn is None:
        return target
    if axis.shortest_way:
        turned_target = target + turn * round((here - target) / turn)
    else:
        turned_target = target + turn * (floor((here + offset) / turn) - floor((target + offset) / turn))
    limits = axis.soft_limits_counts
    if limits is None or limits[0] <= axis.to_target_counts(turned_target) <= limits[1]:
        return turned_target
    turns_inside = [
        way
        for way in (turned_target - turn, turned_target + turn)
        if limits[0] <= axis.to_target_counts(way) <= limits[1]
    ]
    return min(turns_inside, key=lambda way: abs(way - here), default=turned_target)


def explain_beyond_limits(name: str, axis: Axis, target: Fraction, offset: Fraction) -> str | None:
    """Why the motor position `target` is outside the soft limits; None if it is inside. In user positions, as the
    target was given."""
    limits = axis.soft_limits_counts
    if limits is None or limits[0] <= axis.to_target_counts(target) <= limits[1]:
        return None
    low, high = sorted(axis.to_unit(limit) + float(offset) for limit in limits)
    return (
        f"axis {name}: target {float(target + offset):g} {axis.unit} is beyond its soft limits {low:g} to {high:g} "
        f"{axis.unit}"
    )


def explain_beyond_range(name: str, axis: Axis, target: Fraction) -> str | None:
    """Why the motor position `target` cannot be counted in 32 bits; None if it can."""
    counts = axis.to_target_counts(target)
    if -MAX_COUNTS <= counts < MAX_COUNTS:
        return None
    return f"axis {name}: the target is {counts} counts; positions are within ±{MAX_COUNTS} counts"


def make_axis_move(name: str, axis: Axis, start_counts: int, target_counts: int, order: Literal[2, 3]) -> AxisMove:
    """The move of one axis for the planner, with the limits of speed in counts; soft limits are the caller's."""
    scale = float(axis.scale)
    return AxisMove(
        axis=name,
        start_counts=start_counts,
        target_counts=target_counts,
        velocity=axis.limits.velocity * scale,
        acceleration=axis.limits.acceleration * scale,
        jerk=None if axis.limits.jerk is None else axis.limits.jerk * scale,
        order=order,
    )


def parse_target(name: str, value: Quantity, unit: Unit) -> Fraction:
    """The value of a target in the unit of its axis `name`. Raises `Refusal`."""
    try:
        return parse_quantity(value, unit)
    except UnitError as error:
        raise Refusal("bad-unit", f"{name}: {error}", "correct the unit") from None
