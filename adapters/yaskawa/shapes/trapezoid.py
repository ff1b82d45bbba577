"""Search of the controller's registers for planned trapezoids: SP, AC and DC that last as long as the plan, in host
time.

The controller counts in samples. Its profile generator changes speed by AC/2^20 counts per sample each sample, up to
SP/2^10 counts per sample (L2293, L10032), brakes with DC, and outputs its last position at the first whole sample after
the continuous trapezoid has ended (L12829-12837). The registers are coarse, so all three are searched together: for the
duration, and for the smallest distance to the plan. None exceeds the axis's limits.

Once the position of the samples relative to T0 is known, the sample at which the move should end is known: the one next
to the end of the plan. Without that, a move may begin half a sample off T0 and end a whole sample off its planned end.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from adapters.yaskawa.shapes.model import RAMP_UNIT, SPEED_UNIT, ModelTraits
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile

Array = NDArray[np.float64]
"""Values with one entry per candidate or instant."""

LIMIT_TOLERANCE = 1e-6  # beyond a limit, relative: rounding of a plan that uses the limit to the full
SYMMETRY_TOLERANCE = 1e-9  # relative: how far the two ramps may differ, in length and slope
EMPTY_SEGMENT_S = 1e-9  # a shorter segment counts as empty
NEIGHBOURS = 6  # speeds on either side of the planned one, and ramps on either side of its own
MOST_ALIKE = 200  # the best candidates, of which this many different ones are finalists
FINALISTS = 4  # candidates whose distance to the plan is computed in full
FREE_SAMPLES = 0.02  # samples of deviation in duration without a penalty: it is not observable
GOOD_ENOUGH = 0.1  # samples of deviation, in time or path, below which no further search is needed
# A sample too many or too few counts as the path of this many samples: other participants wait for the end.
OFF_WEIGHT = 10.0
HUGE = 2.0**40  # beyond any register
_ABOUT = np.arange(-NEIGHBOURS, NEIGHBOURS + 1.0)
_AND_NEXT = np.array([0.0, 1.0])
_UNITS = np.array([SPEED_UNIT, RAMP_UNIT, RAMP_UNIT], float)  # of SP, AC and DC
_GRID = np.linspace(0.0, 1.0, 33)  # of the move's duration, for its distance to the plan


@dataclass(frozen=True, slots=True)
class YaskawaBounds:
    """Limits of an axis in host time: counts/s and counts/s²."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class RegisterTrapezoid:
    """One independent move.

    speed, up, down: the values of SP, AC and DC.
    length: its duration in samples.
    off: `length` minus the planned duration.
    at_limit: it lasts longer because a limit restricts it."""

    distance: int
    speed: int
    up: int
    down: int
    length: float
    off: float
    at_limit: bool
    path_error_counts: float

    @property
    def whole_samples(self) -> int:
        """Return the whole samples from the begin to the last commanded position."""
        # The rounding error of a binary fraction must not add a sample.
        return math.ceil(self.length - 1e-9)


@dataclass(frozen=True, slots=True)
class SampleAlignment:
    """The alignment of a move to its controller's samples.

    phase: samples from T0 to the begin.
    last: the sample, counted from the begin, at which the move should end."""

    phase: float
    last: int


