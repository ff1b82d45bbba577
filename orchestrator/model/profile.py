"""One axis's motion in time: a piecewise polynomial, evaluated without Ruckig. Also its form on the bus.

Positions are relative to the start and divided by `scale_counts`, so that a profile of a straight line is one
shape with a scale for each axis, and so that the numbers stay well conditioned whatever a count is.
"""

from bisect import bisect_right
from collections.abc import Sequence
from itertools import accumulate
from typing import NamedTuple

from pydantic import ConfigDict, TypeAdapter
from pydantic.dataclasses import dataclass


class Instant(NamedTuple):
    """Motion at an instant: counts, counts/s, counts/s²; the position is relative to the profile's start."""

    position: float
    velocity: float
    acceleration: float


@dataclass(frozen=True, slots=True, config=ConfigDict(extra="forbid", allow_inf_nan=False))
class Profile:
    """A motion from rest to rest.

    start_counts, end_counts: absolute commanded positions of the controller, exact.
    scale_counts: counts per unit of the shape (its sign is the direction).
    durations_s, jerks: one entry a segment; segment k has constant jerk. positions, velocities, accelerations:
    at the start of each segment, in units of the shape, per second, per second².
    """

    start_counts: int
    end_counts: int
    scale_counts: float
    durations_s: Sequence[float]
    positions: Sequence[float]
    velocities: Sequence[float]
    accelerations: Sequence[float]
    jerks: Sequence[float]

    @property
    def duration_s(self) -> float:
        """From the start of the axis to its end, in seconds."""
        return sum(self.durations_s)

    def at(self, time_s: float) -> Instant:
        """Position relative to the start (counts), velocity and acceleration `time_s` after the start.

        Before the start and after the end the axis stands; the end is exact.
        """
        if time_s <= 0.0:
            return Instant(0.0, 0.0, 0.0)
        ends = list(accumulate(self.durations_s))
        if not ends or time_s >= ends[-1]:
            return Instant(float(self.end_counts - self.start_counts), 0.0, 0.0)
        k = bisect_right(ends, time_s)
        t = time_s - (ends[k - 1] if k else 0.0)
        p, v, a, j = self.positions[k], self.velocities[k], self.accelerations[k], self.jerks[k]
        scale = self.scale_counts
        return Instant(
            scale * (p + t * (v + t * (a / 2 + t * j / 6))),
            scale * (v + t * (a + t * j / 2)),
            scale * (a + t * j),
        )

    @property
    def peak_velocity(self) -> float:
        """The largest speed, counts/s. It lies at a segment's start, or where the acceleration passes zero."""
        speed = max((abs(v) for v in self.velocities), default=0.0)
        for t, v, a, j in zip(self.durations_s, self.velocities, self.accelerations, self.jerks, strict=False):
            if j and 0.0 < -a / j < t:
                speed = max(speed, abs(v - a * a / (2 * j)))
        return speed * abs(self.scale_counts)

    @property
    def peak_acceleration(self) -> float:
        """The largest acceleration or deceleration, counts/s². Linear in a segment, so it lies at an end."""
        peak = 0.0
        for t, a, j in zip(self.durations_s, self.accelerations, self.jerks, strict=False):
            peak = max(peak, abs(a), abs(a + j * t))
        return peak * abs(self.scale_counts)

    @property
    def extent_counts(self) -> tuple[float, float]:
        """The smallest and largest absolute position on the way, turning points inside segments included."""
        points = [0.0, float(self.end_counts - self.start_counts)]
        clock_s = 0.0
        for t, v, a, j in zip(self.durations_s, self.velocities, self.accelerations, self.jerks, strict=False):
            points.append(self.at(clock_s).position)
            for root in _turning_points(v, a, j):
                if 0.0 < root < t:
                    points.append(self.at(clock_s + root).position)
            clock_s += t
        return self.start_counts + min(points), self.start_counts + max(points)

    def stretched(self, factor: float) -> "Profile":
        """The same path in `factor` times the time (>= 1: limits that held still hold)."""
        return Profile(
            self.start_counts,
            self.end_counts,
            self.scale_counts,
            [t * factor for t in self.durations_s],
            list(self.positions),
            [v / factor for v in self.velocities],
            [a / factor**2 for a in self.accelerations],
            [j / factor**3 for j in self.jerks],
        )


PROFILES = TypeAdapter(dict[str, Profile])


def _turning_points(v: float, a: float, j: float) -> tuple[float, ...]:
    """Where v + a t + j t²/2 is zero."""
    if j == 0.0:
        return (-v / a,) if a else ()
    square = a * a - 2 * j * v
    if square < 0.0:
        return ()
    root = square**0.5
    return ((-a - root) / j, (-a + root) / j)
