"""The drive's own profile: a trapezoid from whole numbers for velocity, acceleration and deceleration.

Three whole numbers are chosen together: the velocity near the planned one, the acceleration that the duration then
requires, and the deceleration that compensates for the rounding of both.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, floor, sqrt
from typing import NamedTuple

WORD_MAX = 0xFFFF_FFFF
_GOOD_ENOUGH_S = 1e-7
_VELOCITIES = 12  # tried on each side of the exact value
_ACCELERATIONS = (8, 60)  # the same; the larger number when the smaller one has not sufficed
_ENOUGH_S = 20e-6


class DriveLeg(NamedTuple):
    """A segment of constant acceleration: length (s), speed at its start (counts/s), acceleration (counts/s²)."""

    duration_s: float
    speed: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class DriveUnits:
    """The drive's units: units of 6081h per count/s, and of 6083h and 6084h per count/s²."""

    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True)
class DriveBounds:
    """Limits of an axis: counts/s, counts/s². equal_ramps: the drive has one number for both ramps."""

    velocity: float
    acceleration: float
    equal_ramps: bool = False


@dataclass(frozen=True, slots=True)
class DriveTrapezoid:
    """A move of `distance` counts (> 0) with three numbers in the drive's units."""

    distance: int
    velocity: int
    acceleration: int
    deceleration: int
    units: DriveUnits

    @property
    def motion_legs(self) -> tuple[DriveLeg, ...]:
        v = self.velocity / self.units.velocity
        a, d = self.acceleration / self.units.acceleration, self.deceleration / self.units.acceleration
        ramps = v * v / 2 * (1 / a + 1 / d)
        if ramps >= self.distance:
            peak = sqrt(2 * self.distance / (1 / a + 1 / d))
            return DriveLeg(peak / a, 0.0, a), DriveLeg(peak / d, peak, -d)
        return DriveLeg(v / a, 0.0, a), DriveLeg((self.distance - ramps) / v, v, 0.0), DriveLeg(v / d, v, -d)

    @property
    def duration_s(self) -> float:
        """Return the duration by the drive's own crystal."""
        return sum(leg.duration_s for leg in self.motion_legs)


def fit_trapezoid(
    distance: int, duration_s: float, peak: float, bounds: DriveBounds, units: DriveUnits
) -> DriveTrapezoid | None:
    """Return the trapezoid within `bounds` whose duration is nearest to `duration_s`, with about the planned peak
    velocity.

    None when no whole numbers within the bounds move the axis at all.
    """
    most = DriveLimits.from_bounds(bounds, units)
    if min(most.velocity, most.acceleration) < 1:
        return None
    best: DriveTrapezoid | None = None
    error_s = float("inf")
    for reach in _ACCELERATIONS:
        for candidate in _trapezoid_candidates(_MoveGoal(distance, duration_s, peak), most, units, reach):
            off_s = abs(candidate.duration_s - duration_s)
            if off_s < error_s - _GOOD_ENOUGH_S / 2:
                best, error_s = candidate, off_s
                if error_s <= _GOOD_ENOUGH_S:
                    return best
        if error_s <= _ENOUGH_S:
            break
    return best


class _MoveGoal(NamedTuple):
    """The planned move: distance, duration and peak velocity."""

    distance: int
    duration_s: float
    peak: float


class DriveLimits(NamedTuple):
    """The largest allowed numbers, in the drive's units. equal_ramps: both ramps have one number."""

    velocity: int
    acceleration: int
    equal_ramps: bool

    @classmethod
    def from_bounds(cls, bounds: DriveBounds, units: DriveUnits) -> "DriveLimits":
        def largest_number(limit: float) -> int:
            return min(WORD_MAX, floor(limit * (1 + 1e-9)))

        return cls(
            largest_number(bounds.velocity * units.velocity),
            largest_number(bounds.acceleration * units.acceleration),
            bounds.equal_ramps,
        )


def _trapezoid_candidates(
    goal: _MoveGoal, most: DriveLimits, units: DriveUnits, reach: int
) -> Iterator[DriveTrapezoid]:
    distance, duration_s, peak = goal

    def make_trapezoid(velocity: int, acceleration: int, deceleration: int) -> DriveTrapezoid:
        return DriveTrapezoid(distance, velocity, acceleration, deceleration, units)

    # Below the mean velocity it cannot arrive in time; slightly above it the ramps have their steepest slope.
    least = max(1, floor(distance / duration_s * units.velocity))
    for velocity in _numbers_around(peak * units.velocity, _VELOCITIES, max(1, least), most.velocity):
        v = velocity / units.velocity
        ramps_s = duration_s - distance / v
        # Both ramps together last 2 (T - D/v): each half of that for the velocity.
        inverse = 2 * ramps_s / v if ramps_s * v <= distance else duration_s**2 / (2 * distance)
        if inverse <= 0:
            continue
        for acceleration in _numbers_around(2 / inverse * units.acceleration, reach, 1, most.acceleration):
            for deceleration in _fit_decelerations(
                acceleration, inverse - units.acceleration / acceleration, most, units
            ):
                yield make_trapezoid(velocity, acceleration, deceleration)
    yield make_trapezoid(most.velocity, most.acceleration, most.acceleration)  # the fastest allowed move
    yield make_trapezoid(1, 1, 1)  # and the slowest possible one


def _fit_decelerations(acceleration: int, inverse_rest: float, most: DriveLimits, units: DriveUnits) -> list[int]:
    """Return the decelerations that may keep the duration. inverse_rest: of the exact one, s²/count."""
    if most.equal_ramps:
        return [acceleration]
    if inverse_rest <= 0:
        return []
    exact = units.acceleration / inverse_rest
    return [number for number in {floor(exact), ceil(exact)} if 1 <= number <= most.acceleration]


def _numbers_around(exact: float, reach: int, least: int, most: int) -> list[int]:
    """Return whole numbers near `exact`, the nearest first."""
    middle = max(least, min(most, round(exact)))
    near_numbers = range(max(least, middle - reach), min(most, middle + reach) + 1)
    return sorted(near_numbers, key=lambda number: abs(number - exact))
