"""The controller's own profile: a symmetric trapezoid from whole numbers S, F (pls/s) and R (ms).

The manual gives the three numbers and no formula (L3013, L3151-L3159): the axis starts at S, reaches F after R, and
returns to S in R. A move too short for that reverses its ramp where both ramps intersect.
"""

from dataclasses import dataclass
from math import ceil, floor, sqrt
from typing import NamedTuple

SPEED_MAX = 1_000_000  # pls/s, L3151-L3153
RAMP_MAX_MS = 1000  # L3157-L3159
DISTANCE_MAX = 999_999_999  # pls, L3057

# The search stops at a duration this near to the requested one; no serial line resolves 100 ns.
_GOOD_ENOUGH_S = 1e-7
# How far from the planned ramp another one is searched: that costs path error, not duration.
_RAMP_REACH_MS = 48
_SPEED_REACH = 4


class ShrcLeg(NamedTuple):
    """A segment of constant acceleration: length (s), speed at its start (pls/s), acceleration (pls/s²)."""

    duration_s: float
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class ShrcTrapezoid:
    """One move of `distance` pls (> 0) with S, F in pls/s and R in ms."""

    distance: int
    s: int
    f: int
    r: int

    @property
    def acceleration(self) -> float:
        """Return pls/s²; 0 for a move at constant speed."""
        return (self.f - self.s) / (self.r / 1000)

    @property
    def peak_speed(self) -> float:
        """Return the largest speed that is reached, pls/s."""
        if self.distance * 1000 >= (self.s + self.f) * self.r:
            return float(self.f)
        return sqrt(self.s**2 + self.acceleration * self.distance)

    @property
    def motion_legs(self) -> tuple[ShrcLeg, ...]:
        if self.f == self.s:
            return (ShrcLeg(self.distance / self.f, self.f, 0.0),)
        peak, a = self.peak_speed, self.acceleration
        ramp_s = (peak - self.s) / a
        cruise_s = (self.distance - (self.s + peak) * ramp_s) / peak
        if cruise_s <= 0.0:
            return (ShrcLeg(ramp_s, self.s, a), ShrcLeg(ramp_s, peak, -a))
        return (ShrcLeg(ramp_s, self.s, a), ShrcLeg(cruise_s, peak, 0.0), ShrcLeg(ramp_s, peak, -a))

    @property
    def duration_s(self) -> float:
        """Return D/F + R (1 - S/F); for a triangle 2 (peak - S)/a."""
        if self.f == self.s:
            return self.distance / self.f
        if self.distance * 1000 >= (self.s + self.f) * self.r:
            return self.distance / self.f + self.r / 1000 * (1 - self.s / self.f)
        return 2 * (self.peak_speed - self.s) / self.acceleration


@dataclass(frozen=True, slots=True)
class ShrcBounds:
    """Limits of an axis: speed (pls/s), acceleration (pls/s²), and the allowed start speeds (pls/s)."""

    speed: float
    acceleration: float
    start_min: int
    start_max: int


def start_speeds(bounds: ShrcBounds) -> tuple[int, int, int]:
    """Return the lowest and the highest S, and the highest F, pls/s."""
    fastest = min(SPEED_MAX, floor(bounds.speed))
    return max(1, bounds.start_min), min(bounds.start_max, fastest), fastest


def fit_trapezoid(distance: int, duration_s: float, ramp_s: float, bounds: ShrcBounds) -> ShrcTrapezoid | None:
    """Return the trapezoid within `bounds` whose duration is nearest to `duration_s`, then whose ramp is nearest to
    `ramp_s`.

    S, F and R are chosen together: R around the planned ramp, F around the value for that ramp, S to compensate for the
    rounding of F. None when no allowed speed moves the axis at all.
    """
    lowest, highest, fastest = start_speeds(bounds)
    if lowest > highest:
        return None
    search = _TrapezoidSearch(distance, duration_s, fastest, bounds.acceleration)
    planned_ms = max(1, min(RAMP_MAX_MS, round(ramp_s * 1000)))
    for r in _ramps_around(planned_ms):
        search.try_ramp(r, lowest, highest)
        if search.error_s <= _GOOD_ENOUGH_S:
            break
    search.try_steady(lowest, highest)
    search.try_limits(lowest, highest)
    return search.best


class _TrapezoidSearch:
    """Keep the best of the offered candidates."""

    def __init__(self, distance: int, duration_s: float, fastest: int, acceleration: float) -> None:
        self._distance = distance
        self._duration_s = duration_s
        self._fastest = fastest
        self._acceleration = acceleration
        self.best: ShrcTrapezoid | None = None
        self.error_s = float("inf")

    def try_ramp(self, r: int, lowest: int, highest: int) -> None:
        """Offer candidates with the ramp `r`: trapezoids where the move is long enough for one, triangles otherwise."""
        d, t, r_s = self._distance, self._duration_s, r / 1000
        if t > 2 * r_s:
            base = floor((d - r_s * lowest) / (t - r_s))
            for f in range(base - _SPEED_REACH, base + 2):
                s = round((d - f * (t - r_s)) / r_s)
                self.offer_candidate(max(lowest, min(highest, f, s)), f, r)
        for s in (lowest, (lowest + highest) // 2, highest):
            least_rise = 4 * (d - t * s) / (t * t)  # from T = 2 (sqrt(S² + a D) - S) / a
            if least_rise > 0:
                self.offer_candidate(s, floor(s + least_rise * r_s), r)
                self.offer_candidate(s, ceil(s + least_rise * r_s), r)

    def try_steady(self, lowest: int, highest: int) -> None:
        """Offer candidates without ramps: best for moves of a few pulses."""
        speed = self._distance / self._duration_s
        for f in (floor(speed), ceil(speed)):
            if lowest <= f <= highest:
                self.offer_candidate(f, f, 1)

    def try_limits(self, lowest: int, highest: int) -> None:
        """Offer the fastest allowed move, for a duration that is too short; and the slowest, for one too long."""
        for s in (lowest, highest):
            f = min(self._fastest, floor(s + self._acceleration * RAMP_MAX_MS / 1000))
            if f > s:
                self.offer_candidate(s, f, min(RAMP_MAX_MS, ceil((f - s) / self._acceleration * 1000)))
        self.offer_candidate(lowest, lowest, 1)

    def offer_candidate(self, s: int, f: int, r: int) -> None:
        """Keep the candidate if it is valid and better."""
        if not (1 <= s <= f <= self._fastest and 1 <= r <= RAMP_MAX_MS):
            return
        candidate = ShrcTrapezoid(self._distance, s, f, r)
        if candidate.acceleration > self._acceleration * (1 + 1e-6):
            return
        error_s = abs(candidate.duration_s - self._duration_s)
        if error_s < self.error_s - _GOOD_ENOUGH_S / 2:
            self.best, self.error_s = candidate, error_s


def _ramps_around(planned_ms: int) -> list[int]:
    """Return ramps in ms, the planned one first, then at increasing distance."""
    reach = [planned_ms]
    for step in range(1, _RAMP_REACH_MS + 1):
        reach += [r for r in (planned_ms + step, planned_ms - step) if 1 <= r <= RAMP_MAX_MS]
    return reach
