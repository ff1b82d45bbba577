"""Planned trapezoids as the controller's own registers: SP, AC and DC that last as long as the plan, in host time.

The controller counts in samples. Its profile generator changes speed by AC/2^20 counts a sample each sample, up to
SP/2^10 counts a sample (L2293, L10032), brakes with DC, and puts out its last position at the first whole sample after
the continuous trapezoid has ended (L12829-12837). The registers are coarse, so all three are searched together: for
the duration, and for the smallest distance to the plan. None goes beyond the axis's limits.

Once it is known how the samples lie about T0, it is known at which of them the move should end: the one next to the
end of the plan. Without that, a move may begin half a sample beside T0 and end a whole one beside where it should.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adapters.contract import CannotDo
from adapters.yaskawa.common.model import RAMP_UNIT, SPEED_UNIT, Model
from orchestrator.model.profile import Profile

Array = NDArray[np.float64]
"""Of values that belong together, one for each candidate or instant."""

ROOM = 1e-6  # beyond a limit, relative: rounding of a plan that uses it to the full
SYMMETRIC = 1e-9  # relative: how far the two ramps may differ, in length and slope
NOTHING_S = 1e-9  # a shorter segment is one that the planner left empty
NEIGHBOURS = 6  # speeds on either side of the planned one, and ramps on either side of its own
ALIKE = 200  # the best, among which there are so many different ones as finalists
FINALISTS = 4  # candidates whose distance to the plan is worked out in full
NEAR = 0.02  # samples that a duration may be off for nothing: less than anybody can see of it
GOOD = 0.1  # samples off, in time or way, that no further search is needed for
# A sample too many or too few counts for the way of so many samples: the end is what others wait for.
OFF_WEIGHT = 10.0
HUGE = 2.0**40  # beyond any register
_ABOUT = np.arange(-NEIGHBOURS, NEIGHBOURS + 1.0)
_AND_NEXT = np.array([0.0, 1.0])
_UNITS = np.array([SPEED_UNIT, RAMP_UNIT, RAMP_UNIT], float)  # of SP, AC and DC
_GRID = np.linspace(0.0, 1.0, 33)  # of the move's duration, for its distance to the plan


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an axis may do at most, in host time: counts/s and counts/s²."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """One independent move. speed, up, down: the values of SP, AC and DC. length: its duration in samples; off: that
    less the planned one. at_limit: it lasts longer because a limit holds it."""

    distance: int
    speed: int
    up: int
    down: int
    length: float
    off: float
    at_limit: bool
    path_error_counts: float

    @property
    def samples(self) -> int:
        """Whole samples from the begin to the last commanded position."""
        # What a binary fraction may be off must not make a sample of its own.
        return math.ceil(self.length - 1e-9)


@dataclass(frozen=True, slots=True)
class Place:
    """Where a move lies on its controller's samples. phase: samples from T0 to the begin. last: the sample, from the
    one of the begin on, at which it should end."""

    phase: float
    last: int


@dataclass(frozen=True, slots=True)
class _Law:
    """Trapezoids over `way` counts from rest to rest: peak speed and ramps in counts and samples. By axis: the moves,
    and then whatever there are several of for each."""

    way: Array
    peak: Array
    up: Array
    down: Array
    length: Array

    @classmethod
    def of(cls, way: Array, speed: Array, up: Array, down: Array) -> "_Law":
        ramps = 1.0 / up + 1.0 / down
        peak = np.minimum(speed, np.sqrt(2 * way / ramps))
        return cls(way, peak, up, down, way / peak + peak / 2 * ramps)

    @classmethod
    def by(cls, way: Array, registers: Array) -> "_Law":
        """registers: SP, AC and DC along the last axis."""
        values = registers / _UNITS
        return cls.of(way, values[..., 0], values[..., 1], values[..., 2])

    def at(self, t: Array) -> Array:
        rise, fall = self.peak / self.up, self.peak / self.down
        left = self.length - t
        cruise = self.peak * (t - rise / 2)
        way = np.where(
            t <= rise, self.up * t * t / 2, np.where(left <= fall, self.way - self.down * left * left / 2, cruise)
        )
        return np.where(t <= 0.0, 0.0, np.where(left <= 0.0, self.way, way))

    @property
    def joints(self) -> tuple[Array, Array, Array]:
        """From ramp to cruise, from cruise to ramp, and the end."""
        return self.peak / self.up, self.length - self.peak / self.down, self.length


class _Wanted:
    """What the moves of some axes should be, one a row, in counts and samples; each value a column.

    early, late: between these, all lengths are as good. top_speed, top_ramp: the largest registers.
    """

    def __init__(self, rows: list[tuple[float, ...]]) -> None:
        columns = np.array(rows)[:, :, None].swapaxes(0, 1)
        self.way, self.planned, ramp, self.phase, self.early, self.late, self.top_speed, self.top_ramp = columns
        self.length = np.minimum(np.maximum(self.planned, self.early), self.late)
        speed = self.way / (self.planned - ramp)
        self.plan = _Law.of(self.way, speed, speed / ramp, speed / ramp)

    def off(self, length: Array) -> Array:
        """What lengths count for that are not as good."""
        return OFF_WEIGHT * self.plan.peak * np.maximum(0.0, np.maximum(self.early - length, length - self.late))

    def rank(self, candidates: Array) -> Array:
        """A quick measure of how bad they are, in counts: the distance of the cruises, drawn out over the time between
        the plan's ramps, when the laws begin `phase` samples later."""
        laws, plan = _Law.by(self.way, candidates), self.plan
        rise, fall, _ = plan.joints
        faster = laws.peak - plan.peak
        behind = (laws.peak**2 / laws.up - plan.peak**2 / plan.up) / 2 + laws.peak * self.phase
        apart = np.maximum(abs(faster * rise - behind), abs(faster * fall - behind))
        return self.off(laws.length) + apart