@dataclass(frozen=True, slots=True)
class _CandidateMotions:
    """Trapezoids over `way` counts from rest to rest: peak speed and ramps in counts and samples. First axis of the
    arrays: the moves; further axes: the candidates of each."""

    way: Array
    peak: Array
    up: Array
    down: Array
    length: Array

    @classmethod
    def from_values(cls, way: Array, speed: Array, up: Array, down: Array) -> "_CandidateMotions":
        ramps = 1.0 / up + 1.0 / down
        peak = np.minimum(speed, np.sqrt(2 * way / ramps))
        return cls(way, peak, up, down, way / peak + peak / 2 * ramps)

    @classmethod
    def from_registers(cls, way: Array, registers: Array) -> "_CandidateMotions":
        """Build the motions from register values. registers: SP, AC and DC along the last axis."""
        values = registers / _UNITS
        return cls.from_values(way, values[..., 0], values[..., 1], values[..., 2])

    def position_at(self, t: Array) -> Array:
        rise, fall = self.peak / self.up, self.peak / self.down
        length_left = self.length - t
        cruise = self.peak * (t - rise / 2)
        way = np.where(
            t <= rise,
            self.up * t * t / 2,
            np.where(length_left <= fall, self.way - self.down * length_left * length_left / 2, cruise),
        )
        return np.where(t <= 0.0, 0.0, np.where(length_left <= 0.0, self.way, way))

    @property
    def segment_ends(self) -> tuple[Array, Array, Array]:
        """Return the instants from ramp to cruise, from cruise to ramp, and the end."""
        return self.peak / self.up, self.length - self.peak / self.down, self.length


class _MoveTargets:
    """The requested moves of some axes, one per row, in counts and samples; each value is a column.

    early, late: all lengths between these are equally good. top_speed, top_ramp: the largest registers.
    """

    def __init__(self, rows: list[tuple[float, ...]]) -> None:
        columns = np.array(rows)[:, :, None].swapaxes(0, 1)
        self.way, self.planned, ramp, self.phase, self.early, self.late, self.top_speed, self.top_ramp = columns
        self.length = np.minimum(np.maximum(self.planned, self.early), self.late)
        speed = self.way / (self.planned - ramp)
        self.plan = _CandidateMotions.from_values(self.way, speed, speed / ramp, speed / ramp)

    def length_penalty(self, length: Array) -> Array:
        """Return the penalty of lengths outside that range."""
        return OFF_WEIGHT * self.plan.peak * np.maximum(0.0, np.maximum(self.early - length, length - self.late))

    def rank_candidates(self, candidates: Array) -> Array:
        """Return a quick measure of deviation, in counts: the distance of the cruise segments, extrapolated over the
        time between the plan's ramps, for motions that begin `phase` samples later."""
        laws, plan = _CandidateMotions.from_registers(self.way, candidates), self.plan
        rise, fall, _ = plan.segment_ends
        faster = laws.peak - plan.peak
        lag = (laws.peak**2 / laws.up - plan.peak**2 / plan.up) / 2 + laws.peak * self.phase
        distance = np.maximum(abs(faster * rise - lag), abs(faster * fall - lag))
        return self.length_penalty(laws.length) + distance


def extend_shape(shape: RegisterTrapezoid, extra_counts: int) -> RegisterTrapezoid:
    """The move with the same registers, `extra_counts` counts farther, with the sign of its distance."""
    distance = shape.distance + extra_counts
    return replace(shape, distance=distance, length=float(_find_law(shape, distance).length))


def braking_sample(shape: RegisterTrapezoid) -> float:
    """Samples from the begin until it brakes."""
    return float(_find_law(shape, shape.distance).segment_ends[1])


def _find_law(shape: RegisterTrapezoid, distance: int) -> "_CandidateMotions":
    """The motion by the registers of a move over a distance."""
    registers = np.array([float(shape.speed), float(shape.up), float(shape.down)])
    return _CandidateMotions.from_registers(np.array(float(abs(distance))), registers)


