"""The drive's own profile: a trapezoid from whole numbers for velocity, acceleration and deceleration.

Three whole numbers are chosen together: the velocity near the planned one, the acceleration for what the duration then
needs, the deceleration for what the rounding of both has left.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor, sqrt
from typing import NamedTuple

WORD_MAX = 0xFFFF_FFFF
_GOOD_ENOUGH_S = 1e-7
_VELOCITIES = 12  # tried on each side of the exact one
_ACCELERATIONS = (8, 60)  # the same; the more when few have not been enough
_ENOUGH_S = 20e-6


class Leg(NamedTuple):
    """A stretch of constant acceleration: length (s), speed at its start (counts/s), acceleration (counts/s²)."""

    duration_s: float
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Units:
    """The drive's units: of 6081h that make one count/s, and of 6083h and 6084h that make one count/s²."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Bounds:
    """What an axis may do: counts/s, counts/s²."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class Trapezoid:
    """A move of `distance` counts (> 0) with three numbers in the drive's units."""

    distance: int
    velocity: int
    acceleration: int
    deceleration: int
    units: Units

    @property
    def legs(self) -> tuple[Leg, ...]:
        v = self.velocity / self.units.velocity
        a, d = self.acceleration / self.units.acceleration, self.deceleration / self.units.acceleration
        ramps = v * v / 2 * (1 / a + 1 / d)
        if ramps >= self.distance:
            peak = sqrt(2 * self.distance / (1 / a + 1 / d))
            return Leg(peak / a, 0.0, a), Leg(peak / d, peak, -d)
        return Leg(v / a, 0.0, a), Leg((self.distance - ramps) / v, v, 0.0), Leg(v / d, v, -d)

    @property
    def duration_s(self) -> float:
        """By the drive's own crystal."""
        return sum(leg.duration_s for leg in self.legs)


def fit(distance: int, duration_s: float, peak: float, bounds: Bounds, units: Units) -> Trapezoid | None:
    """The trapezoid within `bounds` whose duration is nearest to `duration_s`, with about the planned peak velocity.

    None when no whole numbers within the bounds move the axis at all.
    """
    most = Limits.of(bounds, units)
    if min(most.velocity, most.acceleration) < 1:
        return None
    best: Trapezoid | None = None
    error_s = float("inf")
    for reach in _ACCELERATIONS:
        for candidate in _candidates(distance, duration_s, peak, most, units, reach):
            off_s = abs(candidate.duration_s - duration_s)
            if off_s < error_s - _GOOD_ENOUGH_S / 2:
                best, error_s = candidate, off_s
                if error_s <= _GOOD_ENOUGH_S:
                    return best
        if error_s <= _ENOUGH_S:
            break
    return best


class Limits(NamedTuple):
    """The largest numbers that are allowed, in the drive's units."""

    velocity: int
    acceleration: int

    @classmethod
    def of(cls, bounds: Bounds, units: Units) -> "Limits":
        def most(limit: float) -> int:
            return min(WORD_MAX, floor(limit * (1 + 1e-9)))

        return cls(most(bounds.velocity * units.velocity), most(bounds.acceleration * units.acceleration))


def _candidates(
    distance: int, duration_s: float, peak: float, most: Limits, units: Units, reach: int
) -> Iterator[Trapezoid]:
    def made(velocity: int, acceleration: int, deceleration: int) -> Trapezoid:
        return Trapezoid(distance, velocity, acceleration, deceleration, units)

    # Slower than the mean velocity it can not be in time; a hair above it the ramps are as steep as they may be.
    least = max(1, floor(distance / duration_s * units.velocity))
    for velocity in _around(peak * units.velocity, _VELOCITIES, max(1, least), most.velocity):
        v = velocity / units.velocity
        ramps_s = duration_s - distance / v
        # Both ramps together last 2 (T - D/v): of the velocity's half each.
        inverse = 2 * ramps_s / v if ramps_s * v <= distance else duration_s**2 / (2 * distance)
        if inverse <= 0:
            continue
        for acceleration in _around(2 / inverse * units.acceleration, reach, 1, most.acceleration):
            rest = inverse - units.acceleration / acceleration
            if rest > 0:
                exact = units.acceleration / rest
                for deceleration in {floor(exact), ceil(exact)}:
                    if 1 <= deceleration <= most.acceleration:
                        yield made(velocity, acceleration, deceleration)
    yield made(most.velocity, most.acceleration, most.acceleration)  # the fastest that is allowed
    yield made(1, 1, 1)  # and the slowest that there is


def _around(exact: float, reach: int, least: int, most: int) -> list[int]:
    """Whole numbers near `exact`, the nearest first."""
    middle = max(least, min(most, round(exact)))
    near = range(max(least, middle - reach), min(most, middle + reach) + 1)
    return sorted(near, key=lambda each: abs(each - exact))
