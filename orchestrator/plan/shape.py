"""Time-optimal shapes from rest to rest, in normalised units: from Ruckig, or trapezoids in closed form.

A shape is scaled so that its velocity limit is 1 unit/s: positions are divided by the axis's velocity limit, and the
numbers Ruckig sees are seconds at full speed, whatever a count or a millimetre is (its tolerances are absolute).
Ruckig's Community edition sends intermediate waypoints to a web service: it is never given any here.

Everything works on all axes at once, as rows of arrays: planning 64 axes costs little more than Ruckig's own call.
"""

from collections.abc import Sequence
from itertools import chain
from math import inf
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

from orchestrator.model.errors import TuttiError
from orchestrator.model.profile import MotionState

MAX_DURATION_S = 7000.0
# Ruckig's margin on its results is 1e-8 (its README); ten times that, relative to the distance, is a defect.
TOLERANCE = 1e-7
SECOND_ORDER = inf  # marks a trapezoid: no jerk limit
SEGMENTS = 7  # of every shape; a trapezoid has four empty ones

_TIME: Any = Synchronization.Time  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
_NONE: Any = Synchronization.No  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]
_SOLVED: Any = (Result.Working, Result.Finished)  # pyright: ignore[reportUnknownMemberType]

Array = NDArray[np.float64]
JerkPart = tuple[float, float]
"""A length, s, and the jerk in it."""


class PlanError(TuttiError):
    """A plan that cannot be made. The message names the axis and the reason."""


class ShapeBounds(NamedTuple):
    """The limits of shapes, one entry per axis: distance in seconds at full speed (> 0), acceleration 1/s, jerk
    1/s²."""

    distance: Array
    acceleration: Array
    jerk: Array


class ShapeRows(NamedTuple):
    """One row per axis, `SEGMENTS` columns: segments of constant jerk, from rest to rest, in normalised units.

    accelerations: at the start of each segment.
    """

    durations_s: Array
    accelerations: Array
    jerks: Array


def make_trapezoids(bounds: ShapeBounds, ramp_s: Array, duration_s: Array | float) -> ShapeRows:
    """Symmetric trapezoids of exactly `duration_s`, with ramps of `ramp_s` (at most half of it)."""
    ramp_s = np.minimum(ramp_s, duration_s / 2)  # rounding above it would make the cruise negative
    shapes = ShapeRows(*(np.zeros((len(ramp_s), SEGMENTS)) for _ in range(3)))
    shapes.durations_s[:, 0] = shapes.durations_s[:, 2] = ramp_s
    shapes.durations_s[:, 1] = duration_s - 2 * ramp_s
    shapes.accelerations[:, 0] = bounds.distance / (duration_s - ramp_s) / ramp_s
    shapes.accelerations[:, 2] = -shapes.accelerations[:, 0]
    return shapes


def find_fastest_trapezoids(bounds: ShapeBounds) -> tuple[Array, Array]:
    """(ramps, durations) in s of the fastest trapezoids with a peak velocity of at most 1: closed form."""
    ramp_s = np.minimum(np.sqrt(bounds.distance / bounds.acceleration), 1.0 / bounds.acceleration)
    # The peak is acceleration times ramp; the distance at the peak, plus one ramp.
    return ramp_s, bounds.distance / (bounds.acceleration * ramp_s) + ramp_s


def find_ramp_ranges(bounds: ShapeBounds, duration_s: float) -> tuple[Array, Array]:
    """The shortest and longest ramp (s) with which each axis's trapezoid can last exactly `duration_s`.

    Its peak d / (T - r) <= 1 and r <= T / 2 give the longest; its acceleration d / ((T - r) r) <= a the shortest.
    """
    root = np.sqrt(np.maximum(duration_s**2 - 4 * bounds.distance / bounds.acceleration, 0.0))
    # 2d/a / (T + root) is (T - root)/2 without the cancellation.
    shortest = 2 * bounds.distance / bounds.acceleration / (duration_s + root)
    longest = np.minimum(duration_s / 2, duration_s - bounds.distance)
    return shortest, np.maximum(shortest, longest)


