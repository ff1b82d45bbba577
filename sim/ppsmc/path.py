"""Paths of one axis in closed form: displacement (steps) and velocity (steps/s) over device time (s)."""

import math
from dataclasses import dataclass

from sim.core.ramps import RampSegment, first_at


@dataclass(frozen=True, slots=True)
class SpeedProfile:
    """A speed profile (L2009): start-stop speed and slew speed, steps/s; acceleration and deceleration, steps/s²."""

    start: float
    slew: float
    acceleration: float
    deceleration: float

    @property
    def ramp_speed(self) -> float:
        """Speed at which ramps begin and end: a slew speed below the start-stop speed needs no ramp."""
        return min(self.start, self.slew)


@dataclass(frozen=True, slots=True)
class StepPath:
    """Segments of constant acceleration, none of which reverses; the end is whole steps."""

    segments: tuple[RampSegment, ...]
    duration: float
    end: int

    @property
    def start_sign(self) -> int:
        """Direction of the start; 0 if it does not move."""
        for segment in self.segments:
            for sign in (1, -1):
                if segment.moves_in_direction(sign):
                    return sign
        return 0

    def state_at(self, t: float) -> tuple[float, float]:
        """Return displacement and velocity `t` seconds after the start."""
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
        """Return the first time >= `after` at or beyond `bound` in direction `sign` while moving in that direction."""
        return first_at(self.segments, self.duration, bound, sign, after)


class _PathBuilder:
    """Appends segments one after the other."""

    def __init__(self, x: float = 0.0) -> None:
        self.segments: list[RampSegment] = []
        self.t = 0.0
        self.x = x

    def add_ramp(self, v: float, to_v: float, slope: float) -> None:
        """Change the velocity linearly from `v` to `to_v` with `slope` > 0, steps/s²."""
        duration = abs(to_v - v) / slope
        if duration:
            self.segments.append(RampSegment(self.t, self.x, v, math.copysign(slope, to_v - v)))
            self.t += duration
            self.x += 0.5 * (v + to_v) * duration

    def add_cruise(self, v: float, distance: float) -> None:
        """Travel `distance` (of v's sign) at constant velocity."""
        if distance:
            self.segments.append(RampSegment(self.t, self.x, v, 0.0))
            self.t += distance / v
            self.x += distance

    def build_path(self, end: int) -> StepPath:
        return StepPath(tuple(self.segments) or (RampSegment(0.0, self.x, 0.0, 0.0),), self.t, end)

    def build_endless(self, v: float) -> StepPath:
        self.segments.append(RampSegment(self.t, self.x, v, 0.0))
        return StepPath(tuple(self.segments), math.inf, 0)


def trapezoid_path(distance: int, profile: SpeedProfile) -> StepPath:
    """Build the move of `distance` steps: from start-stop speed to slew speed and back (L970-L971)."""
    sign, length = math.copysign(1.0, distance), float(abs(distance))
    low, slew = profile.ramp_speed, profile.slew
    up, down = profile.acceleration, profile.deceleration
    per_square = 0.5 / up + 0.5 / down
    builder = _PathBuilder()
    peak = min(slew, math.sqrt(low * low + length / per_square))
    builder.add_ramp(sign * low, sign * peak, up)
    if peak == slew:
        builder.add_cruise(sign * slew, sign * max(0.0, length - per_square * (slew * slew - low * low)))
    builder.add_ramp(sign * peak, sign * low, down)
    return builder.build_path(distance)


def constant_path(distance: int, speed: float) -> StepPath:
    """Build a path of `distance` steps at constant `speed`."""
    builder = _PathBuilder()
    builder.add_cruise(math.copysign(speed, distance), float(distance))
    return builder.build_path(distance)


def jog_path(sign: int, profile: SpeedProfile) -> StepPath:
    """Build a path from standstill to slew speed, without end."""
    builder = _PathBuilder()
    builder.add_ramp(sign * profile.ramp_speed, sign * profile.slew, profile.acceleration)
    return builder.build_endless(sign * profile.slew)


def speed_change_path(x: float, velocity: float, sign: int, profile: SpeedProfile) -> StepPath:
    """Build a path from displacement `x` and `velocity` to slew speed in direction `sign`, without end.

    A reversal passes through the start-stop speed.
    """
    builder = _PathBuilder(x)
    if velocity * sign < 0:
        low = math.copysign(min(profile.start, abs(velocity)), velocity)
        builder.add_ramp(velocity, low, profile.deceleration)
        velocity = sign * profile.ramp_speed
    slope = profile.acceleration if abs(velocity) < profile.slew else profile.deceleration
    builder.add_ramp(velocity, sign * profile.slew, slope)
    return builder.build_endless(sign * profile.slew)


def deceleration_path(x: float, velocity: float, profile: SpeedProfile) -> StepPath:
    """Build a path from displacement `x` and `velocity` down to start-stop speed, then stop (L2546)."""
    builder = _PathBuilder(x)
    low = math.copysign(min(abs(velocity), profile.start), velocity)
    builder.add_ramp(velocity, low, profile.deceleration)
    return builder.build_path(round(builder.x))
