"""One motion step: from where the axes stand to their targets, together, on each axis's limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import numpy as np

from orchestrator.model.profile import Profile
from orchestrator.plan.shape import (
    MAX_DURATION_S,
    SECOND_ORDER,
    Array,
    Bounds,
    PlanError,
    Shape,
    check,
    fastest_trapezoid,
    ramp_ranges,
    solve,
    trapezoid,
)

Sync = Literal["time", "phase", "none"]
Ramps = Literal["common", "own"]


@dataclass(frozen=True, slots=True)
class AxisMove:
    """One axis's part. Counts of its controller; limits in counts/s, /s², /s³.

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
class Plan:
    """The profiles of a step, by axis. duration_s: of the longest. Axes that need not move have no profile."""

    duration_s: float
    profiles: Mapping[str, Profile]
    standing: Sequence[str] = field(default=())

    def stretched(self, duration_s: float) -> "Plan":
        """The same paths in a longer time; limits that held still hold."""
        factor = duration_s / self.duration_s
        return Plan(duration_s, {axis: p.stretched(factor) for axis, p in self.profiles.items()}, self.standing)


def plan_step(moves: Sequence[AxisMove], sync: Sync = "time", speed: float = 1.0, ramps: Ramps = "common") -> Plan:
    """Plan all moves from rest to rest. speed: fraction (0 to 1] of every velocity limit.

    sync `time`: one duration for all. Trapezoids share one ramp time as far as their limits allow (`ramps: common`),
    so that an axis that has little to do gets no absurdly short ramp. `phase`: a straight line in the space of the
    axes, planned as one degree of freedom and of one order. `none`: each axis its fastest.
    Raises `PlanError` naming the axis.
    """
    _check_limits(moves)
    moving = [move for move in moves if move.target_counts != move.start_counts]
    standing: list[str] = []
    if len(moving) < len(moves):
        standing = [move.axis for move in moves if move.target_counts == move.start_counts]
    if not moving:
        return Plan(0.0, {}, standing)
    bounds, scales = _question(moving, speed)
    names = [move.axis for move in moving]
    if sync == "phase":
        duration_s, shapes, scales = _line(bounds, scales, names)
    else:
        duration_s, shapes = solve(bounds, names, sync == "time")
        if sync == "time" and shapes:
            _respace_trapezoids(bounds, shapes, duration_s, ramps)
    if duration_s > MAX_DURATION_S:
        slowest = names[int(np.argmax(bounds.distance))]
        raise PlanError(
            f"{slowest}: the move would take {duration_s:.0f} s; at most {MAX_DURATION_S:.0f} s can be planned, "
            "split it into several steps"
        )
    if sync != "phase":
        _check_all(shapes, bounds, names)
    profiles = {
        move.axis: Profile(move.start_counts, move.target_counts, scale, *shape)
        for move, shape, scale in zip(moving, shapes, scales.tolist(), strict=True)
    }
    return Plan(duration_s, profiles, standing)


def _check_limits(moves: Sequence[AxisMove]) -> None:
    """Targets inside the soft limits: the way there is monotone, so the whole move is, once it is inside."""
    outside = [m for m in moves if m.soft_limits and not m.soft_limits[0] <= m.target_counts <= m.soft_limits[1]]
    for move in outside:
        low, high = move.soft_limits or (0, 0)
        raise PlanError(f"{move.axis}: target {move.target_counts} counts is outside its soft limits {low} to {high}")


def _question(moving: Sequence[AxisMove], speed: float) -> tuple[Bounds, Array]:
    """The normalised question, and the scales in counts per unit that carry the direction's sign."""
    table = np.array(
        [
            (
                m.target_counts - m.start_counts,
                m.velocity,
                m.acceleration,
                m.jerk if m.order == 3 and m.jerk else np.inf,
            )
            for m in moving
        ],
        dtype=np.float64,
    )
    distance, velocity, acceleration = table[:, 0], table[:, 1] * speed, table[:, 2]
    jerk = np.nan_to_num(table[:, 3], nan=SECOND_ORDER, posinf=SECOND_ORDER)
    bounds = Bounds(np.abs(distance) / velocity, acceleration / velocity, jerk / velocity)
    return bounds, np.copysign(velocity, distance)


