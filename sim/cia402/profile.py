"""What the profile generator makes: pieces of constant acceleration, over seconds of the drive's crystal."""

import math
from dataclasses import dataclass

from sim.core.ramps import TINY, Segment


@dataclass(frozen=True, slots=True)
class Plan:
    """Displacement from where it begins. Ends at rest at `distance` after `duration_s`; one that has no end has the
    duration inf, and goes on as its last piece. reached_s: when the last commanded change of speed is over."""

    segments: tuple[Segment, ...]
    duration_s: float
    distance: float
    reached_s: float

    def at(self, time_s: float) -> tuple[float, float]:
        """Displacement and speed."""
        if time_s >= self.duration_s:
            return self.distance, 0.0
        piece = self.segments[0]
        for each in self.segments[1:]:
            if each.t > time_s:
                break
            piece = each
        return piece.x_at(time_s), piece.v + piece.a * (time_s - piece.t)


class _Builder:
    def __init__(self, speed: float) -> None:
        self.pieces: list[Segment] = []
        self.t, self.x, self.v = 0.0, 0.0, speed

    def ramp(self, speed: float, rate: float) -> None:
        """Go over to `speed` at `rate`, units/s²."""
        if speed != self.v:
            self.run(abs(speed - self.v) / rate, math.copysign(rate, speed - self.v))
            self.v = speed

    def run(self, duration_s: float, acceleration: float = 0.0) -> None:
        if duration_s > 0:
            self.pieces.append(Segment(self.t, self.x, self.v, acceleration))
            self.x += (self.v + 0.5 * acceleration * duration_s) * duration_s
            self.v += acceleration * duration_s
            self.t += duration_s

    def rest(self, distance: float) -> Plan:
        pieces = tuple(self.pieces) or (Segment(0.0, 0.0, 0.0, 0.0),)
        return Plan(pieces, self.t, distance, self.t)

    def run_on(self) -> Plan:
        way = math.copysign(math.inf, self.v)
        return Plan((*self.pieces, Segment(self.t, self.x, self.v, 0.0)), math.inf, way, self.t)


def to_rest(speed: float, rate: float) -> Plan:
    """From `speed` to standstill at `rate`."""
    plan = _Builder(speed)
    plan.ramp(0.0, rate)
    return plan.rest(plan.x)


def to_speed(speed: float, target: float, up: float, down: float) -> Plan:
    """From `speed` to `target`, and on at it; through standstill when the direction changes."""
    plan = _Builder(speed)
    if target == 0.0 or speed * target < 0:
        plan.ramp(0.0, down)
    if target == 0.0:
        return plan.rest(plan.x)
    plan.ramp(target, up if abs(target) > abs(plan.v) else down)
    return plan.run_on()


def to_target(speed: float, distance: float, most: float, up: float, down: float) -> Plan:
    """From `speed` to rest at `distance`, never faster than `most`; back again when it can not stop in time."""
    plan = _Builder(speed)
    stopping = speed * abs(speed) / (2 * down)
    left = distance - stopping
    if speed and left * speed < 0 and abs(left) > TINY:
        plan.ramp(0.0, down)
    if speed and abs(plan.v) > most:
        plan.ramp(math.copysign(most, plan.v), down)
    left = distance - plan.x
    if abs(left) <= TINY and plan.v == 0.0:
        return plan.rest(distance)
    sign = math.copysign(1.0, left)
    peak = math.sqrt(max(0.0, (2 * abs(left) * up * down + down * plan.v * plan.v) / (up + down)))
    peak = min(most, max(peak, abs(plan.v)))
    plan.ramp(sign * peak, up)
    braking = peak * peak / (2 * down)
    rest = sign * (distance - plan.x) - braking
    plan.run(rest / peak)
    plan.ramp(0.0, down)
    return plan.rest(distance)


def straight(distance: float, duration_s: float) -> Plan:
    """At one speed over `distance`: a piece of an interpolated path."""
    return Plan((Segment(0.0, 0.0, distance / duration_s, 0.0),), duration_s, distance, duration_s)
