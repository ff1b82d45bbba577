"""The controller's own profile, from whole numbers S, T (steps/s) and R (steps), and the choice of these numbers for a
duration.

The motor starts at S, reaches T after R steps, and ends the same way (L2252-L2288); with T below S it runs at T from
end to end (L2286). The manual gives no formula; a constant acceleration is common to its three descriptions of a ramp.
It does not state what happens when both ramps do not fit into the move, so that such numbers are not used.

At a few tens of steps/s whole numbers of steps/s are coarse, and ramps have no benefit. There a move consists of two or
three commands with a constant rate each, whose durations add up to the requested time. Between them the motor stands
for the two program lines of the next command, which at such rates is a small part of a step.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import NamedTuple

from adapters.smc30.unitaxis import RAMP_MAX, TOP_MIN, Smc30Bounds

_GOOD_ENOUGH_S = 20e-6  # a tenth of the variation of the interpreter's line times; a better match is not searched
_FEW, _MANY = 10, 60  # values of a number that are tried, evenly over the allowed range: at first, and if necessary
_NEAR = 4  # and this number on each side of the planned one
_SPLIT_S = 100e-6  # a larger deviation of a single command is tried with two commands, and then with three
_INNER = 12  # steps of the middle command, at most
_ABOVE = 2.0  # the faster of two rates is at most this multiple of the mean
_ALL = 6000  # of fewer combinations all are tried


class Smc30Leg(NamedTuple):
    """A segment of constant acceleration: length (s), rate at its start (steps/s), acceleration (steps/s²)."""

    duration_s: float
    rate: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Smc30Ramp:
    """One move of `steps` (> 0) with S, T in steps/s and R in steps, 2 R <= steps."""

    steps: int
    s: int
    t: int
    r: int

    @property
    def is_constant(self) -> bool:
        return self.t <= self.s

    @property
    def acceleration(self) -> float:
        return 0.0 if self.is_constant else (self.t**2 - self.s**2) / (2 * self.r)

    @property
    def ramp_s(self) -> float:
        return 0.0 if self.is_constant else 2 * self.r / (self.s + self.t)

    @property
    def duration_s(self) -> float:
        """Return the duration by the controller's own crystal."""
        if self.is_constant:
            return self.steps / self.t
        return (self.steps - 2 * self.r) / self.t + 2 * self.ramp_s

    @property
    def motion_legs(self) -> tuple[Smc30Leg, ...]:
        if self.is_constant:
            return (Smc30Leg(self.duration_s, self.t, 0.0),)
        a, cruise_s = self.acceleration, (self.steps - 2 * self.r) / self.t
        return Smc30Leg(self.ramp_s, self.s, a), Smc30Leg(cruise_s, self.t, 0.0), Smc30Leg(self.ramp_s, self.t, -a)


@dataclass(frozen=True, slots=True)
class Smc30Shape:
    """A whole move: one command, or several with a pause between them."""

    parts: tuple[Smc30Ramp, ...]
    gap_s: float = 0.0

    @property
    def total_steps(self) -> int:
        return sum(part.steps for part in self.parts)

    @property
    def duration_s(self) -> float:
        """Return the duration by the controller's own crystal."""
        return sum(part.duration_s for part in self.parts) + self.gap_s * (len(self.parts) - 1)

    @property
    def motion_legs(self) -> tuple[Smc30Leg, ...]:
        first, *later_parts = self.parts
        return first.motion_legs + tuple(
            leg for part in later_parts for leg in (Smc30Leg(self.gap_s, 0.0, 0.0), *part.motion_legs)
        )

    def state_at(self, elapsed_s: float) -> tuple[float, float]:
        """Return the steps completed and the rate, `elapsed_s` after the start."""
        if elapsed_s <= 0.0:
            return 0.0, 0.0
        steps = 0.0
        for leg in self.motion_legs:
            t = min(elapsed_s, leg.duration_s)
            steps += t * (leg.rate + t * leg.acceleration / 2)
            elapsed_s -= leg.duration_s
            if elapsed_s < 0.0:
                return steps, leg.rate + t * leg.acceleration
        return float(self.total_steps), 0.0