def fit(
    profiles: Mapping[str, Profile],
    bounds: Mapping[str, Bounds],
    tick_ns: float,
    model: Model,
    places: Mapping[str, Place] | None = None,
) -> dict[str, Trapezoid]:
    """The registers for profiles with a way that come nearest, by axis; all at once, because there are as many
    candidates for each as numpy needs. tick_ns: length of a sample in host time. places: if known; then any duration
    is as good as another that ends at the same sample, and near to the plan is what is near to it about T0, so that
    the ramp up makes good for the begin beside it.

    Raises `CannotDo` naming what would fit.
    """
    wanted = _Wanted([_row(axis, each, bounds[axis], tick_ns, model, places) for axis, each in profiles.items()])
    candidates = _by_speed(wanted, model)
    ranks = wanted.rank(candidates)
    poor = (ranks.min(axis=1, keepdims=True) > GOOD * wanted.plan.peak)[:, 0]
    finalists = np.empty((len(ranks), FINALISTS, len(_UNITS)))
    if not poor.all():
        finalists[~poor] = _best(candidates[~poor], ranks[~poor])
    if poor.any():
        more = _by_ramps(wanted, model)
        candidates = np.concatenate([candidates, more], axis=1)
        finalists[poor] = _best(candidates[poor], np.concatenate([ranks, wanted.rank(more)], axis=1)[poor])
    laws = _Law.by(wanted.way, finalists)
    # As they lie on the samples, to choose; and about T0, to tell.
    errors = _path_errors(wanted, laws)
    chosen = (wanted.off(laws.length) + errors[:, 0]).argmin(axis=1)
    shapes: dict[str, Trapezoid] = {}
    for k, (axis, profile) in enumerate(profiles.items()):
        best = chosen[k]
        length, planned = float(laws.length[k, best]), float(wanted.planned[k, 0])
        speed, up, down = (int(each) for each in finalists[k, best])
        at_limit = length > planned and (speed == wanted.top_speed[k, 0] or up == wanted.top_ramp[k, 0])
        distance = profile.end_counts - profile.start_counts
        error = float(errors[k, -1, best])
        shapes[axis] = Trapezoid(distance, speed, up, down, length, length - planned, at_limit, error)
    return shapes


