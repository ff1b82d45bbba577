"""Time-optimal shapes from rest to rest, in normalised units: from Ruckig, or trapezoids in closed form.

A shape is scaled so that its velocity limit is 1 unit/s: positions are divided by the axis's velocity limit, and the
numbers Ruckig sees are seconds at full speed, whatever a count or a millimetre is (its tolerances are absolute).
Ruckig's Community edition sends intermediate waypoints to a web service: it is never given any here.
"""

from collections.abc import Sequence
from itertools import chain
from math import inf, sqrt
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from ruckig import (
    InputParameter,  # pyright: ignore[reportUnknownVariableType]
    Result,  # pyright: ignore[reportUnknownVariableType]
    Ruckig,  # pyright: ignore[reportUnknownVariableType]
    Synchronization,  # pyright: ignore[reportUnknownVariableType]
    Trajectory,  # pyright: ignore[reportUnknownVariableType]
)

MAX_DURATION_S = 7000.0
# Ruckig's margin on its results is 1e-8 (its README); ten times that, relative to the distance, is a defect.
TOLERANCE = 1e-7
SECOND_ORDER = inf  # the jerk limit of a trapezoid

_TIME: Any = Synchronization.Time  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
_NONE: Any = Synchronization.No  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
_SOLVED: Any = (Result.Working, Result.Finished)  # pyright: ignore[reportUnknownMemberType]

Array = NDArray[np.float64]


class PlanError(Exception):
    """A plan that can not be made. The message names the axis and the reason."""


class Shape(NamedTuple):
    """Segments of constant jerk from rest to rest, in normalised units; the form is that of `model.profile`."""

    durations_s: Sequence[float]
    accelerations: Sequence[float]
    jerks: Sequence[float]


class Bounds(NamedTuple):
    """What shapes may do, one entry an axis: distance in seconds at full speed (> 0), acceleration 1/s, jerk 1/s²."""

    distance: Array
    acceleration: Array
    jerk: Array


def trapezoid(distance: float, ramp_s: float, duration_s: float) -> Shape:
    """The symmetric trapezoid over `distance` in exactly `duration_s`, with ramps of `ramp_s` (<= duration/2)."""
    ramp_s = min(ramp_s, duration_s / 2)  # a rounding above it would make the cruise negative
    cruise_s = duration_s - 2 * ramp_s
    rate = distance / (ramp_s + cruise_s) / ramp_s
    return Shape((ramp_s, cruise_s, ramp_s), (rate, 0.0, -rate), (0.0, 0.0, 0.0))


def fastest_trapezoid(distance: float, acceleration: float) -> tuple[float, float]:
    """(ramp, duration) in s of the fastest trapezoid with a peak velocity of at most 1: closed form."""
    if distance * acceleration < 1.0:
        ramp_s = sqrt(distance / acceleration)
        return ramp_s, 2 * ramp_s
    return 1.0 / acceleration, distance + 1.0 / acceleration


def ramp_ranges(bounds: Bounds, duration_s: float) -> tuple[Array, Array]:
    """The shortest and longest ramp (s) with which each axis's trapezoid can last exactly `duration_s`.

    Its peak d / (T - r) <= 1 and r <= T / 2 give the longest; its acceleration d / ((T - r) r) <= a the shortest.
    """
    root = np.sqrt(np.maximum(duration_s**2 - 4 * bounds.distance / bounds.acceleration, 0.0))
    # 2d/a / (T + root) is (T - root)/2 without the cancellation.
    shortest = 2 * bounds.distance / bounds.acceleration / (duration_s + root)
    longest = np.minimum(duration_s / 2, duration_s - bounds.distance)
    return shortest, np.maximum(shortest, longest)


def solve(bounds: Bounds, names: Sequence[str], synchronised: bool) -> tuple[float, list[Shape]]:
    """Fastest shapes, all of one duration if `synchronised`: (the longest duration in s, the shapes).

    If the solver fails it is asked again with limits 0.1 % lower (which moves it off a knife's edge), then axis by
    axis with the faster shapes stretched in time, which needs no solver to synchronise. No shapes are returned
    with a duration above `MAX_DURATION_S`. Raises `PlanError` naming the axis.
    """
    reasons: list[str] = []
    for margin in (1.0, 0.999):
        try:
            return _ruckig(bounds, synchronised, margin)
        except PlanError as error:
            reasons.append(str(error))
    duration_s, shapes = 0.0, list[Shape]()
    for k, name in enumerate(names):
        try:
            alone_s, found = _ruckig(Bounds(*(part[k : k + 1] for part in bounds)), False, 1.0)
        except PlanError as error:
            raise PlanError(f"{name}: no motion found ({error}; all axes together: {'; '.join(reasons)})") from None
        shapes += found
        duration_s = max(duration_s, alone_s)
    if duration_s > MAX_DURATION_S:
        return duration_s, []
    if synchronised:
        shapes = [stretched(shape, duration_s / sum(shape.durations_s)) for shape in shapes]
    return duration_s, shapes


