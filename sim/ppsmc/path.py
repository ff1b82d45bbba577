"""Paths of one axis in closed form: displacement (steps) and velocity (steps/s) over device time (s)."""

import math
from dataclasses import dataclass

from sim.core.ramps import Segment, first_at


@dataclass(frozen=True, slots=True)
class Profile:
    """A speed profile (L2009): start-stop speed and slew speed, steps/s; acceleration and deceleration, steps/s²."""

    start: float
    slew: float
    acceleration: float
    deceleration: float

    @property
    def low(self) -> float:
        """Where ramps begin and end: a slew speed below the start-stop speed needs no ramp."""
        return min(self.start, self.slew)


@dataclass(frozen=True, slots=True)
class Path:
    """Segments of constant acceleration, none of which reverses; the end is whole steps."""

    segments: tuple[Segment, ...]
    duration: float
    end: int

    @property
    def sign(self) -> int:
        """Direction in which it starts; 0 if it does not move."""
        for segment in self.segments:
            for sign in (1, -1):
                if segment.points(sign):
                    return sign
        return 0

    def at(self, t: float) -> tuple[float, float]:
        """Displacement and velocity `t` seconds after the start."""
        if t >= self.duration:
            return float(self.end), 0.0
        if t < 0.0:
            return self.segments[0].x, 0.0
        segment = self.segments[0]
        for segment in reversed(self.segments):
            if segment.t <= t:
                break
        return segment.x_at(t), segment.v + segment.a * (t - segment.t)

    def first_at(self, bound: float, sign: int, after: float) -> float | None:
        """First time >= `after` at or beyond `bound` in direction `sign` while moving in that direction."""
        return first_at(self.segments, self.duration, bound, sign, after)


class _Builder:
    """Puts segments one after the other."""

    def __init__(self, x: float = 0.0) -> None:
        self.segments: list[Segment] = []
        self.t = 0.0
        self.x = x

    def ramp(self, v: float, to_v: float, slope: float) -> None:
        """Velocity changes linearly from `v` to `to_v` with `slope` > 0, steps/s²."""
        duration = abs(to_v - v) / slope
        if duration:
            self.segments.append(Segment(self.t, self.x, v, math.copysign(slope, to_v - v)))
            self.t += duration
            self.x += 0.5 * (v + to_v) * duration

    def cruise(self, v: float, distance: float) -> None:
        """`distance` (of v's sign) at constant velocity."""
        if distance:
            self.segments.append(Segment(self.t, self.x, v, 0.0))
            self.t += distance / v
            self.x += distance

    def done(self, end: int) -> Path:
        return Path(tuple(self.segments) or (Segment(0.0, self.x, 0.0, 0.0),), self.t, end)

    def endless(self, v: float) -> Path:
        self.segments.append(Segment(self.t, self.x, v, 0.0))
        return Path(tuple(self.segments), math.inf, 0)


def trapezoid(distance: int, profile: Profile) -> Path:
    """The move of `distance` steps: from start-stop speed to slew speed and back (L970-L971)."""
    sign, length = math.copysign(1.0, distance), float(abs(distance))
    low, slew = profile.low, profile.slew
    up, down = profile.acceleration, profile.deceleration
    per_square = 0.5 / up + 0.5 / down
    builder = _Builder()
    peak = min(slew, math.sqrt(low * low + length / per_square))
    builder.ramp(sign * low, sign * peak, up)
    if peak == slew:
        builder.cruise(sign * slew, sign * max(0.0, length - per_square * (slew * slew - low * low)))
    builder.ramp(sign * peak, sign * low, down)
    return builder.done(distance)


def constant(distance: int, speed: float) -> Path:
    """`distance` steps at constant `speed`."""
    builder = _Builder()
    builder.cruise(math.copysign(speed, distance), float(distance))
    return builder.done(distance)


def jog(sign: int, profile: Profile) -> Path:
    """From standstill to slew speed, for ever."""
    builder = _Builder()
    builder.ramp(sign * profile.low, sign * profile.slew, profile.acceleration)
    return builder.endless(sign * profile.slew)


def respin(x: float, velocity: float, sign: int, profile: Profile) -> Path:
    """From displacement `x` and `velocity` to slew speed in direction `sign`, for ever.

    A reversal passes the start-stop speed.
    """
    builder = _Builder(x)
    if velocity * sign < 0:
        low = math.copysign(min(profile.start, abs(velocity)), velocity)
        builder.ramp(velocity, low, profile.deceleration)
        velocity = sign * profile.low
    slope = profile.acceleration if abs(velocity) < profile.slew else profile.deceleration
    builder.ramp(velocity, sign * profile.slew, slope)
    return builder.endless(sign * profile.slew)


def decelerated(x: float, velocity: float, profile: Profile) -> Path:
    """From displacement `x` and `velocity` down to start-stop speed, then stop (L2546)."""
    builder = _Builder(x)
    low = math.copysign(min(abs(velocity), profile.start), velocity)
    builder.ramp(velocity, low, profile.deceleration)
    return builder.done(round(builder.x))
