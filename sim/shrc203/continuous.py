"""One motion through several points without stopping (program patterns CM and CA, L5792).

Speeds change linearly, beginning at a passing point, with the ramps of the line that begins there (decision 49).
The motion comes to a stop only where its direction turns, and at the end.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

from sim.shrc203.path import PathBuilder, RampPath, Triple

CONTINUOUS_LINES = 256
"""Most lines of one continuous motion (L5795)."""


@dataclass(frozen=True, slots=True)
class Leg:
    """The way to one point, pls, and the speeds on it."""

    distance: int
    triple: Triple


def continuous(legs: Sequence[Leg]) -> tuple[RampPath, list[float]]:
    """The path through all points, and the time of each, s."""
    builder = PathBuilder()
    times: list[float] = []
    at = 0
    while at < len(legs):
        sign = _sign(legs[at])
        to = at + 1
        while to < len(legs) and _sign(legs[to]) in (0, sign):
            to += 1
        _one_way(builder, legs[at:to], sign, times)
        at = to
    return builder.done(sum(leg.distance for leg in legs)), times


def _sign(leg: Leg) -> int:
    return (leg.distance > 0) - (leg.distance < 0)


def _one_way(builder: PathBuilder, legs: Sequence[Leg], sign: int, times: list[float]) -> None:
    # How fast each point may be passed so that the motion can still stop at the last one.
    allowed = [float(legs[-1].triple.start)]
    for leg in reversed(legs):
        allowed.append(math.sqrt(allowed[-1] ** 2 + 2.0 * leg.triple.slope * abs(leg.distance)))
    allowed.reverse()
    v = float(legs[0].triple.start)
    for leg, limit in zip(legs, allowed[1:], strict=True):
        v = _leg(builder, leg, sign, v, limit)
        times.append(builder.t)


def _leg(builder: PathBuilder, leg: Leg, sign: int, v: float, limit: float) -> float:
    """One leg entered at speed `v` and left at no more than `limit`; returns the speed at its end."""
    length, slope, cruise = abs(leg.distance), leg.triple.slope, float(leg.triple.f)
    if not length:
        return v
    if slope == 0.0:
        builder.cruise(sign * cruise, sign * length)
        return cruise
    first = min(length, abs(cruise * cruise - v * v) / (2.0 * slope))
    peak = cruise if first < length else math.sqrt(max(0.0, v * v + math.copysign(2.0 * slope * length, cruise - v)))
    out = min(peak, limit)
    if v <= cruise and out < peak and first + (peak * peak - out * out) / (2.0 * slope) > length:
        # No room to reach the cruising speed and come down again.
        peak = math.sqrt((2.0 * slope * length + v * v + out * out) / 2.0)
        first = (peak * peak - v * v) / (2.0 * slope)
    last = (peak * peak - out * out) / (2.0 * slope)
    builder.ramp(sign * v, sign * peak, abs(peak - v) / slope)
    builder.cruise(sign * peak, sign * max(0.0, length - first - last))
    builder.ramp(sign * peak, sign * out, (peak - out) / slope)
    return out