def stretched(shape: Shape, factor: float) -> Shape:
    """The same path in `factor` times the time: velocity, acceleration and jerk fall by its powers."""
    return Shape(
        [t * factor for t in shape.durations_s],
        [a / factor**2 for a in shape.accelerations],
        [j / factor**3 for j in shape.jerks],
    )


def check(shapes: Sequence[Shape], bounds: Bounds, names: Sequence[str]) -> None:
    """What a solver promises is looked at once more: the limits, the end, and no way back on the way there.

    All shapes have the same number of segments. Raises `PlanError`.
    """
    row = sum(map(len, shapes[0]))
    flat = np.fromiter(chain.from_iterable(chain.from_iterable(shapes)), np.float64, row * len(shapes))
    table = flat.reshape(len(shapes), row)
    segments = len(shapes[0].durations_s)
    t, j = table[:, :segments], table[:, -segments:]
    # Ruckig's own form also holds the end, as one more acceleration.
    a = table[:, segments : 2 * segments]
    a_end = a + t * j
    v = np.cumsum(t * (a + a_end), axis=1) / 2
    p = np.add.reduce(t * (v - t * (a / 2 + t * j / 3)), axis=1)
    steepest = np.maximum(np.abs(a), np.abs(a_end)).max(axis=1)
    # Velocity is monotone where acceleration keeps its sign, which it does within each segment of these shapes.
    wrong = (
        (t.min(axis=1) < 0.0)
        | (np.abs(v - 0.5).max(axis=1) > 0.5 + TOLERANCE)
        | (steepest > bounds.acceleration * (1.0 + TOLERANCE))
        | (np.abs(j).max(axis=1) > bounds.jerk * (1.0 + TOLERANCE))
        | (np.abs(p - bounds.distance) > TOLERANCE * np.maximum(1.0, bounds.distance))
        | (v[:, -1] > TOLERANCE)
    )
    if wrong.any():
        k = int(np.flatnonzero(wrong)[0])
        raise PlanError(f"{names[k]}: the solver's motion breaks its limits or misses the target: {shapes[k]}")


def _ruckig(bounds: Bounds, synchronised: bool, margin: float) -> tuple[float, list[Shape]]:
    n = len(bounds.distance)
    solver, trajectory, question = workspace(n)
    question.target_position = bounds.distance.tolist()
    question.max_velocity = [margin] * n
    question.max_acceleration = (bounds.acceleration * margin).tolist()
    question.max_jerk = (bounds.jerk * margin).tolist()
    question.synchronization = _TIME if synchronised else _NONE
    try:
        result = solver.calculate(question, trajectory)
    except Exception as error:  # Ruckig names no class for an invalid question
        raise PlanError(f"Ruckig refuses the question: {error}") from None
    if result not in _SOLVED:
        raise PlanError(f"Ruckig answers {result}")
    duration_s = cast(float, trajectory.duration)
    if duration_s > MAX_DURATION_S:
        return duration_s, []
    return duration_s, [Shape(each.t, each.a, each.j) for each in trajectory.profiles[0]]


_workspaces: dict[int, tuple[Any, Any, Any]] = {}


def workspace(n: int) -> tuple[Any, Any, Any]:
    """Ruckig's (solver, trajectory, input) for `n` axes, made once: making them takes longer than a plan."""
    if n not in _workspaces:
        question: Any = InputParameter(n)  # pyright: ignore[reportUnknownVariableType]
        zeros = [0.0] * n
        question.current_position = zeros
        question.current_velocity = zeros
        question.current_acceleration = zeros
        question.target_velocity = zeros
        question.target_acceleration = zeros
        _workspaces[n] = (Ruckig(n), Trajectory(n), question)
    return _workspaces[n]
