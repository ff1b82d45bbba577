"""Arcs and helices (section 4.4): from the parameters of E: to the path of each axis.

The arc starts at (0, 0); X is the axis with the smaller number, to the right, Y the other one, upward (L3393). The
composite speed is constant, in the plane of the arc (decision 18).
"""

import math
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.model.errors import TuttiError
from sim.shrc203.axis import StageAxis
from sim.shrc203.entries import ArcMove, LinearMove
from sim.shrc203.grammar import round_nearest
from sim.shrc203.path import ArcPath, AxisPath, constant_path

_TURN = 2.0 * math.pi


class CollinearPoints(TuttiError):
    """Start, passing point and end point lie on one line (L3581)."""


@dataclass(frozen=True, slots=True)
class _ArcSweep:
    """A circular motion from (0, 0) about a centre by `angle` radians, positive counterclockwise."""

    centre: tuple[float, float]
    angle: float
    end: tuple[int, int]


def _round_away(value: float) -> int:
    return math.floor(abs(value) + 0.5) * (1 if value >= 0 else -1)


def find_circumcentre(px: int, py: int, ex: int, ey: int) -> tuple[float, float]:
    """Return the centre of the circle through (0, 0), the passing point and the end point. Raises `CollinearPoints`."""
    cross = px * ey - py * ex
    if cross == 0:
        raise CollinearPoints
    pp, ee = px * px + py * py, ex * ex + ey * ey
    return (pp * ey - ee * py) / (2 * cross), (ee * px - pp * ex) / (2 * cross)


def _find_sweep(arc: ArcMove) -> _ArcSweep:
    sign = 1.0 if arc.ccw else -1.0
    if arc.form in (2, 5):
        px, py, ex, ey = arc.values
        cx, cy = find_circumcentre(px, py, ex, ey)
        # Passing and end point define the arc, whatever the direction digit is.
        ccw = px * ey - py * ex > 0
        angle = (math.atan2(ey - cy, ex - cx) - math.atan2(-cy, -cx)) % _TURN
        return _ArcSweep((cx, cy), angle if ccw else angle - _TURN, (ex, ey))
    cx, cy = arc.values
    if arc.angle is None:
        return _ArcSweep((float(cx), float(cy)), sign * _TURN * arc.rotations, (0, 0))
    angle = sign * math.radians(float(arc.angle))
    turn = sign * math.radians(float(arc.angle % 360))
    cos, sin = math.cos(turn), math.sin(turn)
    end = (_round_away(cx - cx * cos + cy * sin), _round_away(cy - cx * sin - cy * cos))
    return _ArcSweep((float(cx), float(cy)), angle, end)


def total_rise(arc: ArcMove) -> int:
    """Return the whole travel of a helix's linear axis, pls: z is per rotation from 360° on (L3646, L3733)."""
    if arc.form == 3:
        return arc.rise * arc.rotations
    if arc.angle is not None and arc.angle >= 360:
        return round_nearest(arc.rise * arc.angle / Fraction(360))
    return arc.rise


def arc_paths(arc: ArcMove, speed: int) -> list[tuple[StageAxis, AxisPath]]:
    """Build the paths of an arc or helix at composite `speed`, pls/s."""
    sweep = _find_sweep(arc)
    cx, cy = sweep.centre
    radius = math.hypot(cx, cy)
    duration = radius * abs(sweep.angle) / speed
    linear = total_rise(arc)
    if radius == 0.0 or sweep.angle == 0.0:
        duration = abs(linear) / speed
        paths: list[tuple[StageAxis, AxisPath]] = [(axis, constant_path(0, duration)) for axis in arc.plane]
    else:
        phase, omega = math.atan2(-cy, -cx), sweep.angle / duration
        paths = [
            (
                arc.plane[0],
                ArcPath(centre=cx, radius=radius, phase=phase, omega=omega, duration=duration, end=sweep.end[0]),
            ),
            (
                arc.plane[1],
                ArcPath(
                    centre=cy,
                    radius=radius,
                    phase=phase - math.pi / 2,
                    omega=omega,
                    duration=duration,
                    end=sweep.end[1],
                ),
            ),
        ]
    if arc.linear is not None:
        paths.append((arc.linear, constant_path(linear, duration)))
    return paths


def line_paths(line: LinearMove, speed: int) -> list[tuple[StageAxis, AxisPath]]:
    """Build the paths of a straight line at composite `speed`, pls/s (L4585)."""
    duration = math.sqrt(sum(amount * amount for amount in line.pulses)) / speed
    return [(axis, constant_path(amount, duration)) for axis, amount in zip(line.axes, line.pulses, strict=True)]
