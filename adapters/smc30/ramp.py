"""The unit's own profile, from whole numbers S, T (steps/s) and R (steps): which of them take a wanted time.

The motor starts at S, is at T after R steps, and ends the same way (L2252-L2288); with T below S it runs at T from end
to end (L2286). The manual gives no formula; a constant acceleration is what its three ways of stating a ramp have in
common. What happens when both ramps do not fit into the move it does not say, so that such numbers are not used.

At a few tens of steps/s whole numbers of steps/s are coarse, and nothing is gained by ramps. There a move is made of
two or three commands with a constant rate each, whose steps add up to the wanted time. Between them the motor stands
for the two program lines that the next one takes, which at such rates is a small part of a step.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import NamedTuple

from adapters.smc30.unitaxis import RAMP_MAX, TOP_MIN, Bounds

_GOOD_ENOUGH_S = 20e-6  # a tenth of what the interpreter's line times vary by; less is not looked for
_FEW, _MANY = 10, 60  # values of a number that are tried, evenly over what is allowed: at first, and if need be
_NEAR = 4  # and so many on each side of the planned one
_SPLIT_S = 100e-6  # what a single command misses by more is tried with two, and then with three
_INNER = 12  # steps of the one in the middle, at most
_ABOVE = 2.0  # the quicker of two rates is at most so many times the mean
_ALL = 6000  # of fewer combinations all are tried


class Leg(NamedTuple):
    """A stretch of constant acceleration: length (s), rate at its start (steps/s), acceleration (steps/s²)."""

    duration_s: float
    rate: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Ramp:
    """One move of `steps` (> 0) with S, T in steps/s and R in steps, 2 R <= steps."""

    steps: int
    s: int
    t: int
    r: int

    @property
    def constant(self) -> bool:
        return self.t <= self.s

    @property
    def acceleration(self) -> float:
        return 0.0 if self.constant else (self.t**2 - self.s**2) / (2 * self.r)

    @property
    def ramp_s(self) -> float:
        return 0.0 if self.constant else 2 * self.r / (self.s + self.t)

    @property
    def duration_s(self) -> float:
        """By the unit's own crystal."""
        if self.constant:
            return self.steps / self.t
        return (self.steps - 2 * self.r) / self.t + 2 * self.ramp_s

    @property
    def legs(self) -> tuple[Leg, ...]:
        if self.constant:
            return (Leg(self.duration_s, self.t, 0.0),)
        a, cruise_s = self.acceleration, (self.steps - 2 * self.r) / self.t
        return Leg(self.ramp_s, self.s, a), Leg(cruise_s, self.t, 0.0), Leg(self.ramp_s, self.t, -a)


@dataclass(frozen=True, slots=True)
class Shape:
    """A whole move: one command, or several with a pause between them."""

    parts: tuple[Ramp, ...]
    gap_s: float = 0.0

    @property
    def steps(self) -> int:
        return sum(part.steps for part in self.parts)

    @property
    def duration_s(self) -> float:
        """By the unit's own crystal."""
        return sum(part.duration_s for part in self.parts) + self.gap_s * (len(self.parts) - 1)

    @property
    def legs(self) -> tuple[Leg, ...]:
        first, *rest = self.parts
        return first.legs + tuple(leg for part in rest for leg in (Leg(self.gap_s, 0.0, 0.0), *part.legs))

    def at(self, elapsed_s: float) -> tuple[float, float]:
        """Steps done and rate, `elapsed_s` after the start."""
        if elapsed_s <= 0.0:
            return 0.0, 0.0
        done = 0.0
        for leg in self.legs:
            t = min(elapsed_s, leg.duration_s)
            done += t * (leg.rate + t * leg.acceleration / 2)
            elapsed_s -= leg.duration_s
            if elapsed_s < 0.0:
                return done, leg.rate + t * leg.acceleration
        return float(self.steps), 0.0


def allowed(ramp: Ramp, limits: Bounds) -> bool:
    """Whether the numbers keep the axis's limits, and are documented."""
    if not TOP_MIN <= ramp.t <= limits.top:
        return False
    if ramp.constant:
        return ramp.t <= limits.start_max
    return (
        limits.start_min <= ramp.s <= limits.start_max
        and 1 <= ramp.r <= RAMP_MAX
        and 2 * ramp.r <= ramp.steps
        and ramp.acceleration <= limits.acceleration
    )


@lru_cache(maxsize=64)
def fit(steps: int, duration_s: float, ramp_s: float, limits: Bounds, gap_s: float) -> Shape | None:
    """The numbers of a whole move; gap_s: the pause between commands.

    What was found is kept: to be armed, a move is lowered again.

    None: no numbers keep the limits. Where the wanted time is out of reach the result is the nearest that can be done.
    """
    one = _one(steps, duration_s, ramp_s, limits)
    if one is None or abs(one.duration_s - duration_s) <= _SPLIT_S:
        return None if one is None else Shape((one,))
    best = Shape((one,))
    for between in (False, True):
        split = _split(steps, duration_s, limits, gap_s, between)
        if split is not None and abs(split.duration_s - duration_s) < abs(best.duration_s - duration_s):
            best = split
        if abs(best.duration_s - duration_s) <= _SPLIT_S:
            break
    return best


