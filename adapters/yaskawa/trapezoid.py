"""Planned trapezoids as the controller's own registers: SP, AC and DC that last as long as the plan, in host time.

The controller counts in samples. Its profile generator changes speed by AC/2^20 counts a sample each sample, up to
SP/2^10 counts a sample (L2293, L10032), brakes with DC, and puts out its last position at the first whole sample after
the continuous trapezoid has ended (L12829-12837). The registers are coarse, so all three are searched together: for
the duration, and for the smallest distance to the plan. None goes beyond the axis's limits.

Once it is known how the samples lie about T0, it is known at which of them the move should end: the one next to the
end of the plan. Without that, a move may begin half a sample beside T0 and end a whole one beside where it should.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from adapters.contract import CannotDo
from adapters.yaskawa.model import RAMP_UNIT, SPEED_UNIT, Model
from orchestrator.model.profile import Profile

Array = NDArray[np.float64]
"""Of values that belong together, one for each candidate or instant."""

ROOM = 1e-6  # beyond a limit, relative: rounding of a plan that uses it to the full
SYMMETRIC = 1e-6  # of the duration: how far the two ramps may differ
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
class _Law:
    """A trapezoid over `way` counts from rest to rest: peak speed and ramps in counts and samples; or many of them,
    as arrays."""

    way: float
    peak: Array
    up: Array
    down: Array
    length: Array

    @classmethod
    def of(cls, way: float, speed: Array, up: Array, down: Array) -> "_Law":
        ramps = 1.0 / up + 1.0 / down
        peak = np.minimum(speed, np.sqrt(2 * way / ramps))
        return cls(way, peak, up, down, way / peak + peak / 2 * ramps)

    @classmethod
    def by(cls, way: float, registers: Array) -> "_Law":
        """registers: SP, AC and DC along the last axis."""
        return cls.of(way, *np.moveaxis(registers / _UNITS, -1, 0))

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


@dataclass(frozen=True, slots=True)
class Place:
    """Where a move lies on its controller's samples. phase: samples from T0 to the begin. last: the sample, from the
    one of the begin on, at which it should end."""

    phase: float
    last: int


def fit(
    name: str, profile: Profile, bounds: Bounds, tick_ns: float, model: Model, place: Place | None = None
) -> Trapezoid:
    """The registers for `profile` that come nearest. tick_ns: length of a sample in host time. place: if known; then
    any duration is as good as another that ends at the same sample, and near to the plan is what is near to it about
    T0, so that the ramp up makes good for the begin beside it.

    Raises `CannotDo` naming what would fit.
    """
    distance = profile.end_counts - profile.start_counts
    if distance == 0:
        return Trapezoid(0, model.speed_step, model.ramp_step, model.ramp_step, 0.0, 0.0, False, 0.0)
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
    way = float(abs(distance))
    planned, ramp = profile.duration_s / tick_s, ramp_s / tick_s
    phase = 0.0 if place is None else place.phase
    early, late = (planned - NEAR, planned + NEAR) if place is None else (place.last - 1 + NEAR, place.last - NEAR)
    wanted = min(max(planned, early), late)
    plan_speed = way / (planned - ramp)
    plan = _Law.of(way, np.array(plan_speed), np.array(plan_speed / ramp), np.array(plan_speed / ramp))

    def off(length: Array) -> Array:
        return OFF_WEIGHT * plan.peak * np.maximum(0.0, np.maximum(early - length, length - late))

    def rank(candidates: Array) -> Array:
        laws = _Law.by(way, candidates)
        return off(laws.length) + _apart(plan, laws, phase)

    candidates = _by_speed(plan, wanted, top_speed, top_ramp, model)
    ranks = rank(candidates)
    if ranks.min() > GOOD * plan.peak:
        more = _by_ramps(plan, wanted, top_speed, top_ramp, model)
        candidates, ranks = np.concatenate([candidates, more]), np.concatenate([ranks, rank(more)])
    finalists = _distinct(candidates[np.argsort(ranks, kind="stable")[:ALIKE]])
    laws = _Law.by(way, finalists[:, None, :])
    # As they lie on the samples, to choose; and about T0, to tell.
    errors = _path_errors(_Planned(profile, tick_s), laws, np.array([phase, 0.0]).reshape(2, 1, 1))
    best = int(np.argmin(off(laws.length[:, 0]) + errors[0]))
    length, (speed, up, down) = float(laws.length[best, 0]), (int(each) for each in finalists[best])
    at_limit = length > planned and (speed == top_speed or up == top_ramp)
    return Trapezoid(distance, speed, up, down, length, length - planned, at_limit, float(errors[1, best]))


def _ramp_s(name: str, profile: Profile) -> float:
    """The length of the two equal ramps. Raises `CannotDo` for any other shape."""
    pieces = [
        (t, a, j)
        for t, a, j in zip(profile.durations_s, profile.accelerations, profile.jerks, strict=False)
        if t > NOTHING_S
    ]
    first, last = pieces[0], pieces[-1]
    straight = all(j == 0.0 for _, _, j in pieces)
    ramps = first[1] != 0.0 and math.isclose(first[1], -last[1], rel_tol=1e-6)
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


def _values(value: Array, step: int, top: int, neighbours: Array) -> Array:
    """Register values about `value`, in steps, from one step to `top`."""
    return np.clip((np.minimum(value, HUGE) // step + neighbours) * step, step, top)


def _distinct(candidates: Array) -> Array:
    """The first few that differ: one may have been found in several ways."""
    rows: list[list[float]] = candidates.tolist()
    found: list[list[float]] = []
    for row in rows:
        if row not in found:
            found.append(row)
            if len(found) == FINALISTS:
                break
    return np.array(found)


def _together(*parts: Array) -> Array:
    """A row for each candidate: speed, ramp up, ramp down."""
    return np.stack(np.broadcast_arrays(*parts), axis=-1).reshape(-1, 3)


def _by_speed(plan: _Law, planned: float, top_speed: int, top_ramp: int, model: Model) -> Array:
    """Speeds near the plan's own and a ramp up, with the ramp down that makes up for what they leave."""
    # By axis: speeds, ways to choose the ramps, ramps up, ramps down.
    speed = _values(np.array(plan.peak * SPEED_UNIT), model.speed_step, top_speed, _ABOUT).reshape(-1, 1, 1, 1)
    v = speed / SPEED_UNIT
    pointed = planned * planned / (2.0 * plan.way)  # 1/up + 1/down of a move that does not come to its speed
    inverse = np.concatenate([2.0 * (planned - plan.way / v) / v, np.full_like(v, pointed)], axis=1)
    with np.errstate(divide="ignore"):
        wanted = np.where(inverse > 0.0, 2.0 / inverse, math.inf) * RAMP_UNIT
        up = _values(wanted, model.ramp_step, top_ramp, _ABOUT.reshape(1, 1, -1, 1))
        rest = inverse - RAMP_UNIT / up
        low = np.where(rest > 0.0, RAMP_UNIT / rest, math.inf)
    return _together(speed, up, _values(low, model.ramp_step, top_ramp, _AND_NEXT))