def solve_shapes(bounds: ShapeBounds, names: Sequence[str], *, synchronised: bool) -> tuple[float, ShapeRows | None]:
    """Fastest jerk-limited shapes, all of one duration if `synchronised`: (the longest duration in s, the shapes).

    Rows whose jerk limit is `SECOND_ORDER` only contribute to the duration: their shape here is meaningless. If the
    solver fails it is called again with limits 0.1 % lower (to leave a singular case), then axis by axis with the
    faster shapes stretched in time, which needs no solver to synchronise. No shapes are returned with a duration
    above `MAX_DURATION_S`. Raises `PlanError` naming the axis.
    """
    reasons: list[str] = []
    for margin in (1.0, 0.999):
        try:
            return _run_ruckig(bounds, synchronised=synchronised, margin=margin)
        except PlanError as error:
            reasons.append(str(error))
    rows: list[ShapeRows] = []
    durations = np.zeros(len(names))
    for k, name in enumerate(names):
        try:
            durations[k], found_rows = _run_ruckig(
                ShapeBounds(*(part[k : k + 1] for part in bounds)), synchronised=False, margin=1.0
            )
        except PlanError as error:
            raise PlanError(f"{name}: no motion found ({error}; all axes together: {'; '.join(reasons)})") from None
        if found_rows is None:
            return float(durations[k]), None
        rows.append(found_rows)
    shapes = ShapeRows(*(np.concatenate(parts) for parts in zip(*rows, strict=True)))
    longest_s = float(durations.max())
    return longest_s, stretch_shapes(shapes, longest_s / durations[:, None]) if synchronised else shapes


def stretch_shapes(shapes: ShapeRows, factor: Array | float) -> ShapeRows:
    """The same paths in `factor` times the time: acceleration and jerk fall by its powers."""
    return ShapeRows(shapes.durations_s * factor, shapes.accelerations / factor**2, shapes.jerks / factor**3)


def check_shapes(shapes: ShapeRows, bounds: ShapeBounds, names: Sequence[str]) -> None:
    """Verify the solver's result: the limits, the end, and monotone motion.

    Raises `PlanError` naming the axis.
    """
    t, a, j = shapes
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
        shape = [part[k].tolist() for part in shapes]
        raise PlanError(f"{names[k]}: the solver's motion exceeds its limits or misses the target: {shape}")


def _run_ruckig(bounds: ShapeBounds, margin: float, *, synchronised: bool) -> tuple[float, ShapeRows | None]:
    n = len(bounds.distance)
    question = get_workspace(n)[2]
    question.target_position = bounds.distance.tolist()
    question.max_velocity = [margin] * n
    question.max_acceleration = (bounds.acceleration * margin).tolist()
    question.max_jerk = (bounds.jerk * margin).tolist()
    question.synchronization = _TIME if synchronised else _NONE
    trajectory = _ask_ruckig(question, n)
    duration_s = cast(float, trajectory.duration)
    if duration_s > MAX_DURATION_S:
        return duration_s, None
    profiles = trajectory.profiles[0]
    cells = n * SEGMENTS
    t = np.fromiter(chain.from_iterable([profile.t for profile in profiles]), np.float64, cells).reshape(n, SEGMENTS)
    j = np.fromiter(chain.from_iterable([profile.j for profile in profiles]), np.float64, cells).reshape(n, SEGMENTS)
    # From rest, acceleration is the sum of the jerks before.
    a = np.zeros((n, SEGMENTS))
    np.cumsum((t * j)[:, :-1], axis=1, out=a[:, 1:])
    return duration_s, ShapeRows(t, a, j)


_workspaces: dict[int, tuple[Any, Any, Any]] = {}