def _respace_trapezoids(bounds: Bounds, shapes: list[Shape], duration_s: float, ramps: Ramps) -> None:
    """Give the second-order axes symmetric trapezoids of exactly `duration_s`.

    Their common ramp is the longest of the shortest ramps that each needs; an axis whose velocity limit does not
    allow so long a ramp takes its own longest.
    """
    second = np.flatnonzero(bounds.jerk == SECOND_ORDER)
    if not len(second):
        return
    shortest, longest = ramp_ranges(Bounds(*(part[second] for part in bounds)), duration_s)
    chosen = np.minimum(shortest.max(), longest) if ramps == "common" else shortest
    for k, ramp_s, distance in zip(second.tolist(), chosen.tolist(), bounds.distance[second].tolist(), strict=True):
        shapes[k] = trapezoid(distance, ramp_s, duration_s)


def _check_all(shapes: Sequence[Shape], bounds: Bounds, names: Sequence[str]) -> None:
    """Check Ruckig's shapes and our trapezoids, which differ in their number of segments."""
    second = bounds.jerk == SECOND_ORDER
    if second.all() or not second.any():
        check(shapes, bounds, names)
        return
    for kind in (second, ~second):
        chosen = np.flatnonzero(kind).tolist()
        part = Bounds(*(each[kind] for each in bounds))
        check([shapes[k] for k in chosen], part, [names[k] for k in chosen])


def _line(bounds: Bounds, scales: Array, names: Sequence[str]) -> tuple[float, list[Shape], Array]:
    """A straight line: one degree of freedom, the fraction of the path, with limits min(limit_i / |d_i|).

    Every axis gets this one shape scaled by its distance, so the line is straight by construction.
    """
    slowest = int(np.argmax(bounds.distance))
    # In units of the fraction: distance 1, velocity 1/d, acceleration a/d, jerk j/d; then normalised by velocity.
    velocity = 1.0 / bounds.distance[slowest]
    acceleration = float((bounds.acceleration / bounds.distance).min() / velocity)
    # One order for all: a trapezoid as soon as one member can execute nothing better.
    jerk = SECOND_ORDER
    if not (bounds.jerk == SECOND_ORDER).any():
        jerk = float((bounds.jerk / bounds.distance).min() / velocity)
    question = Bounds(np.array([1.0 / velocity]), np.array([acceleration]), np.array([jerk]))
    name = "the line of " + ", ".join(names)
    if jerk == SECOND_ORDER:
        ramp_s, duration_s = fastest_trapezoid(float(1.0 / velocity), acceleration)
        shapes = [trapezoid(float(1.0 / velocity), ramp_s, duration_s)]
    else:
        duration_s, shapes = solve(question, [name], False)
    if not shapes or duration_s > MAX_DURATION_S:
        return duration_s, [], scales
    check(shapes, question, [name])
    return duration_s, shapes * len(names), scales * bounds.distance * velocity


class Targets:
    """Exact targets of axes in their units, so that the remainder of a rounding is carried from move to move.

    A thousand relative moves there and back end on the same count, whatever the scale.
    """

    def __init__(self) -> None:
        self._exact: dict[str, tuple[Fraction, int]] = {}

    def position(self, axis: str, counts: int, counts_per_unit: Fraction) -> Fraction:
        """Where `axis` stands in its unit: its last exact target if `counts` is what that became, else `counts`."""
        exact = self._exact.get(axis)
        if exact is not None and exact[1] == counts:
            return exact[0]
        return Fraction(counts) / counts_per_unit

    def reached(self, axis: str, target: Fraction, counts: int) -> None:
        """`axis` was sent to `target`, which is `counts`."""
        self._exact[axis] = (target, counts)

    def forget(self, axis: str) -> None:
        """`axis` moved otherwise (homed, jogged, power-cycled)."""
        self._exact.pop(axis, None)
