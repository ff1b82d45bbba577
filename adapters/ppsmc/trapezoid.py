"""The controller's own profile from whole numbers, in closed form, and the choice of them for a duration.

An axis starts at `frun`, speeds up with `acc` to `ffast`, slows down with `dec` to `frun`, and stops (L2007-L2011).
Ramps are given in Hz/ms: a step of them is 1000 steps/s². With k = (1/a + 1/d)/2, from N steps on that suffice for
both ramps the move takes N/V + k (V - S)²/V; shorter ones turn round at Vp = sqrt(S² + N/k), after 2 k (Vp - S).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import NamedTuple

POSITION_MAX = 2**23 - 1  # steps, L2022
RAMP_MAX = 1000  # Hz/ms, L258
_HZ_PER_S = 1000.0  # of one Hz/ms

# The search ends at a duration this near to the wanted one; the firmware is a hundred times less certain.
_GOOD_ENOUGH_S = 5e-6
_RAMP_REACH = 3  # how far from the planned ramps others are looked for, Hz/ms
_SPEEDS = 3
_SHORT_S = 0.001
_GENTLE_SPEEDS = 8
_STEPS = (1, 2, 3, 5, 8, 13, 34, 144)  # ramps to combine others with, Hz/ms
_STOP_S = 2.0  # ramps are no longer than this where the axis's limits allow it: they are what a stop takes


class Leg(NamedTuple):
    """A stretch of constant acceleration: length (s), speed at its start (steps/s), acceleration (steps/s²)."""

    duration_s: float
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """One move of `distance` steps (> 0) with `frun` s and `ffast` f in Hz, `acc` a and `dec` d in Hz/ms."""

    distance: int
    s: int
    f: int
    a: int
    d: int

    @property
    def _k(self) -> float:
        return (1 / self.a + 1 / self.d) / (2 * _HZ_PER_S)

    @property
    def peak(self) -> float:
        """The largest speed that is reached, steps/s."""
        return min(float(self.f), sqrt(self.s**2 + self.distance / self._k))

    @property
    def legs(self) -> tuple[Leg, ...]:
        if self.f == self.s:
            return (Leg(self.distance / self.f, self.f, 0.0),)
        peak, up, down = self.peak, self.a * _HZ_PER_S, self.d * _HZ_PER_S
        cruise = max(0.0, self.distance - self._k * (peak**2 - self.s**2))
        return (
            Leg((peak - self.s) / up, self.s, up),
            Leg(cruise / peak, peak, 0.0),
            Leg((peak - self.s) / down, peak, -down),
        )

    @property
    def stop_s(self) -> float:
        """How long the ramp of a stop takes from the largest speed."""
        return (self.peak - self.s) / (self.d * _HZ_PER_S)

    @property
    def duration_s(self) -> float:
        peak, k = self.peak, self._k
        if peak < self.f:
            return 2 * k * (peak - self.s)
        return self.distance / peak + k * (peak - self.s) ** 2 / peak


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an axis may do: speed (steps/s), acceleration (steps/s²), start speeds that are allowed (steps/s)."""

    speed: float
    acceleration: float
    start_min: int
    start_max: int

    @property
    def ramp_max(self) -> int:
        """The steepest ramp in Hz/ms; 0 for an axis that must not speed up as fast as the unit's slowest ramp."""
        return min(RAMP_MAX, floor(self.acceleration / _HZ_PER_S * (1 + 1e-9)))


@lru_cache(maxsize=512)
def fit(distance: int, duration_s: float, acceleration: float, bounds: Bounds) -> Trapezoid | None:
    """The trapezoid within `bounds` whose duration is nearest to `duration_s`, with ramps near `acceleration`.

    Where that would be too short by more than a millisecond, the next longer one: all others can wait for it. S and V
    are chosen together for each pair of ramps; the start speed is the vernier of the duration. None when no speed that
    is allowed moves the axis at all.
    """
    fastest = floor(bounds.speed)
    lowest, highest = max(1, bounds.start_min), min(bounds.start_max, fastest)
    if lowest > highest:
        return None
    search = _Search(distance, duration_s, fastest, lowest, highest, bounds.ramp_max)
    planned = max(1, min(bounds.ramp_max, round(acceleration / _HZ_PER_S)))
    for a, d in _around(planned, bounds.ramp_max):
        search.ramps(a, d)
        if search.error_s <= _GOOD_ENOUGH_S:
            break
    else:
        search.gentle()
        search.steeper(planned)
    search.steady()
    search.limited()
    best, longer = search.best, search.longer
    if best is not None and longer is not None and best.duration_s < duration_s - _SHORT_S:
        return longer
    return best


