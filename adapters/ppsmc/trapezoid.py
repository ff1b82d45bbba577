"""The controller's own profile from whole numbers, in closed form, and the choice of these numbers for a duration.

An axis starts at `frun`, accelerates with `acc` to `ffast`, decelerates with `dec` to `frun`, and stops (L2007-L2011).
Ramps are given in Hz/ms: a step of them is 1000 steps/s². With k = (1/a + 1/d)/2, from N steps on that suffice for both
ramps the move takes N/V + k (V - S)²/V; shorter ones reverse at Vp = sqrt(S² + N/k), after 2 k (Vp - S).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, floor, sqrt
from typing import NamedTuple

POSITION_MAX = 2**23 - 1  # steps, L2022
RAMP_MAX = 1000  # Hz/ms, L258
_HZ_PER_S = 1000.0  # of one Hz/ms

# The search ends at a duration this near to the requested one; the firmware is a hundred times less certain.
_GOOD_ENOUGH_S = 5e-6
_RAMP_REACH = 3  # how far from the planned ramps others are searched, Hz/ms
_SPEEDS = 3
_SHORT_S = 0.001
_GENTLE_SPEEDS = 8
_STEPS = (1, 2, 3, 5, 8, 13, 34, 144)  # ramps to combine others with, Hz/ms
_STOP_S = 2.0  # ramps are no longer than this where the axis's limits allow it: they determine the duration of a stop


class PpSmcLeg(NamedTuple):
    """A segment of constant acceleration: length (s), speed at its start (steps/s), acceleration (steps/s²)."""

    duration_s: float
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class PpSmcTrapezoid:
    """One move of `distance` steps (> 0) with `frun` s and `ffast` f in Hz, `acc` a and `dec` d in Hz/ms."""

    distance: int
    s: int
    f: int
    a: int
    d: int

    @property
    def _ramp_factor(self) -> float:
        return (1 / self.a + 1 / self.d) / (2 * _HZ_PER_S)

    @property
    def peak_speed(self) -> float:
        """Return the largest speed that is reached, steps/s."""
        return min(float(self.f), sqrt(self.s**2 + self.distance / self._ramp_factor))

    @property
    def motion_legs(self) -> tuple[PpSmcLeg, ...]:
        if self.f == self.s:
            return (PpSmcLeg(self.distance / self.f, self.f, 0.0),)
        peak, up, down = self.peak_speed, self.a * _HZ_PER_S, self.d * _HZ_PER_S
        cruise = max(0.0, self.distance - self._ramp_factor * (peak**2 - self.s**2))
        return (
            PpSmcLeg((peak - self.s) / up, self.s, up),
            PpSmcLeg(cruise / peak, peak, 0.0),
            PpSmcLeg((peak - self.s) / down, peak, -down),
        )

    @property
    def stop_s(self) -> float:
        """Return the duration of a stop's ramp from the largest speed."""
        return (self.peak_speed - self.s) / (self.d * _HZ_PER_S)

    @property
    def duration_s(self) -> float:
        peak, k = self.peak_speed, self._ramp_factor
        if peak < self.f:
            return 2 * k * (peak - self.s)
        return self.distance / peak + k * (peak - self.s) ** 2 / peak


@dataclass(frozen=True, slots=True)
class PpSmcBounds:
    """Limits of an axis: speed (steps/s), acceleration (steps/s²), allowed start speeds (steps/s)."""

    speed: float
    acceleration: float
    start_min: int
    start_max: int

    @property
    def ramp_max(self) -> int:
        """Return the steepest ramp in Hz/ms; 0 for an axis whose acceleration limit is below the controller's slowest
        ramp."""
        return min(RAMP_MAX, floor(self.acceleration / _HZ_PER_S * (1 + 1e-9)))

    @property
    def start_speeds(self) -> tuple[int, int]:
        """The lowest and the highest whole start speed, steps/s."""
        return max(1, self.start_min), min(self.start_max, floor(self.speed))


