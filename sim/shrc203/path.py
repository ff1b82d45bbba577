"""Paths of one axis in closed form: displacement (pls) and velocity (pls/s) over device time (s) from the start."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from sim.core.ramps import TINY, RampSegment, first_at, first_toward


@dataclass(frozen=True, slots=True)
class SpeedTriple:
    """Minimum speed S and maximum speed F, pls/s, and acceleration time R, ms (section 4.1)."""

    s: int
    f: int
    r: int

    @property
    def start_speed(self) -> int:
        """The speed at which a move starts and ends; JD: can leave F below S."""
        return min(self.s, self.f)

    @property
    def ramp_slope(self) -> float:
        """Acceleration, pls/s²; 0 when S = F."""
        return (self.f - self.start_speed) * 1000.0 / self.r

    def __str__(self) -> str:
        return f"S{self.s}F{self.f}R{self.r}"


class AxisPath(Protocol):
    """Commanded displacement of an axis relative to its start."""

    @property
    def duration(self) -> float:
        """Seconds; infinite for a jog."""
        ...

    @property
    def end(self) -> int:
        """Displacement at the end, whole pulses."""
        ...

    def state_at(self, t: float) -> tuple[float, float]:
        """Return displacement and velocity `t` seconds after the start."""
        ...

    def first_at(self, bound: float, sign: int, after: float) -> float | None:
        """Return the first time >= `after` at or beyond `bound` in direction `sign` while moving in that direction."""
        ...

    def first_toward(self, sign: int, after: float) -> float | None:
        """Return the first time >= `after` with motion in direction `sign`."""
        ...


@dataclass(frozen=True, slots=True)
class RampPath:
    """Segments of constant acceleration; the velocity does not change its sign inside a segment."""

    segments: tuple[RampSegment, ...]
    duration: float
    end: int

    def state_at(self, t: float) -> tuple[float, float]:
        if t >= self.duration:
            return float(self.end), 0.0
        segment = self.segments[0]
        for segment in reversed(self.segments):
            if segment.t <= t:
                break
        instant = max(t, segment.t)
        return segment.x_at(instant), segment.v_at(instant)

    def first_at(self, bound: float, sign: int, after: float) -> float | None:
        return first_at(self.segments, self.duration, bound, sign, after)

    def first_toward(self, sign: int, after: float) -> float | None:
        return first_toward(self.segments, self.duration, sign, after)


class PathBuilder:
    """Appends segments one after the other."""

    def __init__(self, x: float = 0.0) -> None:
        self._segments: list[RampSegment] = []
        self.t = 0.0
        self.x = x

    def add_ramp(self, v: float, to_v: float, duration: float) -> None:
        """Change the velocity linearly from `v` to `to_v` in `duration` seconds."""
        if duration <= 0.0:
            return
        self._segments.append(RampSegment(self.t, self.x, v, (to_v - v) / duration))
        self.t += duration
        self.x += 0.5 * (v + to_v) * duration

    def add_cruise(self, v: float, distance: float) -> None:
        """Travel `distance` (of v's sign) at constant velocity."""
        if distance and v:
            self._segments.append(RampSegment(self.t, self.x, v, 0.0))
            self.t += distance / v
            self.x += distance

    def add_move(self, distance: float, triple: SpeedTriple) -> None:
        """Accelerate, cruise and decelerate over `distance`, from and to speed S (decision 8)."""
        if not distance:
            return
        sign = math.copysign(1.0, distance)
        length, s, f, slope = abs(distance), float(triple.start_speed), float(triple.f), triple.ramp_slope
        ramps = (s + f) * triple.r * 1e-3
        if slope == 0.0:
            self.add_cruise(sign * s, distance)
        elif length >= ramps:
            self.add_ramp(sign * s, sign * f, triple.r * 1e-3)
            self.add_cruise(sign * f, sign * (length - ramps))
            self.add_ramp(sign * f, sign * s, triple.r * 1e-3)
        else:
            peak = math.sqrt(s * s + slope * length)
            self.add_ramp(sign * s, sign * peak, (peak - s) / slope)
            self.add_ramp(sign * peak, sign * s, (peak - s) / slope)

    def build_path(self, end: int | None = None) -> RampPath:
        """Return the path; it ends at `end`, or at the last whole pulse that it passed."""
        return RampPath(
            tuple(self._segments) or (RampSegment(0.0, self.x, 0.0, 0.0),),
            self.t,
            math.trunc(self.x + math.copysign(TINY, self.x)) if end is None else end,
        )


def trapezoid_path(distance: int, triple: SpeedTriple) -> RampPath:
    """Build the move of `distance` pulses with this speed triple."""
    builder = PathBuilder()
    builder.add_move(distance, triple)
    return builder.build_path(distance)


def constant_path(distance: int, duration: float) -> RampPath:
    """Build a path of `distance` pulses at constant velocity in `duration` seconds."""
    if not distance:
        return RampPath((RampSegment(0.0, 0.0, 0.0, 0.0),), duration, 0)
    return RampPath((RampSegment(0.0, 0.0, distance / duration, 0.0),), duration, distance)


def endless_path(velocity: float, x: float = 0.0) -> RampPath:
    """Build a path of constant velocity without an end (jog)."""
    return RampPath((RampSegment(0.0, x, velocity, 0.0),), math.inf, 0)


def deceleration_path(x: float, velocity: float, triple: SpeedTriple) -> RampPath:
    """Build a path from displacement `x` and `velocity` down to speed S with the slope of the ramps, then stop
    (decision 26)."""
    builder = PathBuilder(x)
    low = math.copysign(min(abs(velocity), float(triple.start_speed)), velocity)
    if triple.ramp_slope:
        builder.add_ramp(velocity, low, (abs(velocity) - abs(low)) / triple.ramp_slope)
    return builder.build_path()


def joined_path(distances: Sequence[int], triples: Sequence[SpeedTriple]) -> RampPath:
    """Build complete moves one after the other, each from and to its speed S."""
    builder = PathBuilder()
    for distance, triple in zip(distances, triples, strict=True):
        builder.add_move(distance, triple)
    return builder.build_path(sum(distances))


@dataclass(frozen=True, slots=True)
class ArcPath:
    """One coordinate of a circular motion at constant angular speed.

    The displacement is centre + radius·cos(phase + omega·t); the other coordinate has its phase turned by 90°.
    """

    centre: float
    radius: float
    phase: float
    omega: float
    duration: float
    end: int

    def state_at(self, t: float) -> tuple[float, float]:
        if t >= self.duration:
            return float(self.end), 0.0
        angle = self.phase + self.omega * max(0.0, t)
        return self.centre + self.radius * math.cos(angle), -self.radius * self.omega * math.sin(angle)

    def first_at(self, bound: float, sign: int, after: float) -> float | None:
        if not self.omega or after >= self.duration:
            return None
        x, _ = self.state_at(after)
        if sign * (x - bound) >= 0:
            return self.first_toward(sign, after)
        ratio = (bound - self.centre) / self.radius
        if abs(ratio) > 1.0:
            return None
        # Motion in direction `sign` needs sign·omega·sin(angle) < 0, which picks one of the two angles.
        angle = math.acos(ratio)
        if sign * self.omega > 0:
            angle = -angle
        t = self._next_time(angle, after)
        return t if t < self.duration else None

    def first_toward(self, sign: int, after: float) -> float | None:
        if not self.omega or after >= self.duration:
            return None
        if sign * self.state_at(after)[1] > 0:
            return after
        t = self._next_time(math.pi if sign > 0 else 0.0, after)
        return t if t < self.duration else None

    def _next_time(self, angle: float, after: float) -> float:
        """Return the first time >= `after` at which the phase is `angle`, apart from whole turns."""
        period = 2.0 * math.pi / abs(self.omega)
        t = (angle - self.phase) / self.omega
        return t + math.ceil((after - t) / period) * period
