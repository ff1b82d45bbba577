"""One motion step: from where the axes stand to their targets, together, on each axis's limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from operator import attrgetter
from typing import Literal

import numpy as np

from orchestrator.model.profile import Profile
from orchestrator.plan.shape import (
    MAX_DURATION_S,
    SECOND_ORDER,
    Array,
    PlanError,
    ShapeBounds,
    ShapeRows,
    check_shapes,
    find_fastest_trapezoids,
    find_ramp_ranges,
    make_trapezoids,
    solve_shapes,
)

Sync = Literal["time", "phase", "none"]
Ramps = Literal["common", "own"]


@dataclass(frozen=True, slots=True)
class AxisMove:
    """The move of one axis. Counts of its controller; limits in counts/s, /s², /s³.

    order: of the profiles that its controller executes, 2 or 3. A third-order axis without a jerk limit is planned
    with trapezoids. soft_limits: (low, high) absolute counts, ends included, or None.
    """

    axis: str
    start_counts: int
    target_counts: int
    velocity: float
    acceleration: float
    jerk: float | None = None
    order: Literal[2, 3] = 2
    soft_limits: tuple[int, int] | None = None


@dataclass(frozen=True, slots=True)
class StepPlan:
    """The profiles of a step, by axis. duration_s: of the longest. Axes that need not move have no profile and are
    in `standing`."""

    duration_s: float
    profiles: Mapping[str, Profile]
    unmoved: Sequence[str] = field(default=())

    def stretch_to(self, duration_s: float) -> "StepPlan":
        """The same paths in a longer time; limits that held still hold."""
        factor = duration_s / self.duration_s
        return StepPlan(duration_s, {axis: p.stretch_time(factor) for axis, p in self.profiles.items()}, self.unmoved)


def plan_step(moves: Sequence[AxisMove], sync: Sync = "time", speed: float = 1.0, ramps: Ramps = "common") -> StepPlan:
    """Plan all moves from rest to rest. speed: fraction (0 to 1] of every velocity limit.

    sync `time`: one duration for all. Trapezoids share one ramp time as far as their limits allow (`ramps: common`),
    so that an axis with a short distance does not get an extremely short ramp. `phase`: a straight line in the space
    of the axes, planned as one degree of freedom and of one order. `none`: each axis takes its shortest time. Raises
    `PlanError` naming the axis.
    """
    _check_limits(moves)
    moves_in_motion = [move for move in moves if move.target_counts != move.start_counts]
    standing: list[str] = []
    if len(moves_in_motion) < len(moves):
        standing = [move.axis for move in moves if move.target_counts == move.start_counts]
    if not moves_in_motion:
        return StepPlan(0.0, {}, standing)
    bounds, scales = _normalise_moves(moves_in_motion, speed)
    names = [move.axis for move in moves_in_motion]
    if sync == "phase":
        duration_s, shapes, scales = _plan_linear(bounds, scales, names)
    else:
        duration_s, shapes = _plan_axes(bounds, names, synchronised=sync == "time", ramps=ramps)
    if shapes is None:
        slowest = names[int(np.argmax(bounds.distance))]
        raise PlanError(
            f"{slowest}: the move would take {duration_s:.0f} s; at most {MAX_DURATION_S:.0f} s can be planned, "
            "split it into several steps"
        )
    profiles = {
        move.axis: Profile(
            start_counts=move.start_counts,
            end_counts=move.target_counts,
            scale_counts=scale,
            durations_s=t,
            accelerations=a,
            jerks=j,
        )
        for move, scale, t, a, j in zip(
            moves_in_motion, scales.tolist(), *(part.tolist() for part in shapes), strict=True
        )
    }
    return StepPlan(duration_s, profiles, standing)


def _check_limits(moves: Sequence[AxisMove]) -> None:
    """Check targets against the soft limits: the path is monotone, so it is inside if its ends are."""
    moves_outside = [m for m in moves if m.soft_limits and not m.soft_limits[0] <= m.target_counts <= m.soft_limits[1]]
    for move in moves_outside:
        low, high = move.soft_limits or (0, 0)
        raise PlanError(f"{move.axis}: target {move.target_counts} counts is outside its soft limits {low} to {high}")


def _normalise_moves(moving: Sequence[AxisMove], speed: float) -> tuple[ShapeBounds, Array]:
    """The normalised problem, and the scales in counts per unit that carry the sign of the direction."""
    table = np.array([_FIELDS(move) for move in moving], dtype=np.float64)
    start, target, velocity, acceleration, jerk, order = table.T
    distance, velocity = target - start, velocity * speed
    # No jerk limit (None became NaN), or a controller that cannot execute one: a trapezoid.
    jerk = np.where(np.isnan(jerk) | (order < 3), SECOND_ORDER, jerk)
    bounds = ShapeBounds(np.abs(distance) / velocity, acceleration / velocity, jerk / velocity)
    return bounds, np.copysign(velocity, distance)


_FIELDS = attrgetter("start_counts", "target_counts", "velocity", "acceleration", "jerk", "order")


def _plan_axes(
    bounds: ShapeBounds, names: Sequence[str], ramps: Ramps, *, synchronised: bool
) -> tuple[float, ShapeRows | None]:
    """Plan every axis on its own limits: one duration for all if `synchronised`, else the shortest for each."""
    second = bounds.jerk == SECOND_ORDER
    duration_s, shapes = solve_shapes(bounds, names, synchronised=synchronised)
    if shapes is None:
        return duration_s, None
    if second.any():
        part = ShapeBounds(*(bound[second] for bound in bounds))
        chosen_trapezoids = _make_common_trapezoids(part, duration_s, ramps) if synchronised else _plan_fastest(part)
        for target, rows in zip(shapes, chosen_trapezoids, strict=True):
            target[second] = rows
    check_shapes(shapes, bounds, names)
    return duration_s, shapes


def _plan_fastest(bounds: ShapeBounds) -> ShapeRows:
    ramp_s, duration_s = find_fastest_trapezoids(bounds)
    return make_trapezoids(bounds, ramp_s, duration_s)


def _make_common_trapezoids(bounds: ShapeBounds, duration_s: float, ramps: Ramps) -> ShapeRows:
    """Symmetric trapezoids of exactly `duration_s`.

    Their common ramp is the longest of the shortest ramps of all axes; an axis whose velocity limit does not allow
    such a long ramp takes its own longest.
    """
    shortest, longest = find_ramp_ranges(bounds, duration_s)
    return make_trapezoids(bounds, np.minimum(shortest.max(), longest) if ramps == "common" else shortest, duration_s)


def _plan_linear(bounds: ShapeBounds, scales: Array, names: Sequence[str]) -> tuple[float, ShapeRows | None, Array]:
    """A straight line: one degree of freedom, the fraction of the path, with limits min(limit_i / |d_i|).

    Every axis gets this one shape scaled by its distance, so the line is straight by construction.
    """
    # In units of the fraction: distance 1, velocity 1/d, acceleration a/d, jerk j/d; then normalised by velocity.
    longest = bounds.distance.max()
    acceleration = (bounds.acceleration / bounds.distance).min() * longest
    # One order for all: a trapezoid as soon as one member cannot execute a better one (its jerk limit is infinite).
    jerk = SECOND_ORDER
    if not (bounds.jerk == SECOND_ORDER).any():
        jerk = (bounds.jerk / bounds.distance).min() * longest
    question = ShapeBounds(np.array([longest]), np.array([acceleration]), np.array([jerk]))
    duration_s, shape = _plan_axes(question, ["the line of " + ", ".join(names)], synchronised=True, ramps="own")
    if shape is None:
        return duration_s, None, scales
    shapes = ShapeRows(*(np.repeat(part, len(names), axis=0) for part in shape))
    return duration_s, shapes, scales * bounds.distance / longest


class ExactTargets:
    """Exact targets of axes in their units, so that rounding remainders are carried from move to move.

    A thousand relative moves back and forth end on the same count, whatever the scale.
    """

    def __init__(self) -> None:
        self._exact: dict[str, tuple[Fraction, int]] = {}

    def exact_position(self, axis: str, counts: int, position: Fraction) -> Fraction:
        """The position of `axis` in its unit: its last exact target if `counts` is that target's count, else
        `position`."""
        exact = self._exact.get(axis)
        return exact[0] if exact is not None and exact[1] == counts else position

    def record_target(self, axis: str, target: Fraction, counts: int) -> None:
        """Record that `axis` was moved to `target`, which is `counts`."""
        self._exact[axis] = (target, counts)

    def expect_targets(self, exact: Mapping[str, tuple[Fraction, int]]) -> "ExactTargets":
        """A copy after moves to these targets: by axis, the exact one and its count."""
        expected_targets = ExactTargets()
        expected_targets._exact = {**self._exact, **exact}
        return expected_targets

    def forget_target(self, axis: str) -> None:
        """Forget the target of an axis that moved otherwise (homed, jogged, power-cycled)."""
        self._exact.pop(axis, None)