def _row(
    name: str,
    profile: Profile,
    bounds: Bounds,
    tick_ns: float,
    model: Model,
    places: Mapping[str, Place] | None,
) -> tuple[float, ...]:
    """Of `_Wanted`. Raises `CannotDo`."""
    distance = profile.end_counts - profile.start_counts
    if abs(distance) >= 2**31:
        raise CannotDo("too-far", f"axis {name}: {distance} counts are more than one move can be", "move in parts")
    ramp_s = _ramp_s(name, profile)
    tick_s = tick_ns * 1e-9
    # At another servo period a register means another speed (L10749-10763); the limits are in host time.
    speed_most = bounds.velocity * (1 + ROOM) * tick_s * SPEED_UNIT
    ramp_most = bounds.acceleration * (1 + ROOM) * tick_s * tick_s * RAMP_UNIT
    top_speed = _down(speed_most, model.speed_step, model.speed_max)
    top_ramp = _down(ramp_most, model.ramp_step, model.ramp_max)
    if not top_speed or not top_ramp:
        raise CannotDo(
            "limits-too-low",
            f"axis {name}: its limits are below what the controller can do at least, "
            f"{model.speed_step / SPEED_UNIT / tick_s:g} counts/s and {model.ramp_step / RAMP_UNIT / tick_s**2:g} "
            "counts/s²",
            "raise the limits in the fleet file",
        )
    planned = profile.duration_s / tick_s
    phase, early, late = 0.0, planned - NEAR, planned + NEAR
    if places is not None:
        place = places[name]
        phase, early, late = place.phase, place.last - 1 + NEAR, place.last - NEAR
    return float(abs(distance)), planned, ramp_s / tick_s, phase, early, late, top_speed, top_ramp


def _ramp_s(name: str, profile: Profile) -> float:
    """The length of the two equal ramps. Raises `CannotDo` for any other shape."""
    pieces = [
        (t, a, j)
        for t, a, j in zip(profile.durations_s, profile.accelerations, profile.jerks, strict=False)
        if t > NOTHING_S
    ]
    first, last = pieces[0], pieces[-1]
    straight = all(j == 0.0 for _, _, j in pieces)
    ramps = first[1] != 0.0 and math.isclose(first[1], -last[1], rel_tol=SYMMETRIC)
    even = abs(first[0] - last[0]) <= SYMMETRIC * profile.duration_s
    if not straight or len(pieces) not in (2, 3) or not ramps or not even or (len(pieces) == 3 and pieces[1][1] != 0.0):
        raise CannotDo(
            "shape",
            f"axis {name}: the profile is no trapezoid with equal ramps from rest to rest",
            "move it by contour",
        )
    return first[0]