def fit_registers(
    profiles: Mapping[str, Profile],
    bounds: Mapping[str, YaskawaBounds],
    tick_ns: float,
    model: ModelTraits,
    places: Mapping[str, SampleAlignment] | None = None,
) -> dict[str, RegisterTrapezoid]:
    """Return the registers that come nearest to the profiles, by axis. All axes are searched at once: numpy is
    efficient with many candidates.

    tick_ns: length of a sample in host time. places: if known; then durations that end at the same sample are equally
    good, and the distance to the plan is measured relative to T0, so that the acceleration ramp compensates for the
    offset of the begin.

    Raises `Refusal` that states what would fit.
    """
    targets = _MoveTargets(
        [
            _target_row(
                axis,
                profile,
                _RegisterRange.of_axis(bounds[axis], tick_ns, model),
                None if places is None else places[axis],
            )
            for axis, profile in profiles.items()
        ]
    )
    candidates = _candidates_by_speed(targets, model)
    ranks = targets.rank_candidates(candidates)
    poor = (ranks.min(axis=1, keepdims=True) > GOOD_ENOUGH * targets.plan.peak)[:, 0]
    finalists = np.empty((len(ranks), FINALISTS, len(_UNITS)))
    if not poor.all():
        finalists[~poor] = _best_candidates(candidates[~poor], ranks[~poor])
    if poor.any():
        more = _candidates_by_ramps(targets, model)
        candidates = np.concatenate([candidates, more], axis=1)
        finalists[poor] = _best_candidates(
            candidates[poor], np.concatenate([ranks, targets.rank_candidates(more)], axis=1)[poor]
        )
    laws = _CandidateMotions.from_registers(targets.way, finalists)
    # Relative to the samples for the choice; relative to T0 for the reported value.
    errors = _path_errors(targets, laws)
    best_numbers = (targets.length_penalty(laws.length) + errors[:, 0]).argmin(axis=1)
    shapes: dict[str, RegisterTrapezoid] = {}
    for k, (axis, profile) in enumerate(profiles.items()):
        best = best_numbers[k]
        length, planned_length = float(laws.length[k, best]), float(targets.planned[k, 0])
        speed, up, down = (int(register) for register in finalists[k, best])
        at_limit = length > planned_length and (speed == targets.top_speed[k, 0] or up == targets.top_ramp[k, 0])
        distance = profile.end_counts - profile.start_counts
        error = float(errors[k, -1, best])
        shapes[axis] = RegisterTrapezoid(
            distance=distance,
            speed=speed,
            up=up,
            down=down,
            length=length,
            off=length - planned_length,
            at_limit=at_limit,
            path_error_counts=error,
        )
    return shapes


class _RegisterRange(NamedTuple):
    """The largest speed and ramp of an axis in its registers, and the smallest in counts/s and counts/s²."""

    tick_s: float
    top_speed: int
    top_ramp: int
    least_speed: float
    least_ramp: float

    @classmethod
    def of_axis(cls, bounds: YaskawaBounds, tick_ns: float, model: ModelTraits) -> "_RegisterRange":
        tick_s = tick_ns * 1e-9
        # At another servo period a register means another speed (L10749-10763); the limits are in host time.
        speed_most = bounds.velocity * (1 + LIMIT_TOLERANCE) * tick_s * SPEED_UNIT
        ramp_most = bounds.acceleration * (1 + LIMIT_TOLERANCE) * tick_s * tick_s * RAMP_UNIT
        return cls(
            tick_s,
            _round_down(speed_most, model.speed_step, model.speed_max),
            _round_down(ramp_most, model.ramp_step, model.ramp_max),
            model.speed_step / SPEED_UNIT / tick_s,
            model.ramp_step / RAMP_UNIT / tick_s**2,
        )


def _target_row(
    name: str, profile: Profile, registers: _RegisterRange, place: SampleAlignment | None
) -> tuple[float, ...]:
    """Return a row of `_MoveTargets`. Raises `Refusal`."""
    distance = profile.end_counts - profile.start_counts
    if abs(distance) >= 2**31:
        raise Refusal("too-far", f"axis {name}: {distance} counts exceed the longest possible move", "split the move")
    ramp_s = _ramp_s(name, profile)
    tick_s, top_speed, top_ramp = registers.tick_s, registers.top_speed, registers.top_ramp
    if not top_speed or not top_ramp:
        raise Refusal(
            "limits-too-low",
            f"axis {name}: its limits are below the controller's minimum, "
            f"{registers.least_speed:g} counts/s and {registers.least_ramp:g} counts/s²",
            "raise the limits in the fleet file",
        )
    planned_length = profile.duration_s / tick_s
    phase, early, late = 0.0, planned_length - FREE_SAMPLES, planned_length + FREE_SAMPLES
    if place is not None:
        phase, early, late = place.phase, place.last - 1 + FREE_SAMPLES, place.last - FREE_SAMPLES
    return float(abs(distance)), planned_length, ramp_s / tick_s, phase, early, late, top_speed, top_ramp