@lru_cache(maxsize=512)
def fit_trapezoid(distance: int, duration_s: float, acceleration: float, bounds: PpSmcBounds) -> PpSmcTrapezoid | None:
    """Return the trapezoid within `bounds` whose duration is nearest to `duration_s`, with ramps near `acceleration`.

    Where that would be too short by more than a millisecond, the next longer one: all other axes can wait for it. S and
    V are chosen together for each pair of ramps; the start speed is the vernier of the duration. None when no allowed
    speed moves the axis at all.
    """
    lowest, highest = bounds.start_speeds
    if lowest > highest:
        return None
    search = _TrapezoidSearch(distance, duration_s, bounds)
    planned_ramp = max(1, min(bounds.ramp_max, round(acceleration / _HZ_PER_S)))
    for a, d in _ramps_around(planned_ramp, bounds.ramp_max):
        search.try_ramps(a, d)
        if search.error_s <= _GOOD_ENOUGH_S:
            break
    else:
        search.try_gentle_ramps()
        search.try_steeper_ramps(planned_ramp)
    search.try_steady()
    search.try_limits()
    best, longer = search.best, search.longer
    if best is not None and longer is not None and best.duration_s < duration_s - _SHORT_S:
        return longer
    return best


class _TrapezoidSearch:
    """Keep the best of the offered candidates."""

    def __init__(self, distance: int, duration_s: float, bounds: PpSmcBounds) -> None:
        self._distance = distance
        self._duration_s = duration_s
        self._fastest = floor(bounds.speed)
        self._lowest, self._highest = bounds.start_speeds
        self._ramp_max = bounds.ramp_max
        self.best: PpSmcTrapezoid | None = None
        self.error_s = float("inf")
        self.longer: PpSmcTrapezoid | None = None
        self._longer_s = float("inf")

    def try_ramps(self, a: int, d: int) -> None:
        """Offer candidates with these ramps: trapezoids where the move is long enough for one, triangles otherwise."""
        if min(a, d) < 1:
            return
        n, t, k = self._distance, self._duration_s, (1 / a + 1 / d) / (2 * _HZ_PER_S)
        # The required speed at the lowest start speed is the largest candidate.
        quick = self._cruise_speed(self._lowest, k)
        if quick is not None:
            slow = self._cruise_speed(self._highest, k)
            low = ceil(n / t) if slow is None else floor(slow)
            for f in _spread_values(max(1, low), ceil(quick)):
                self.try_ramps_at(f, a, d)
        s = n / t - t / (4 * k)
        for start in (floor(s), ceil(s)):
            start = self._clamp_start(start)
            self.offer_candidate(start, max(start + 1, ceil(sqrt(start**2 + n / k))), a, d)

    def try_gentle_ramps(self) -> None:
        """Offer candidates whose ramps are long enough to compensate for a slew speed rounded up to a whole number."""
        n, t = self._distance, self._duration_s
        slowest = floor(n / t) + 1
        for f in range(slowest, min(self._fastest, slowest + _GENTLE_SPEEDS) + 1):
            for s in {self._lowest, (self._lowest + min(self._highest, f)) // 2}:
                if s >= f or t * f - n <= 1e-9 * n:
                    continue
                k = (t * f - n) / (f - s) ** 2
                common_ramp = 1 / (k * _HZ_PER_S)
                for a in {floor(common_ramp), ceil(common_ramp), *_STEPS}:
                    ramp_rest = 2 * k * _HZ_PER_S - 1 / a if a else 0.0
                    d = 1 / ramp_rest if ramp_rest > 0 else 0.0
                    for other_ramp in (floor(d), ceil(d)):
                        self.try_ramps_at(f, a, other_ramp)
                        self.try_ramps_at(f, other_ramp, a)

    def try_steeper_ramps(self, planned: int) -> None:
        """Offer candidates with increasingly steep ramps, for a duration that is too short for the planned ramps."""
        if self._distance**2 < _HZ_PER_S * self._duration_s**3:
            return  # so slow that whole speeds are the limitation, and no ramp compensates for them
        a = planned
        while a < self._ramp_max and self.error_s > _GOOD_ENOUGH_S:
            a = min(self._ramp_max, a + max(1, a // 8))
            for d in (a, a - 1, a - 2):
                self.try_ramps(a, d)
                self.try_ramps(d, a)

    def try_ramps_at(self, f: int, a: int, d: int) -> None:
        """Offer candidates with the slew speed `f` and these ramps."""
        if not (1 <= a <= self._ramp_max and 1 <= d <= self._ramp_max):
            return
        room = (self._duration_s * f - self._distance) * 2 * _HZ_PER_S / (1 / a + 1 / d)
        s = f - sqrt(room) if room > 0 else float(f)
        self.offer_candidate(floor(s), f, a, d)
        self.offer_candidate(ceil(s), f, a, d)

    def _cruise_speed(self, s: int, k: float) -> float | None:
        """Return the slew speed for the duration with the start speed `s`; None when it is too short for the ramps."""
        b = 2 * k * s + self._duration_s
        square = b * b - 4 * k * (k * s * s + self._distance)
        return None if square < 0 else (b - sqrt(square)) / (2 * k)

    def try_steady(self) -> None:
        """Offer candidates without ramps: best for slow moves."""
        speed = self._distance / self._duration_s
        for f in (floor(speed), ceil(speed)):
            if self._lowest <= f <= self._highest:
                self.offer_candidate(f, f, 1, 1)

    def try_limits(self) -> None:
        """Offer the fastest allowed move, for a duration that is too short; and the slowest, for one too long."""
        ramp = self._ramp_max
        for s in (self._lowest, self._highest):
            self.offer_candidate(s, self._fastest, ramp, ramp)
        self.offer_candidate(self._highest, self._highest, 1, 1)
        self.offer_candidate(self._lowest, self._lowest, 1, 1)

    def _clamp_start(self, s: int) -> int:
        return max(self._lowest, min(self._highest, s))

    def offer_candidate(self, s: int, f: int, a: int, d: int) -> None:
        """Keep the candidate if it is valid and better."""
        s = min(self._clamp_start(s), f)
        if not self._lowest <= s <= f <= self._fastest:
            return
        if s < f and not (1 <= a <= self._ramp_max and 1 <= d <= self._ramp_max):
            return
        candidate = PpSmcTrapezoid(self._distance, s, f, a, d)
        if d < self._ramp_max and candidate.stop_s > _STOP_S:
            return
        error_s = abs(candidate.duration_s - self._duration_s)
        if error_s < self.error_s - _GOOD_ENOUGH_S / 2:
            self.best, self.error_s = candidate, error_s
        if self._duration_s <= candidate.duration_s < self._longer_s:
            self.longer, self._longer_s = candidate, candidate.duration_s


def _spread_values(low: int, high: int) -> Iterator[int]:
    """Yield some whole numbers from `low` to `high`, the highest first: their start speeds are the lowest."""
    yield from range(high, max(low, high - _SPEEDS) - 1, -1)
    middle = (low + high) // 2
    if high - _SPEEDS > low:
        yield from {low, low + 1, middle, middle + 1}


def _ramps_around(planned: int, ramp_max: int) -> Iterator[tuple[int, int]]:
    """Yield pairs of ramps, the planned one for both first, then at increasing distance."""
    ramp_range = range(1, ramp_max + 1)
    for reach in range(_RAMP_REACH + 1):
        near_ramps = range(planned - reach, planned + reach + 1)
        for a in near_ramps:
            for d in near_ramps:
                if max(abs(a - planned), abs(d - planned)) == reach and a in ramp_range and d in ramp_range:
                    yield a, d
