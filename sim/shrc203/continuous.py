"""One motion through several points without stopping (program patterns CM and CA, L5792).

Speeds change linearly, beginning at a passing point, with the ramps of the line that begins there (decision 49). The
motion stops only where its direction reverses, and at the end.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim.shrc203.path import PathBuilder, RampPath, SpeedTriple

CONTINUOUS_LINES = 256
"""Maximum number of lines of one continuous motion (L5795)."""


@dataclass(frozen=True, slots=True)
class ContinuousLeg:
    """The distance to one point, pls, and its speeds."""

    distance: int
    triple: SpeedTriple


def continuous_path(legs: Sequence[ContinuousLeg]) -> tuple[RampPath, list[float]]:
    """Build the path through all points, and the time of each, s."""
    builder = PathBuilder()
    times: list[float] = []
    at = 0
    while at < len(legs):
        sign = _leg_sign(legs[at])
        to = at + 1
        while to < len(legs) and _leg_sign(legs[to]) in (0, sign):
            to += 1
        _append_one_direction(builder, legs[at:to], sign, times)
        at = to
    return builder.build_path(sum(leg.distance for leg in legs)), times


def _leg_sign(leg: ContinuousLeg) -> int:
    return (leg.distance > 0) - (leg.distance < 0)


def _append_one_direction(builder: PathBuilder, legs: Sequence[ContinuousLeg], sign: int, times: list[float]) -> None:
    # Highest speed at each point from which the motion can still stop at the last one.
    speeds = [float(legs[-1].triple.start_speed)]
    for leg in reversed(legs):
        speeds.append(math.sqrt(speeds[-1] ** 2 + 2.0 * leg.triple.ramp_slope * abs(leg.distance)))
    speeds.reverse()
    v = float(legs[0].triple.start_speed)
    for leg, limit in zip(legs, speeds[1:], strict=True):
        v = _append_leg(builder, leg, sign, v, limit)
        times.append(builder.t)


def _append_leg(builder: PathBuilder, leg: ContinuousLeg, sign: int, v: float, limit: float) -> float:
    """Build one leg entered at speed `v` and left at no more than `limit`; return the speed at its end."""
    length, slope, cruise = abs(leg.distance), leg.triple.ramp_slope, float(leg.triple.f)
    if not length:
        return v
    if slope == 0.0:
        builder.add_cruise(sign * cruise, sign * length)
        return cruise
    first = min(length, abs(cruise * cruise - v * v) / (2.0 * slope))
    peak = cruise if first < length else math.sqrt(max(0.0, v * v + math.copysign(2.0 * slope * length, cruise - v)))
    out = min(peak, limit)
    if v <= cruise and out < peak and first + (peak * peak - out * out) / (2.0 * slope) > length:
        # The leg is too short to reach the cruising speed and decelerate again.
        peak = math.sqrt((2.0 * slope * length + v * v + out * out) / 2.0)
        first = (peak * peak - v * v) / (2.0 * slope)
    last = (peak * peak - out * out) / (2.0 * slope)
    builder.add_ramp(sign * v, sign * peak, abs(peak - v) / slope)
    builder.add_cruise(sign * peak, sign * max(0.0, length - first - last))
    builder.add_ramp(sign * peak, sign * out, (peak - out) / slope)
    return out