def is_allowed(ramp: Smc30Ramp, limits: Smc30Bounds) -> bool:
    """Return whether the numbers respect the axis's limits, and are documented."""
    if not TOP_MIN <= ramp.t <= limits.top:
        return False
    if ramp.is_constant:
        return ramp.t <= limits.start_max
    return (
        limits.start_min <= ramp.s <= limits.start_max
        and 1 <= ramp.r <= RAMP_MAX
        and 2 * ramp.r <= ramp.steps
        and ramp.acceleration <= limits.acceleration
    )


@lru_cache(maxsize=64)
def fit_shape(steps: int, duration_s: float, ramp_s: float, limits: Smc30Bounds, gap_s: float) -> Smc30Shape | None:
    """Return the numbers of a whole move; gap_s: the pause between commands.

    The result is cached: a move is lowered again when it is armed. None: no numbers respect the limits. If the
    requested time cannot be reached, the result is the nearest possible one.
    """
    single = _fit_single(steps, duration_s, ramp_s, limits)
    if single is None or abs(single.duration_s - duration_s) <= _SPLIT_S:
        return None if single is None else Smc30Shape((single,))
    best = Smc30Shape((single,))
    for is_between in (False, True):
        split = _split_move(steps, duration_s, limits, gap_s, between=is_between)
        if split is not None and abs(split.duration_s - duration_s) < abs(best.duration_s - duration_s):
            best = split
        if abs(best.duration_s - duration_s) <= _SPLIT_S:
            break
    return best


def _split_move(
    steps: int, duration_s: float, limits: Smc30Bounds, gap_s: float, *, between: bool
) -> Smc30Shape | None:
    """Return two constant rates around the mean, none above the start rate; or with a third one between them."""
    best: Smc30Shape | None = None
    moving_s = duration_s - gap_s * (2 if between else 1)
    if moving_s <= 0:
        return None
    for slow, quick, middle in _rate_choices(steps / moving_s, min(limits.start_max, limits.top), between=between):
        for inner in range(1, min(_INNER, steps - 2) + 1) if middle else (0,):
            rest_s, outer_steps = (moving_s - inner / middle, steps - inner) if middle else (moving_s, steps)
            first = round((rest_s - outer_steps / quick) / (1 / slow - 1 / quick))
            if not 1 <= first < outer_steps:
                continue
            lengths = ((first, slow), (inner, middle), (outer_steps - first, quick))
            shape = Smc30Shape(tuple(Smc30Ramp(count, rate, rate, 1) for count, rate in lengths if count), gap_s)
            error_s = abs(shape.duration_s - duration_s)
            if best is None or error_s < abs(best.duration_s - duration_s):
                best = shape
            if error_s <= _GOOD_ENOUGH_S:
                return best
    return best


def _rate_choices(mean: float, most: int, *, between: bool) -> Iterator[tuple[int, int, int]]:
    """Yield a rate below the mean, one above it, and one between them or 0; the nearest to the mean first."""
    for slow in range(min(most, floor(mean)), TOP_MIN - 1, -1):
        for quick in range(max(slow + 1, ceil(mean)), min(most, floor(_ABOVE * mean) + 1) + 1):
            for middle in range(slow + 1, quick) if between else (0,):
                yield slow, quick, middle