def _split(steps: int, duration_s: float, limits: Bounds, gap_s: float, between: bool) -> Shape | None:
    """Two constant rates about the mean, none above what the motor starts at; or a third one between them."""
    best: Shape | None = None
    moving_s = duration_s - gap_s * (2 if between else 1)
    if moving_s <= 0:
        return None
    for slow, quick, middle in _rates(steps / moving_s, min(limits.start_max, limits.top), between):
        for inner in range(1, min(_INNER, steps - 2) + 1) if middle else (0,):
            rest_s, rest = (moving_s - inner / middle, steps - inner) if middle else (moving_s, steps)
            first = round((rest_s - rest / quick) / (1 / slow - 1 / quick))
            if not 1 <= first < rest:
                continue
            lengths = ((first, slow), (inner, middle), (rest - first, quick))
            found = Shape(tuple(Ramp(count, rate, rate, 1) for count, rate in lengths if count), gap_s)
            error_s = abs(found.duration_s - duration_s)
            if best is None or error_s < abs(best.duration_s - duration_s):
                best = found
            if error_s <= _GOOD_ENOUGH_S:
                return best
    return best


def _rates(mean: float, most: int, between: bool) -> Iterator[tuple[int, int, int]]:
    """A rate below the mean, one above it, and one between them or 0; the nearest to the mean first."""
    for slow in range(min(most, floor(mean)), TOP_MIN - 1, -1):
        for quick in range(max(slow + 1, ceil(mean)), min(most, floor(_ABOVE * mean) + 1) + 1):
            for middle in range(slow + 1, quick) if between else (0,):
                yield slow, quick, middle


def _one(steps: int, duration_s: float, ramp_s: float, limits: Bounds) -> Ramp | None:
    """The numbers of one command nearest to `duration_s`; of those that are near enough the nearest to `ramp_s`."""
    best: Ramp | None = None
    score = (float("inf"), float("inf"))
    for tried in (_FEW, _MANY):
        for each in _candidates(steps, duration_s, ramp_s, limits, tried):
            error_s = abs(each.duration_s - duration_s)
            found = (0.0 if error_s <= _GOOD_ENOUGH_S else error_s, abs(each.ramp_s - ramp_s))
            if found < score and allowed(each, limits):
                best, score = each, found
        if score[0] == 0.0:
            break
    return best


def _candidates(steps: int, duration_s: float, ramp_s: float, limits: Bounds, tried: int) -> Iterator[Ramp]:
    """Two of the three numbers are chosen, and the third is what the duration wants, rounded both ways."""
    mean = steps / duration_s
    for t in {max(1, floor(mean)), ceil(mean)}:
        yield Ramp(steps, max(t, limits.start_min), t, 1)
    # The slowest and the quickest that there is.
    yield Ramp(steps, limits.start_min, TOP_MIN, 1)
    yield from _quickest(steps, limits)
    # With S at most the mean rate, T lies between the mean and twice the mean less S.
    slow, quick = max(TOP_MIN, floor(mean)), min(limits.top, floor(2 * mean) + 1)
    start_high = min(limits.start_max, floor(mean))
    if tried == _MANY and (start_high - limits.start_min + 1) * (quick - slow + 1) <= _ALL:
        tried = _ALL
    for s in _spread(limits.start_min, start_high, limits.start_min, tried):
        planned = (steps - s * ramp_s) / (duration_s - ramp_s) if duration_s > ramp_s else 2 * mean - s
        for t in _spread(max(s + 1, slow), quick, round(planned), tried):
            yield from _with_ramp(steps, duration_s, s, t)
    for t in _spread(slow, quick, round(mean), tried if tried < _ALL else _FEW):
        for r in _spread(1, min(RAMP_MAX, steps // 2), round(ramp_s * t / 2), min(tried, _MANY)):
            yield from _with_start(steps, duration_s, t, r)


def _with_ramp(steps: int, duration_s: float, s: int, t: int) -> Iterator[Ramp]:
    if t <= s:
        return
    r = (duration_s - steps / t) * t * (s + t) / (2 * (t - s))
    for each in (floor(r), ceil(r)):
        yield Ramp(steps, s, t, each)


def _with_start(steps: int, duration_s: float, t: int, r: int) -> Iterator[Ramp]:
    rest_s = duration_s - (steps - 2 * r) / t
    if rest_s <= 0:
        return
    s = 4 * r / rest_s - t
    for each in (floor(s), ceil(s)):
        if TOP_MIN <= each < t:
            yield Ramp(steps, each, t, r)


def _quickest(steps: int, limits: Bounds) -> Iterator[Ramp]:
    """As quick as the limits allow: for a plan that the unit can not follow."""
    s = limits.start_max
    reach = sqrt(s**2 + 2 * limits.acceleration * min(steps // 2, RAMP_MAX))
    t = min(limits.top, floor(reach))
    if t > s:
        yield Ramp(steps, s, t, ceil((t**2 - s**2) / (2 * limits.acceleration)))
    yield Ramp(steps, s, min(s, limits.top), 1)


def _spread(low: int, high: int, centre: int, tried: int) -> Iterator[int]:
    """Whole numbers from `low` to `high`, some `tried` of them evenly, and those about `centre`."""
    if high < low:
        return
    centre = min(max(centre, low), high)
    near = range(max(low, centre - _NEAR), min(high, centre + _NEAR) + 1)
    yield from near
    for each in range(low, high + 1, max(1, (high - low) // tried)):
        if each not in near:
            yield each