def _by_ramps(plan: _Law, planned: float, top_speed: int, top_ramp: int, model: Model) -> Array:
    """Ramps near the plan's own, with the speed that makes up for what they leave: where ramps are coarse."""
    # By axis: ramps up, ramps down, speeds.
    ramps = _values(np.array(plan.up * RAMP_UNIT), model.ramp_step, top_ramp, _ABOUT)
    up, down = ramps.reshape(-1, 1, 1), ramps.reshape(1, -1, 1)
    # planned = way/v + v/2 (1/up + 1/down), for v
    half = RAMP_UNIT / 2 * (1.0 / up + 1.0 / down)
    square = planned * planned - 4.0 * half * plan.way
    low = np.where(square >= 0.0, planned - np.sqrt(np.maximum(square, 0.0)), math.inf) / (2.0 * half) * SPEED_UNIT
    return _together(_values(low, model.speed_step, top_speed, _AND_NEXT), up, down)


def _apart(plan: _Law, laws: _Law, phase: float) -> Array:
    """A quick measure of the distance to the plan in counts: that of the two cruises, drawn out over the time between
    the plan's ramps, when the laws begin `phase` samples later."""
    rise, fall, _ = plan.joints
    faster = laws.peak - plan.peak
    behind = (laws.peak**2 / laws.up - plan.peak**2 / plan.up) / 2 + laws.peak * phase
    return np.maximum(abs(faster * rise - behind), abs(faster * fall - behind))


class _Planned:
    """The plan in samples: where it is, counts along its way, and its joints."""

    def __init__(self, profile: Profile, tick_s: float) -> None:
        begin_s, _, *self._motion = np.array(profile.segments).T
        self._begin, self._tick_s = begin_s, tick_s
        self._way = profile.end_counts - profile.start_counts
        self._end_s = profile.duration_s
        self.length = profile.duration_s / tick_s
        self.joints: Array = begin_s / tick_s

    def at(self, samples: Array) -> Array:
        time_s = samples * self._tick_s
        k = np.maximum(np.searchsorted(self._begin, time_s, side="right") - 1, 0)
        t = np.maximum(time_s - self._begin[k], 0.0)
        position, velocity, acceleration, jerk = (each[k] for each in self._motion)
        where = position + t * (velocity + t * (acceleration / 2 + t * jerk / 6))
        return math.copysign(1.0, self._way) * np.where(time_s >= self._end_s, self._way, where)


def _path_errors(plan: _Planned, laws: _Law, phases: Array) -> Array:
    """Largest distance between plan and the execution of each law (last axis) when that starts so many samples later,
    in counts.

    Both are piecewise quadratic; their difference has its extremes at the joints or where both go equally fast, which
    the joints and a fine grid find to a fraction of the rounding of a position (half a count, included).
    """
    grid = _GRID * np.maximum(laws.length, plan.length)
    joints = np.broadcast_to(plan.joints, (len(grid), len(plan.joints)))
    own = np.concatenate(laws.joints, axis=1)
    parts = (np.broadcast_to(each, (len(phases), *each.shape)) for each in (joints, grid))
    instants = np.concatenate([*parts, phases + own], axis=2)
    return 0.5 + abs(laws.at(instants - phases) - plan.at(instants)).max(axis=2)
