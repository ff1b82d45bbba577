"""Planned trapezoids as the controller's own registers: SP, AC and DC that last as long as the plan, in host time.

The controller counts in samples. Its profile generator changes speed by AC/2^20 counts a sample each sample, up to
SP/2^10 counts a sample (L2293, L10032), brakes with DC, and puts out its last position at the first whole sample after
the continuous trapezoid has ended (L12829-12837). The registers are coarse, so all three are searched together: for
the duration, and for the smallest distance to the plan. None goes beyond the axis's limits.

Once it is known how the samples lie about T0, it is known at which of them the move should end: the one next to the
end of the plan. Without that, a move may begin half a sample beside T0 and end a whole one beside where it should.
"""

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass

from adapters.contract import CannotDo
from adapters.yaskawa.model import RAMP_UNIT, SPEED_UNIT, Model
from orchestrator.model.profile import Profile

ROOM = 1e-6  # beyond a limit, relative: rounding of a plan that uses it to the full
SYMMETRIC = 1e-6  # of the duration: how far the two ramps may differ
NOTHING_S = 1e-9  # a shorter segment is one that the planner left empty
NEIGHBOURS = 6  # speeds on either side of the planned one, and ramps on either side of its own
FINALISTS = 4  # candidates whose distance to the plan is worked out in full
NEAR = 0.02  # samples that a duration may be off for nothing: less than anybody can see of it
GOOD = 0.1  # samples off, in time or way, that no further search is needed for
# A sample too many or too few counts for the way of so many samples: the end is what others wait for.
OFF_WEIGHT = 10.0


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
    """A trapezoid over `way` counts from rest to rest: peak speed and ramps in counts and samples."""

    way: float
    peak: float
    up: float
    down: float
    length: float

    @classmethod
    def of(cls, way: float, speed: float, up: float, down: float) -> "_Law":
        ramps = 1.0 / up + 1.0 / down
        if way >= speed * speed / 2 * ramps:
            return cls(way, speed, up, down, way / speed + speed / 2 * ramps)
        peak = math.sqrt(2 * way / ramps)
        return cls(way, peak, up, down, peak * ramps)

    def at(self, t: float) -> float:
        rise, fall = self.peak / self.up, self.peak / self.down
        left = self.length - t
        if t <= 0.0:
            return 0.0
        if left <= 0.0:
            return self.way
        if t <= rise:
            return self.up * t * t / 2
        if left <= fall:
            return self.way - self.down * left * left / 2
        return self.peak * (t - rise / 2)

    @property
    def joints(self) -> tuple[float, float]:
        return self.peak / self.up, self.length - self.peak / self.down


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
    plan = _Law.of(way, plan_speed, plan_speed / ramp, plan_speed / ramp)
    weight = OFF_WEIGHT * plan.peak

    def rank(candidates: Iterator[tuple[int, int, int]]) -> list[tuple[float, int, int, int]]:
        return [
            (weight * max(0.0, early - length, length - late) + apart, speed, up, down)
            for speed, up, down in set(candidates)
            for length, apart in [_rough(plan, speed / SPEED_UNIT, up / RAMP_UNIT, down / RAMP_UNIT, phase)]
        ]

    ranked = rank(_by_speed(plan, wanted, top_speed, top_ramp, model))
    if min(ranked)[0] > GOOD * plan.peak:
        ranked += rank(_by_ramps(plan, wanted, top_speed, top_ramp, model))
    best: Trapezoid | None = None
    best_rank = math.inf
    for _, speed, up, down in heapq.nsmallest(FINALISTS, ranked):
        law = _Law.of(way, speed / SPEED_UNIT, up / RAMP_UNIT, down / RAMP_UNIT)
        off = law.length - planned
        error = _path_error(profile, law, tick_s, phase)
        real_rank = weight * max(0.0, early - law.length, law.length - late) + error
        if real_rank < best_rank:
            at_limit = off > 0.0 and (speed == top_speed or up == top_ramp)
            beside = error if place is None else _path_error(profile, law, tick_s, 0.0)
            best, best_rank = Trapezoid(distance, speed, up, down, law.length, off, at_limit, beside), real_rank
    assert best is not None
    return best


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


