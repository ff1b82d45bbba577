"""Planned trapezoids as the controller's own registers: SP and AC that last as long as the plan, in host time.

The controller counts in samples. Its profile generator changes speed by AC/2^20 counts a sample each sample, up to
SP/2^10 counts a sample, and ends at a whole sample (L2293, L10032, L12829-12837; the length in samples is that of the
continuous trapezoid, rounded up). SP is even and AC a multiple of 1024, so both are searched together: for the
sample in which the move ends, and for the smallest distance to the plan. Neither goes beyond the axis's limits.
"""

import heapq
import math
from dataclasses import dataclass

from adapters.contract import CannotDo
from orchestrator.model.profile import Profile

SPEED_STEP = 2  # counts/s (L10032)
SPEED_MAX = 12_000_000  # L10063
RAMP_STEP = 1024  # counts/s² (L2294)
RAMP_MAX = 67_107_840  # L2293
SPEED_UNIT = 1024.0  # register units per count/sample
RAMP_UNIT = 1024.0 * 1024.0  # register units per count/sample²
ROOM = 1e-6  # beyond a limit, relative: rounding of a plan that uses it to the full
SYMMETRIC = 1e-6  # of the duration: how far the two ramps may differ
NOTHING_S = 1e-9  # a shorter segment is one that the planner left empty
# Ending late counts for the way that is made meanwhile, and as many times more: the end is what others wait for.
LATE_WEIGHT = 10.0
FINALISTS = 4  # candidates whose distance to the plan is worked out in full
NEIGHBOURS = 6  # speeds on either side of the planned one, and ramps on either side of its own


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an axis may do at most, in host time: counts/s and counts/s²."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """One independent move. speed, ramp: the values of SP, and of AC and DC. samples: from begin to end."""

    distance: int
    speed: int
    ramp: int
    samples: int
    path_error_counts: float


def continuous_samples(distance: int, speed: int, ramp: int) -> float:
    """How long a trapezoid takes, in samples, before it is rounded up to whole ones."""
    way, v, a = abs(distance), speed / SPEED_UNIT, ramp / RAMP_UNIT
    if way * a >= v * v:
        return way / v + v / a
    return 2.0 * math.sqrt(way / a)


def whole_samples(distance: int, speed: int, ramp: int) -> int:
    """The number of samples that the move takes."""
    # What a binary fraction may be off must not make a sample of its own.
    return math.ceil(continuous_samples(distance, speed, ramp) - 1e-9)


def fit(name: str, profile: Profile, bounds: Bounds, tick_ns: float, servo_period_us: int) -> Trapezoid:
    """The registers for `profile`. tick_ns: length of a sample in host time. Raises `CannotDo` naming what would fit.

    The move lasts as planned to half a sample, or longer where limits or coarse registers want it; never shorter.
    """
    distance = profile.end_counts - profile.start_counts
    if distance == 0:
        return Trapezoid(0, SPEED_STEP, RAMP_STEP, 0, 0.0)
    if abs(distance) >= 2**31:
        raise CannotDo("too-far", f"axis {name}: {distance} counts are more than one move can be", "move in parts")
    ramp_s = _ramp_s(name, profile)
    tick_s = tick_ns * 1e-9
    planned, planned_ramp = profile.duration_s / tick_s, ramp_s / tick_s
    # At another servo period a register means another speed (L10749-10763); the limits are in host time.
    top_speed = _down(bounds.velocity * (1 + ROOM) * tick_s * SPEED_UNIT, SPEED_STEP, SPEED_MAX)
    top_ramp = _down(bounds.acceleration * (1 + ROOM) * tick_s * tick_s * RAMP_UNIT, RAMP_STEP, RAMP_MAX)
    if not top_speed or not top_ramp:
        raise CannotDo(
            "limits-too-low",
            f"axis {name}: its limits are below what the controller can do at least, {SPEED_STEP} counts/s and "
            f"{RAMP_STEP} counts/s² at a servo period of {servo_period_us} µs",
            "raise the limits in the fleet file",
        )
    wanted = max(1, round(planned))
    late_weight = LATE_WEIGHT * abs(distance) / (planned - planned_ramp)
    ranked: list[tuple[float, int, int, int]] = []
    for speed, ramp in _candidates(abs(distance), wanted, planned, planned_ramp, top_speed, top_ramp):
        samples = whole_samples(distance, speed, ramp)
        if samples >= wanted:
            rank = late_weight * (samples - wanted) + _way_off(abs(distance), planned, planned_ramp, speed, ramp)
            ranked.append((rank, speed, ramp, samples))
    if not ranked:
        longest_s = continuous_samples(distance, SPEED_STEP, RAMP_STEP) * tick_s
        raise CannotDo(
            "too-slow",
            f"axis {name}: {abs(distance)} counts in {profile.duration_s:g} s are slower than the controller can move",
            f"at most {longest_s:.3f} s for this distance",
        )
    best, best_rank = None, math.inf
    for _, speed, ramp, samples in heapq.nsmallest(FINALISTS, ranked):
        move = Trapezoid(distance, speed, ramp, samples, path_error(profile, distance, speed, ramp, tick_s))
        rank = late_weight * (samples - wanted) + move.path_error_counts
        if best is None or rank < best_rank:
            best, best_rank = move, rank
    assert best is not None
    return best


def _ramp_s(name: str, profile: Profile) -> float:
    """The length of the two equal ramps. Raises `CannotDo` for any other shape."""
    pieces = [
        (t, a, j)
        for t, a, j in zip(profile.durations_s, profile.accelerations, profile.jerks, strict=False)
        if t > NOTHING_S
    ]
    if any(j != 0.0 for _, _, j in pieces):
        raise CannotDo(
            "order",
            f"axis {name}: the profile is jerk-limited; this controller moves in trapezoids",
            "leave `jerk` out of the axis's limits",
        )
    first, last = pieces[0], pieces[-1]
    ramps = first[1] != 0.0 and math.isclose(first[1], -last[1], rel_tol=1e-6)
    even = abs(first[0] - last[0]) <= SYMMETRIC * profile.duration_s
    if len(pieces) not in (2, 3) or not ramps or not even or (len(pieces) == 3 and pieces[1][1] != 0.0):
        raise CannotDo(
            "shape",
            f"axis {name}: the profile is no trapezoid with equal ramps from rest to rest",
            "plan a move from standstill to standstill",
        )
    return first[0]


def _down(value: float, step: int, most: int) -> int:
    return min(int(value // step) * step, most)


def _candidates(
    way: int, wanted: int, planned: float, planned_ramp: float, top_speed: int, top_ramp: int
) -> set[tuple[int, int]]:
    """Registers worth a look, within the limits: near the plan's own, and pairs that last as long as it does.

    wanted: the sample in which the move should end; a continuous length a little above it would end in the next one.
    """
    length = min(planned, wanted)
    speeds = {_clip(speed, SPEED_STEP, top_speed) for speed in _around(way / (planned - planned_ramp), SPEED_STEP)}
    # The slowest speed that can still make the way in time, for plans below the finest steps.
    speeds |= {_clip(speed, SPEED_STEP, top_speed) for speed in _around(way / planned, SPEED_STEP)}
    ramps = {_clip(r, RAMP_STEP, top_ramp) for r in _around(way / ((planned - planned_ramp) * planned_ramp), RAMP_STEP)}
    pairs: set[tuple[int, int]] = set()
    for speed in speeds:
        pairs |= {(speed, min(ramps)), (speed, max(ramps))}
        v = speed / SPEED_UNIT
        if length * v > way:
            for ramp in _beside(v / (length - way / v) * RAMP_UNIT, RAMP_STEP):
                pairs.add((speed, _clip(ramp, RAMP_STEP, top_ramp)))
    for ramp in ramps:
        a = ramp / RAMP_UNIT
        root = (a * length) ** 2 - 4.0 * a * way
        if root >= 0.0:
            for speed in _beside((a * length - math.sqrt(root)) / 2.0 * SPEED_UNIT, SPEED_STEP):
                pairs.add((_clip(speed, SPEED_STEP, top_speed), ramp))
        else:
            # Even a triangle takes longer at this ramp: it is not cut short by a top speed.
            pairs.add((top_speed, ramp))
    return pairs


def _around(per_sample: float, step: int) -> list[int]:
    """Register values about one given in counts per sample (or sample²)."""
    unit = SPEED_UNIT if step == SPEED_STEP else RAMP_UNIT
    middle = int(per_sample * unit // step)
    return [(middle + k) * step for k in range(-NEIGHBOURS, NEIGHBOURS + 1)]


def _beside(value: float, step: int) -> tuple[int, int, int]:
    low = int(min(value, 2.0**40) // step) * step
    return low, low + step, low + 2 * step


def _clip(value: int, low: int, high: int) -> int:
    return max(low, min(value, high))


def _way_off(way: int, planned: float, planned_ramp: float, speed: int, ramp: int) -> float:
    """A quick measure of the distance to the plan: at the ends of both ramps, counts."""
    v, a = speed / SPEED_UNIT, ramp / RAMP_UNIT
    reached = min(v / a, math.sqrt(way / a))
    plan_v = way / (planned - planned_ramp)
    plan_a = plan_v / planned_ramp

    def planned_at(t: float) -> float:
        return plan_a * t * t / 2 if t < planned_ramp else plan_v * (t - planned_ramp / 2)

    def real_at(t: float) -> float:
        return a * t * t / 2 if t < reached else a * reached * (t - reached / 2)

    # Both are symmetric: what lies behind the middle has been seen before it.
    return max(abs(planned_at(t) - real_at(t)) for t in (min(reached, planned / 2), planned_ramp))


def path_error(profile: Profile, distance: int, speed: int, register: int, tick_s: float) -> float:
    """Largest distance between plan and execution when both start together, in counts.

    Both are piecewise quadratic; their difference has its extremes at the joints or where both go equally fast, which
    the joints and a fine grid find to a fraction of the rounding of a position (half a count, included).
    """
    way = abs(distance)
    v, a = speed / SPEED_UNIT / tick_s, register / RAMP_UNIT / tick_s**2
    ramp = min(v / a, math.sqrt(way / a))
    top = a * ramp
    end = way / top + ramp

    def real_at(t: float) -> float:
        if t <= ramp:
            return a * t * t / 2
        if t >= end:
            return float(way)
        left = end - t
        return way - a * left * left / 2 if left < ramp else top * (t - ramp / 2)

    planned_at = profile.evaluator()
    sign = 1.0 if distance > 0 else -1.0
    last = max(end, profile.duration_s)
    joints = [segment.start_s for segment in profile.segments] + [ramp, end - ramp, end, profile.duration_s]
    joints += [last * k / 32 for k in range(33)]
    return 0.5 + max(abs(sign * real_at(t) - planned_at(t).position) for t in joints)