def _ramp_s(name: str, profile: Profile) -> float:
    """Return the length of the two equal ramps. Raises `Refusal` for any other shape."""
    pieces = [
        (t, a, j)
        for t, a, j in zip(profile.durations_s, profile.accelerations, profile.jerks, strict=False)
        if t > EMPTY_SEGMENT_S
    ]
    first, last = pieces[0], pieces[-1]
    straight = all(j == 0.0 for _, _, j in pieces)
    ramps = first[1] != 0.0 and math.isclose(first[1], -last[1], rel_tol=SYMMETRY_TOLERANCE)
    even = abs(first[0] - last[0]) <= SYMMETRY_TOLERANCE * profile.duration_s
    if not straight or len(pieces) not in (2, 3) or not ramps or not even or (len(pieces) == 3 and pieces[1][1] != 0.0):
        raise Refusal(
            "shape",
            f"axis {name}: the profile is not a trapezoid with equal ramps from rest to rest",
            "execute it by contour",
        )
    return first[0]


def _round_down(value: float, step: int, most: int) -> int:
    return min(int(value // step) * step, most)


def _nearby_values(value: Array, step: int, top: Array, neighbours: Array) -> Array:
    """Return register values around `value`, in steps, from one step to `top`."""
    return np.minimum(np.maximum((np.minimum(value, HUGE) // step + neighbours) * step, step), top)


def _best_candidates(candidates: Array, ranks: Array) -> Array:
    """Return the best few different candidates of each axis, because one candidate may be found several times; where
    there are fewer, the last one is repeated."""
    order = np.argsort(ranks, axis=1, kind="stable")[:, :MOST_ALIKE]
    rows = np.take_along_axis(candidates, order[..., None], axis=1)
    # Equal candidates have equal ranks, so that they are usually adjacent.
    new = np.ones(order.shape, bool)
    new[:, 1:] = (rows[:, 1:] != rows[:, :-1]).any(axis=2)
    finalists: list[list[list[float]]] = []
    for k in range(len(rows)):
        axis_finalists: list[list[float]] = []
        for column in np.flatnonzero(new[k]):
            row: list[float] = rows[k, column].tolist()
            if row not in axis_finalists:
                axis_finalists.append(row)
                if len(axis_finalists) == FINALISTS:
                    break
        finalists.append(axis_finalists + axis_finalists[-1:] * (FINALISTS - len(axis_finalists)))
    return np.array(finalists)


def _combine_registers(speed: Array, up: Array, down: Array) -> Array:
    """Combine the registers: first axis the moves, one row per candidate."""
    rows = np.empty((*np.broadcast(speed, up, down).shape, 3))
    rows[..., 0], rows[..., 1], rows[..., 2] = speed, up, down
    return rows.reshape(len(rows), -1, 3)


def _candidates_by_speed(wanted: _MoveTargets, model: ModelTraits) -> Array:
    """Return candidates with speeds near the plan's own and an acceleration ramp, and the deceleration ramp that
    compensates for the remaining deviation."""
    # Axes of the array: moves, speeds, ways to choose the ramps, ramps up, ramps down.
    way, length, top_speed, top_ramp, peak = (
        column.reshape(-1, 1, 1, 1, 1)
        for column in (wanted.way, wanted.length, wanted.top_speed, wanted.top_ramp, wanted.plan.peak)
    )
    speed = _nearby_values(peak * SPEED_UNIT, model.speed_step, top_speed, _ABOUT.reshape(-1, 1, 1, 1))
    v = speed / SPEED_UNIT
    inverse = np.empty((len(v), v.shape[1], 2, 1, 1))
    inverse[:, :, :1] = 2.0 * (length - way / v) / v
    inverse[:, :, 1:] = length * length / (2.0 * way)  # 1/up + 1/down of a move that does not reach its speed
    with np.errstate(divide="ignore"):
        even = np.where(inverse > 0.0, 2.0 / inverse, math.inf) * RAMP_UNIT
        up = _nearby_values(even, model.ramp_step, top_ramp, _ABOUT.reshape(-1, 1))
        inverse_rest = inverse - RAMP_UNIT / up
        low = np.where(inverse_rest > 0.0, RAMP_UNIT / inverse_rest, math.inf)
    return _combine_registers(speed, up, _nearby_values(low, model.ramp_step, top_ramp, _AND_NEXT))


def _candidates_by_ramps(wanted: _MoveTargets, model: ModelTraits) -> Array:
    """Return candidates with ramps near the plan's own, and the speed that compensates for the remaining deviation: for
    coarse ramps."""
    # Axes of the array: moves, ramps up, ramps down, speeds.
    way, length, top_speed, top_ramp, ramp = (
        column.reshape(-1, 1, 1, 1)
        for column in (wanted.way, wanted.length, wanted.top_speed, wanted.top_ramp, wanted.plan.up)
    )
    up = _nearby_values(ramp * RAMP_UNIT, model.ramp_step, top_ramp, _ABOUT.reshape(-1, 1, 1))
    down = up.swapaxes(1, 2)
    # length = way/v + v/2 (1/up + 1/down), for v
    half = RAMP_UNIT / 2 * (1.0 / up + 1.0 / down)
    square = length * length - 4.0 * half * way
    low = np.where(square >= 0.0, length - np.sqrt(np.maximum(square, 0.0)), math.inf) / (2.0 * half) * SPEED_UNIT
    return _combine_registers(_nearby_values(low, model.speed_step, top_speed, _AND_NEXT), up, down)


def _path_errors(wanted: _MoveTargets, laws: _CandidateMotions) -> Array:
    """Return the largest distance between the plan and each candidate motion, in counts. Axes: moves; relative to the
    samples, and relative to T0 (one row, equal, as long as the alignment is unknown); motions.

    Both are piecewise quadratic; their difference has its extremes at the joints or where both velocities are equal,
    which the joints and a fine grid find to a fraction of the rounding of a position (half a count, included).
    """
    # Axes of the array: moves, phases, motions, instants.
    phases = wanted.phase[:, :, None, None]
    if wanted.phase.any():
        phases = np.concatenate([phases, np.zeros_like(phases)], axis=1)
    plan = _insert_axes(wanted.plan, (1, 1, 1))
    laws = _insert_axes(laws, (1, laws.length.shape[1], 1))
    own, joints, grid = np.concatenate(laws.segment_ends, axis=3), np.concatenate(plan.segment_ends, axis=3), len(_GRID)
    instants = np.empty((*phases.shape[:2], own.shape[2], grid + 6))
    instants[..., :grid] = _GRID * np.maximum(laws.length, plan.length)
    instants[..., grid : grid + 3] = joints
    instants[..., grid + 3 :] = phases + own
    return 0.5 + abs(laws.position_at(instants - phases) - plan.position_at(instants)).max(axis=3)


def _insert_axes(law: _CandidateMotions, shape: tuple[int, ...]) -> _CandidateMotions:
    """Insert further array axes after that of the moves."""
    way = law.way.reshape(-1, 1, 1, 1)
    peak, up, down, length = (values.reshape(-1, *shape) for values in (law.peak, law.up, law.down, law.length))
    return _CandidateMotions(way, peak, up, down, length)