def _ramps(value: float, top_ramp: int, model: Model) -> set[int]:
    """Values of AC and DC about a ramp in counts/sample²."""
    middle = int(min(value * RAMP_UNIT, 2.0**40) // model.ramp_step)
    return {min(max(middle + k, 1) * model.ramp_step, top_ramp) for k in range(-NEIGHBOURS, NEIGHBOURS + 1)}


def _by_speed(
    plan: _Law, planned: float, top_speed: int, top_ramp: int, model: Model
) -> Iterator[tuple[int, int, int]]:
    """Speeds near the plan's own and a ramp up, with the ramp down that makes up for what they leave."""
    step = model.ramp_step
    pointed = planned * planned / (2.0 * plan.way)  # 1/up + 1/down of a move that does not come to its speed
    middle = int(plan.peak * SPEED_UNIT // model.speed_step)
    for speed in {min(max(middle + k, 1) * model.speed_step, top_speed) for k in range(-NEIGHBOURS, NEIGHBOURS + 1)}:
        v = speed / SPEED_UNIT
        for inverse in (2.0 * (planned - plan.way / v) / v, pointed):
            for up in _ramps(2.0 / inverse if inverse > 0.0 else math.inf, top_ramp, model):
                rest = inverse - RAMP_UNIT / up
                low = _down(min(RAMP_UNIT / rest, 2.0**40), step, top_ramp) if rest > 0.0 else top_ramp
                for down in (low, low + step):
                    yield speed, up, min(max(down, step), top_ramp)


def _by_ramps(
    plan: _Law, planned: float, top_speed: int, top_ramp: int, model: Model
) -> Iterator[tuple[int, int, int]]:
    """Ramps near the plan's own, with the speed that makes up for what they leave: where ramps are coarse."""
    for up in _ramps(plan.up, top_ramp, model):
        for down in _ramps(plan.up, top_ramp, model):
            # planned = way/v + v/2 (1/up + 1/down), for v
            half = RAMP_UNIT / 2 * (1.0 / up + 1.0 / down)
            square = planned * planned - 4.0 * half * plan.way
            if square < 0.0:
                yield top_speed, up, down
                continue
            low = _down((planned - math.sqrt(square)) / (2.0 * half) * SPEED_UNIT, model.speed_step, top_speed)
            for speed in (low, low + model.speed_step):
                yield min(max(speed, model.speed_step), top_speed), up, down


def _rough(plan: _Law, speed: float, up: float, down: float, phase: float) -> tuple[float, float]:
    """The duration in samples, and a quick measure of the distance to the plan in counts: that of the two cruises,
    drawn out over the time between the plan's ramps, when this one begins `phase` samples later."""
    ramps = 1.0 / up + 1.0 / down
    if plan.way >= speed * speed / 2 * ramps:
        length = plan.way / speed + speed / 2 * ramps
    else:
        speed = math.sqrt(2 * plan.way / ramps)
        length = speed * ramps
    rise, fall = plan.joints
    faster = speed - plan.peak
    behind = (speed * speed / up - plan.peak * plan.peak / plan.up) / 2 + speed * phase
    return length, max(abs(faster * rise - behind), abs(faster * fall - behind))


def _path_error(profile: Profile, law: _Law, tick_s: float, phase: float) -> float:
    """Largest distance between plan and execution when that starts `phase` samples later, in counts.

    Both are piecewise quadratic; their difference has its extremes at the joints or where both go equally fast, which
    the joints and a fine grid find to a fraction of the rounding of a position (half a count, included).
    """
    planned_at = profile.evaluator()
    sign = 1.0 if profile.end_counts > profile.start_counts else -1.0
    last = max(law.length, profile.duration_s / tick_s)
    joints = [segment.start_s / tick_s for segment in profile.segments]
    joints += [phase + t for t in (*law.joints, law.length)]
    joints += [last * k / 32 for k in range(33)]
    return 0.5 + max(abs(sign * law.at(t - phase) - planned_at(t * tick_s).position) for t in joints)