def _fit_single(steps: int, duration_s: float, ramp_s: float, limits: Smc30Bounds) -> Smc30Ramp | None:
    """Return the numbers of one command nearest to `duration_s`; among those that are near enough the nearest to
    `ramp_s`."""
    best: Smc30Ramp | None = None
    score = (float("inf"), float("inf"))
    for candidate_count in (_FEW, _MANY):
        for candidate in _ramp_candidates(steps, duration_s, ramp_s, limits, candidate_count):
            error_s = abs(candidate.duration_s - duration_s)
            candidate_score = (0.0 if error_s <= _GOOD_ENOUGH_S else error_s, abs(candidate.ramp_s - ramp_s))
            if candidate_score < score and is_allowed(candidate, limits):
                best, score = candidate, candidate_score
        if score[0] == 0.0:
            break
    return best


def _ramp_candidates(
    steps: int, duration_s: float, ramp_s: float, limits: Smc30Bounds, tried: int
) -> Iterator[Smc30Ramp]:
    """Yield candidates: two of the three numbers are chosen, and the third follows from the duration, rounded both
    ways."""
    mean = steps / duration_s
    for t in {max(1, floor(mean)), ceil(mean)}:
        yield Smc30Ramp(steps, max(t, limits.start_min), t, 1)
    # The slowest and the fastest possible move.
    yield Smc30Ramp(steps, limits.start_min, TOP_MIN, 1)
    yield from _fastest_ramps(steps, limits)
    # With S at most the mean rate, T is between the mean and twice the mean less S.
    slow, quick = max(TOP_MIN, floor(mean)), min(limits.top, floor(2 * mean) + 1)
    start_high = min(limits.start_max, floor(mean))
    if tried == _MANY and (start_high - limits.start_min + 1) * (quick - slow + 1) <= _ALL:
        tried = _ALL
    for s in _spread_values(limits.start_min, start_high, limits.start_min, tried):
        planned_top = (steps - s * ramp_s) / (duration_s - ramp_s) if duration_s > ramp_s else 2 * mean - s
        for t in _spread_values(max(s + 1, slow), quick, round(planned_top), tried):
            yield from _with_ramp(steps, duration_s, s, t)
    for t in _spread_values(slow, quick, round(mean), tried if tried < _ALL else _FEW):
        for r in _spread_values(1, min(RAMP_MAX, steps // 2), round(ramp_s * t / 2), min(tried, _MANY)):
            yield from _with_start(steps, duration_s, t, r)


def _with_ramp(steps: int, duration_s: float, s: int, t: int) -> Iterator[Smc30Ramp]:
    if t <= s:
        return
    r = (duration_s - steps / t) * t * (s + t) / (2 * (t - s))
    for ramp in (floor(r), ceil(r)):
        yield Smc30Ramp(steps, s, t, ramp)


def _with_start(steps: int, duration_s: float, t: int, r: int) -> Iterator[Smc30Ramp]:
    rest_s = duration_s - (steps - 2 * r) / t
    if rest_s <= 0:
        return
    s = 4 * r / rest_s - t
    for start_rate in (floor(s), ceil(s)):
        if TOP_MIN <= start_rate < t:
            yield Smc30Ramp(steps, start_rate, t, r)


def _fastest_ramps(steps: int, limits: Smc30Bounds) -> Iterator[Smc30Ramp]:
    """Yield the fastest moves within the limits: for a plan that the controller cannot follow."""
    s = limits.start_max
    reach = sqrt(s**2 + 2 * limits.acceleration * min(steps // 2, RAMP_MAX))
    t = min(limits.top, floor(reach))
    if t > s:
        yield Smc30Ramp(steps, s, t, ceil((t**2 - s**2) / (2 * limits.acceleration)))
    yield Smc30Ramp(steps, s, min(s, limits.top), 1)


def _spread_values(low: int, high: int, centre: int, tried: int) -> Iterator[int]:
    """Yield whole numbers from `low` to `high`, `tried` of them evenly spaced, and those around `centre`."""
    if high < low:
        return
    centre = min(max(centre, low), high)
    near_values = range(max(low, centre - _NEAR), min(high, centre + _NEAR) + 1)
    yield from near_values
    for value in range(low, high + 1, max(1, (high - low) // tried)):
        if value not in near_values:
            yield value