def _ask_ruckig(question: Any, n: int) -> Any:
    """The trajectory of `n` axes for a question that has no intermediate waypoints; valid until the next question.
    Raises `PlanError`."""
    solver, trajectory, _ = get_workspace(n)
    try:
        result = solver.calculate(question, trajectory)
    except Exception as error:  # Ruckig has no exception class of its own for invalid input
        raise PlanError(f"Ruckig refuses the input: {error}") from None
    if result not in _SOLVED:
        raise PlanError(f"Ruckig returned {result}")
    return trajectory


def _list_jerks(profile: Any) -> list[JerkPart]:
    """Lengths (s) and jerks of the trajectory of one axis. Before its seven segments it brings what exceeds a limit by
    rounding back to it."""
    durations_s, jerks = cast(list[float], [*profile.brake.t, *profile.t]), [*profile.brake.j, *profile.j]
    return list(zip(durations_s, cast(list[float], jerks), strict=True))


def get_workspace(n: int) -> tuple[Any, Any, Any]:
    """Ruckig's (solver, trajectory, input) for `n` axes, cached: making them takes longer than a plan."""
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


class WayEnd(NamedTuple):
    """A state at which a way begins or ends: where an axis is and how fast, in its unit, per s, per s²."""

    position: float
    velocity: float = 0.0
    acceleration: float = 0.0


class WayLimits(NamedTuple):
    """The limits of one axis, in its unit/s, /s² and /s³."""

    velocity: float
    acceleration: float
    jerk: float


def solve_ways(begin: Sequence[WayEnd], end: Sequence[WayEnd], limits: Sequence[WayLimits]) -> list[list[JerkPart]]:
    """The fastest way of all axes from one state to another, in one time, as lengths (s) and jerks by axis; both states
    are within the limits. Raises `PlanError`."""
    count = len(begin)
    question: Any = InputParameter(count)  # pyright: ignore[reportUnknownVariableType]
    # Seconds at full speed: Ruckig's tolerances are absolute.
    scales = [limit.velocity for limit in limits]
    question.current_position = [0.0] * count
    question.current_velocity = [state.velocity / scale for state, scale in zip(begin, scales, strict=True)]
    question.current_acceleration = [state.acceleration / scale for state, scale in zip(begin, scales, strict=True)]
    ways = [end_state.position - begin_state.position for begin_state, end_state in zip(begin, end, strict=True)]
    question.target_position = [way / scale for way, scale in zip(ways, scales, strict=True)]
    question.target_velocity = [state.velocity / scale for state, scale in zip(end, scales, strict=True)]
    question.target_acceleration = [state.acceleration / scale for state, scale in zip(end, scales, strict=True)]
    question.max_velocity = [1.0] * count
    question.max_acceleration = [limit.acceleration / limit.velocity for limit in limits]
    question.max_jerk = [limit.jerk / limit.velocity for limit in limits]
    profiles = _ask_ruckig(question, count).profiles[0]
    return [
        [(length_s, jerk * scale) for length_s, jerk in _list_jerks(profile) if length_s > 0.0]
        for profile, scale in zip(profiles, scales, strict=True)
    ]


def solve_way(state: MotionState, target: float, limits: tuple[float, float, float]) -> list[tuple[float, float]]:
    """The fastest way of one axis from `state` to rest at `target`, as lengths (s) and jerks. limits: velocity,
    acceleration and jerk, which `state` keeps. Raises `PlanError`."""
    velocity, acceleration, jerk = limits
    # A question of its own: that of the workspace is asked from rest.
    question: Any = InputParameter(1)  # pyright: ignore[reportUnknownVariableType]
    question.target_position = [(target - state.position) / velocity]
    question.current_velocity = [state.velocity / velocity]
    question.current_acceleration = [state.acceleration / velocity]
    question.max_velocity, question.max_acceleration, question.max_jerk = (
        [1.0],
        [acceleration / velocity],
        [jerk / velocity],
    )
    way = _ask_ruckig(question, 1).profiles[0][0]
    return [(duration_s, part * velocity) for duration_s, part in _list_jerks(way)]