class _Search:
    """Keeps the best of the candidates that are offered."""

    def __init__(
        self, distance: int, duration_s: float, fastest: int, lowest: int, highest: int, ramp_max: int
    ) -> None:
        self._distance = distance
        self._duration_s = duration_s
        self._fastest = fastest
        self._lowest = lowest
        self._highest = highest
        self._ramp_max = ramp_max
        self.best: Trapezoid | None = None
        self.error_s = float("inf")
        self.longer: Trapezoid | None = None
        self._longer_s = float("inf")

    def ramps(self, a: int, d: int) -> None:
        """Candidates with these ramps: trapezoids where the move is long enough for one, triangles otherwise."""
        if min(a, d) < 1:
            return
        n, t, k = self._distance, self._duration_s, (1 / a + 1 / d) / (2 * _HZ_PER_S)
        # The speed that is needed with the lowest start speed is the largest that comes into question.
        quick = self._cruise(self._lowest, k)
        if quick is not None:
            slow = self._cruise(self._highest, k)
            low = ceil(n / t) if slow is None else floor(slow)
            for f in _spread(max(1, low), ceil(quick)):
                self.ramps_at(f, a, d)
        s = n / t - t / (4 * k)
        for start in (floor(s), ceil(s)):
            start = self._clamped(start)
            self.offer(start, max(start + 1, ceil(sqrt(start**2 + n / k))), a, d)

    def gentle(self) -> None:
        """Candidates whose ramps are as long as it takes to make up for a whole slew speed that is too fast."""
        n, t = self._distance, self._duration_s
        slowest = floor(n / t) + 1
        for f in range(slowest, min(self._fastest, slowest + _GENTLE_SPEEDS) + 1):
            for s in {self._lowest, (self._lowest + min(self._highest, f)) // 2}:
                if s >= f or t * f - n <= 1e-9 * n:
                    continue
                k = (t * f - n) / (f - s) ** 2
                same = 1 / (k * _HZ_PER_S)
                for a in {floor(same), ceil(same), *_STEPS}:
                    rest = 2 * k * _HZ_PER_S - 1 / a if a else 0.0
                    d = 1 / rest if rest > 0 else 0.0
                    for other in (floor(d), ceil(d)):
                        self.ramps_at(f, a, other)
                        self.ramps_at(f, other, a)

    def steeper(self, planned: int) -> None:
        """Candidates with ever steeper ramps, for a duration that the planned ones are too gentle for."""
        if self._distance**2 < _HZ_PER_S * self._duration_s**3:
            return  # so slow that whole speeds are the trouble, and no ramp makes up for them
        a = planned
        while a < self._ramp_max and self.error_s > _GOOD_ENOUGH_S:
            a = min(self._ramp_max, a + max(1, a // 8))
            for d in (a, a - 1, a - 2):
                self.ramps(a, d)
                self.ramps(d, a)

    def ramps_at(self, f: int, a: int, d: int) -> None:
        """Candidates with the slew speed `f` and these ramps."""
        if not (1 <= a <= self._ramp_max and 1 <= d <= self._ramp_max):
            return
        room = (self._duration_s * f - self._distance) * 2 * _HZ_PER_S / (1 / a + 1 / d)
        s = f - sqrt(room) if room > 0 else float(f)
        self.offer(floor(s), f, a, d)
        self.offer(ceil(s), f, a, d)

    def _cruise(self, s: int, k: float) -> float | None:
        """The slew speed for the duration with the start speed `s`; None when it is too short for the ramps."""
        b = 2 * k * s + self._duration_s
        square = b * b - 4 * k * (k * s * s + self._distance)
        return None if square < 0 else (b - sqrt(square)) / (2 * k)

    def steady(self) -> None:
        """Candidates without ramps: best for slow moves."""
        speed = self._distance / self._duration_s
        for f in (floor(speed), ceil(speed)):
            if self._lowest <= f <= self._highest:
                self.offer(f, f, 1, 1)

    def limited(self) -> None:
        """The fastest move that is allowed, for a duration that is too short; and the slowest, for one too long."""
        ramp = self._ramp_max
        for s in (self._lowest, self._highest):
            self.offer(s, self._fastest, ramp, ramp)
        self.offer(self._highest, self._highest, 1, 1)
        self.offer(self._lowest, self._lowest, 1, 1)

    def _clamped(self, s: int) -> int:
        return max(self._lowest, min(self._highest, s))

    def offer(self, s: int, f: int, a: int, d: int) -> None:
        """Take the candidate if it is legal and better."""
        s = min(self._clamped(s), f)
        if not self._lowest <= s <= f <= self._fastest:
            return
        if s < f and not (1 <= a <= self._ramp_max and 1 <= d <= self._ramp_max):
            return
        candidate = Trapezoid(self._distance, s, f, a, d)
        if d < self._ramp_max and candidate.stop_s > _STOP_S:
            return
        error_s = abs(candidate.duration_s - self._duration_s)
        if error_s < self.error_s - _GOOD_ENOUGH_S / 2:
            self.best, self.error_s = candidate, error_s
        if self._duration_s <= candidate.duration_s < self._longer_s:
            self.longer, self._longer_s = candidate, candidate.duration_s


def _spread(low: int, high: int) -> Iterator[int]:
    """Some whole numbers from `low` to `high`, the highest ones first: their start speeds are the lowest."""
    yield from range(high, max(low, high - _SPEEDS) - 1, -1)
    middle = (low + high) // 2
    if high - _SPEEDS > low:
        yield from {low, low + 1, middle, middle + 1}


def _around(planned: int, ramp_max: int) -> Iterator[tuple[int, int]]:
    """Pairs of ramps, the planned one for both first, then ever further away."""
    allowed = range(1, ramp_max + 1)
    for reach in range(_RAMP_REACH + 1):
        near = range(planned - reach, planned + reach + 1)
        for a in near:
            for d in near:
                if max(abs(a - planned), abs(d - planned)) == reach and a in allowed and d in allowed:
                    yield a, d
