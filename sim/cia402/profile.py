"""Output of the profile generator: segments of constant acceleration, over seconds of the drive's crystal."""

import math
from dataclasses import dataclass

from sim.core.ramps import TINY, RampSegment


@dataclass(frozen=True, slots=True)
class MotionPlan:
    """Displacement from the start. Ends at standstill at `distance` after `duration_s`; an endless one has the
    duration inf, and continues as its last segment.

    reached_s: end of the last commanded change of speed."""

    segments: tuple[RampSegment, ...]
    duration_s: float
    distance: float
    reached_s: float

    def state_at(self, time_s: float) -> tuple[float, float]:
        """Return displacement and speed."""
        if time_s >= self.duration_s:
            return self.distance, 0.0
        piece = self.segments[0]
        for segment in self.segments[1:]:
            if segment.t > time_s:
                break
            piece = segment
        return piece.x_at(time_s), piece.v_at(time_s)


class _PlanBuilder:
    def __init__(self, speed: float) -> None:
        self.pieces: list[RampSegment] = []
        self.t, self.x, self.v = 0.0, 0.0, speed

    def add_ramp(self, speed: float, rate: float) -> None:
        """Change to `speed` at `rate`, units/s²."""
        if speed != self.v:
            self.add_segment(abs(speed - self.v) / rate, math.copysign(rate, speed - self.v))
            self.v = speed

    def add_segment(self, duration_s: float, acceleration: float = 0.0) -> None:
        if duration_s > 0:
            self.pieces.append(RampSegment(self.t, self.x, self.v, acceleration))
            self.x += (self.v + 0.5 * acceleration * duration_s) * duration_s
            self.v += acceleration * duration_s
            self.t += duration_s

    def finish_at_rest(self, distance: float) -> MotionPlan:
        pieces = tuple(self.pieces) or (RampSegment(0.0, 0.0, 0.0, 0.0),)
        return MotionPlan(pieces, self.t, distance, self.t)

    def finish_endless(self) -> MotionPlan:
        way = math.copysign(math.inf, self.v)
        return MotionPlan((*self.pieces, RampSegment(self.t, self.x, self.v, 0.0)), math.inf, way, self.t)


def to_rest(speed: float, rate: float) -> MotionPlan:
    """Build a plan from `speed` to standstill at `rate`."""
    plan = _PlanBuilder(speed)
    plan.add_ramp(0.0, rate)
    return plan.finish_at_rest(plan.x)


def to_speed(speed: float, target: float, up: float, down: float) -> MotionPlan:
    """Build a plan from `speed` to `target`, and on at it; through standstill when the direction changes."""
    plan = _PlanBuilder(speed)
    if target == 0.0 or speed * target < 0:
        plan.add_ramp(0.0, down)
    if target == 0.0:
        return plan.finish_at_rest(plan.x)
    plan.add_ramp(target, up if abs(target) > abs(plan.v) else down)
    return plan.finish_endless()


def to_target(speed: float, distance: float, max_speed: float, up: float, down: float) -> MotionPlan:
    """Build a plan from `speed` to standstill at `distance`, never faster than `most`; with a reversal when it
    cannot stop in time."""
    plan = _PlanBuilder(speed)
    stopping = speed * abs(speed) / (2 * down)
    distance_left = distance - stopping
    if speed and distance_left * speed < 0 and abs(distance_left) > TINY:
        plan.add_ramp(0.0, down)
    if speed and abs(plan.v) > max_speed:
        plan.add_ramp(math.copysign(max_speed, plan.v), down)
    distance_left = distance - plan.x
    if abs(distance_left) <= TINY and plan.v == 0.0:
        return plan.finish_at_rest(distance)
    sign = math.copysign(1.0, distance_left)
    peak = math.sqrt(max(0.0, (2 * abs(distance_left) * up * down + down * plan.v * plan.v) / (up + down)))
    peak = min(max_speed, max(peak, abs(plan.v)))
    plan.add_ramp(sign * peak, up)
    braking = peak * peak / (2 * down)
    remainder = sign * (distance - plan.x) - braking
    plan.add_segment(remainder / peak)
    plan.add_ramp(0.0, down)
    return plan.finish_at_rest(distance)


def to_linear(distance: float, duration_s: float) -> MotionPlan:
    """Build a plan of one speed over `distance`: a segment of an interpolated path."""
    return MotionPlan((RampSegment(0.0, 0.0, distance / duration_s, 0.0),), duration_s, distance, duration_s)
