"""Arcs and helices (section 4.4): from what E: says to the path of each axis.

The arc starts at (0, 0); X is the axis with the smaller number, to the right, Y the other one, upward (L3393).
The composite speed is constant, in the plane of the arc (decision 18).
"""

import math
from dataclasses import dataclass
from fractions import Fraction

from sim.shrc203.axis import Axis
from sim.shrc203.entries import Arc, Line
from sim.shrc203.grammar import nearest
from sim.shrc203.path import ArcPath, Path, constant

_TURN = 2.0 * math.pi


class Collinear(Exception):
    """Start, passing point and end point lie on one line (L3581)."""


@dataclass(frozen=True, slots=True)
class _Sweep:
    """A circular motion from (0, 0) about a centre by `angle` radians, positive counterclockwise."""

    centre: tuple[float, float]
    angle: float
    end: tuple[int, int]


def _away(value: float) -> int:
    return math.floor(abs(value) + 0.5) * (1 if value >= 0 else -1)


def circumcentre(px: int, py: int, ex: int, ey: int) -> tuple[float, float]:
    """Centre of the circle through (0, 0), the passing point and the end point. Raises `Collinear`."""
    cross = px * ey - py * ex
    if cross == 0:
        raise Collinear
    pp, ee = px * px + py * py, ex * ex + ey * ey
    return (pp * ey - ee * py) / (2 * cross), (ee * px - pp * ex) / (2 * cross)


def _sweep(arc: Arc) -> _Sweep:
    sign = 1.0 if arc.ccw else -1.0
    if arc.form in (2, 5):
        px, py, ex, ey = arc.values
        cx, cy = circumcentre(px, py, ex, ey)
        # Passing and end point fix the arc, whatever the direction digit says.
        ccw = px * ey - py * ex > 0
        angle = (math.atan2(ey - cy, ex - cx) - math.atan2(-cy, -cx)) % _TURN
        return _Sweep((cx, cy), angle if ccw else angle - _TURN, (ex, ey))
    cx, cy = arc.values
    if arc.angle is None:
        return _Sweep((float(cx), float(cy)), sign * _TURN * arc.rotations, (0, 0))
    angle = sign * math.radians(float(arc.angle))
    turned = sign * math.radians(float(arc.angle % 360))
    cos, sin = math.cos(turned), math.sin(turned)
    end = (_away(cx - cx * cos + cy * sin), _away(cy - cx * sin - cy * cos))
    return _Sweep((float(cx), float(cy)), angle, end)


def rise(arc: Arc) -> int:
    """Whole travel of a helix's linear axis, pls: z is per rotation from 360° on (L3646, L3733)."""
    if arc.form == 3:
        return arc.rise * arc.rotations
    if arc.angle is not None and arc.angle >= 360:
        return nearest(arc.rise * arc.angle / Fraction(360))
    return arc.rise


def arc_paths(arc: Arc, speed: int) -> list[tuple[Axis, Path]]:
    """The paths of an arc or helix at composite `speed`, pls/s."""
    sweep = _sweep(arc)
    cx, cy = sweep.centre
    radius = math.hypot(cx, cy)
    duration = radius * abs(sweep.angle) / speed
    linear = rise(arc)
    if radius == 0.0 or sweep.angle == 0.0:
        duration = abs(linear) / speed
        paths: list[tuple[Axis, Path]] = [(axis, constant(0, duration)) for axis in arc.plane]
    else:
        phase, omega = math.atan2(-cy, -cx), sweep.angle / duration
        paths = [
            (arc.plane[0], ArcPath(cx, radius, phase, omega, duration, sweep.end[0])),
            (arc.plane[1], ArcPath(cy, radius, phase - math.pi / 2, omega, duration, sweep.end[1])),
        ]
    if arc.linear is not None:
        paths.append((arc.linear, constant(linear, duration)))
    return paths


def line_paths(line: Line, speed: int) -> list[tuple[Axis, Path]]:
    """The paths of a straight line at composite `speed`, pls/s (L4585)."""
    duration = math.sqrt(sum(amount * amount for amount in line.pulses)) / speed
    return [(axis, constant(amount, duration)) for axis, amount in zip(line.axes, line.pulses, strict=True)]