def _down(value: float, step: int, most: int) -> int:
    return min(int(value // step) * step, most)


def _values(value: Array, step: int, top: Array, neighbours: Array) -> Array:
    """Register values about `value`, in steps, from one step to `top`."""
    return np.minimum(np.maximum((np.minimum(value, HUGE) // step + neighbours) * step, step), top)


def _best(candidates: Array, ranks: Array) -> Array:
    """For each axis the best few that differ, for one may have been found in several ways; where there are fewer, the
    last again."""
    order = np.argsort(ranks, axis=1, kind="stable")[:, :ALIKE]
    rows = np.take_along_axis(candidates, order[..., None], axis=1)
    # Those that are alike rank alike, so that they mostly follow each other.
    new = np.ones(order.shape, bool)
    new[:, 1:] = (rows[:, 1:] != rows[:, :-1]).any(axis=2)
    chosen: list[list[list[float]]] = []
    for k in range(len(rows)):
        found: list[list[float]] = []
        for place in np.flatnonzero(new[k]):
            row: list[float] = rows[k, place].tolist()
            if row not in found:
                found.append(row)
                if len(found) == FINALISTS:
                    break
        chosen.append(found + found[-1:] * (FINALISTS - len(found)))
    return np.array(chosen)


def _together(speed: Array, up: Array, down: Array) -> Array:
    """By axis: a row for each candidate."""
    rows = np.empty((*np.broadcast(speed, up, down).shape, 3))
    rows[..., 0], rows[..., 1], rows[..., 2] = speed, up, down
    return rows.reshape(len(rows), -1, 3)


def _by_speed(wanted: _Wanted, model: Model) -> Array:
    """Speeds near the plan's own and a ramp up, with the ramp down that makes up for what they leave."""
    # By axis: moves, speeds, ways to choose the ramps, ramps up, ramps down.
    way, length, top_speed, top_ramp, peak = (
        each.reshape(-1, 1, 1, 1, 1)
        for each in (wanted.way, wanted.length, wanted.top_speed, wanted.top_ramp, wanted.plan.peak)
    )
    speed = _values(peak * SPEED_UNIT, model.speed_step, top_speed, _ABOUT.reshape(-1, 1, 1, 1))
    v = speed / SPEED_UNIT
    inverse = np.empty((len(v), v.shape[1], 2, 1, 1))
    inverse[:, :, :1] = 2.0 * (length - way / v) / v
    inverse[:, :, 1:] = length * length / (2.0 * way)  # 1/up + 1/down of a move that does not come to its speed
    with np.errstate(divide="ignore"):
        even = np.where(inverse > 0.0, 2.0 / inverse, math.inf) * RAMP_UNIT
        up = _values(even, model.ramp_step, top_ramp, _ABOUT.reshape(-1, 1))
        rest = inverse - RAMP_UNIT / up
        low = np.where(rest > 0.0, RAMP_UNIT / rest, math.inf)
    return _together(speed, up, _values(low, model.ramp_step, top_ramp, _AND_NEXT))


def _by_ramps(wanted: _Wanted, model: Model) -> Array:
    """Ramps near the plan's own, with the speed that makes up for what they leave: where ramps are coarse."""
    # By axis: moves, ramps up, ramps down, speeds.
    way, length, top_speed, top_ramp, ramp = (
        each.reshape(-1, 1, 1, 1)
        for each in (wanted.way, wanted.length, wanted.top_speed, wanted.top_ramp, wanted.plan.up)
    )
    up = _values(ramp * RAMP_UNIT, model.ramp_step, top_ramp, _ABOUT.reshape(-1, 1, 1))
    down = up.swapaxes(1, 2)
    # length = way/v + v/2 (1/up + 1/down), for v
    half = RAMP_UNIT / 2 * (1.0 / up + 1.0 / down)
    square = length * length - 4.0 * half * way
    low = np.where(square >= 0.0, length - np.sqrt(np.maximum(square, 0.0)), math.inf) / (2.0 * half) * SPEED_UNIT
    return _together(_values(low, model.speed_step, top_speed, _AND_NEXT), up, down)


def _path_errors(wanted: _Wanted, laws: _Law) -> Array:
    """Largest distance between plan and the execution of each law, in counts. By axis: moves; as it lies on the
    samples, and about T0, which is the same (one row) as long as it is not known how they lie; laws.

    Both are piecewise quadratic; their difference has its extremes at the joints or where both go equally fast, which
    the joints and a fine grid find to a fraction of the rounding of a position (half a count, included).
    """
    # By axis: moves, phases, laws, instants.
    phases = wanted.phase[:, :, None, None]
    if wanted.phase.any():
        phases = np.concatenate([phases, np.zeros_like(phases)], axis=1)
    plan = _deeper(wanted.plan, (1, 1, 1))
    laws = _deeper(laws, (1, laws.length.shape[1], 1))
    own, joints, grid = np.concatenate(laws.joints, axis=3), np.concatenate(plan.joints, axis=3), len(_GRID)
    instants = np.empty((*phases.shape[:2], own.shape[2], grid + 6))
    instants[..., :grid] = _GRID * np.maximum(laws.length, plan.length)
    instants[..., grid : grid + 3] = joints
    instants[..., grid + 3 :] = phases + own
    return 0.5 + abs(laws.at(instants - phases) - plan.at(instants)).max(axis=3)


def _deeper(law: _Law, shape: tuple[int, ...]) -> _Law:
    """With further axes behind that of the moves."""
    way = law.way.reshape(-1, 1, 1, 1)
    peak, up, down, length = (each.reshape(-1, *shape) for each in (law.peak, law.up, law.down, law.length))
    return _Law(way, peak, up, down, length)
