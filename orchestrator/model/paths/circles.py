"""Arcs as files write them: ends and a centre, each rounded, and the one circle that they mean.

Readers of files and the planner of paths ask this module, so that what one takes the other does not refuse.
"""

from math import atan2, hypot, pi
from typing import NamedTuple

# How much further one end may be from the centre than the other: a part of the radius, and what rounding to two digits
# of a mm makes (LinuxCNC: 0.001 and 0.0127 mm).
RADIUS_ERROR = 1e-3
ROUNDING_MM = 0.005
SHORTEST = 1e-12  # of the largest coordinate: two points that are nearer are one
SHORT = 0.1  # of the radius: a chord below may be a full circle whose end is off by rounding
MOST_SHIFT = 0.2  # of the radius: by which a centre may be moved along the chord, 0.2 rad of a short arc's direction
RADIAL = 1e-6  # of the radius: an end so little ahead of the start is not ahead of it

Pair = tuple[float, float]


class Precision(NamedTuple):
    """How exact ends and centres are. rounding: `ROUNDING_MM` in their unit, 0 where they have no length; unit: its
    name, for messages."""

    rounding: float = 0.0
    unit: str = ""


EXACT = Precision()
IN_MM = Precision(ROUNDING_MM, "mm")


class Arc(NamedTuple):
    """An arc from its start to its end. centre: as far from both; angle: what it turns, rad, above 0 to 2 pi.

    is_full: a full circle, which ends where it begins, also if the end that is written is off by rounding.
    """

    centre: Pair
    angle: float
    is_full: bool


def fit_arc(begin: Pair, finish: Pair, centre: Pair, *, ccw: bool, precision: Precision) -> Arc:
    """The arc that ends and a centre mean.

    Raises `ValueError` with what is wrong, if they do not belong to one circle, or if a full circle and a very short
    arc are both possible.
    """
    radii = hypot(begin[0] - centre[0], begin[1] - centre[1]), hypot(finish[0] - centre[0], finish[1] - centre[1])
    radius = max(radii)
    if not min(radii) > 0.0:
        raise ValueError("an end of the arc is its centre")
    rounding, unit = precision.rounding, f" {precision.unit}".rstrip()
    tolerance = rounding + RADIUS_ERROR * radius
    if abs(radii[0] - radii[1]) > tolerance:
        text = f"the end of the arc is {radii[1]:.9g}{unit} from its centre, and its start {radii[0]:.9g}{unit}"
        raise ValueError(text)
    x, y = finish[0] - begin[0], finish[1] - begin[1]
    chord = hypot(x, y)
    scale = max(1e-3, *(abs(value) for value in (*begin, *finish)))
    if chord <= SHORTEST * scale:
        return Arc(centre, 2 * pi, is_full=True)
    middle = (begin[0] + finish[0]) / 2, (begin[1] + finish[1]) / 2
    shift = ((centre[0] - middle[0]) * x + (centre[1] - middle[1]) * y) / chord
    if chord < SHORT * radius:
        lead = _find_angle(begin, finish, centre, ccw=ccw)
        lead -= 2 * pi if lead > pi else 0.0
        is_off = abs(shift) > MOST_SHIFT * radius
        if (is_off or chord <= rounding) and lead > RADIAL:
            text = f"the end of the arc is {chord:.3g}{unit} from its start"
            raise ValueError(f"{text}; for a full circle write the start, else a line")
        if is_off:
            return Arc(centre, 2 * pi, is_full=True)
    # Onto the bisector of the chord: the arc ends exactly at its end.
    centre = centre[0] - shift * x / chord, centre[1] - shift * y / chord
    return Arc(centre, _find_angle(begin, finish, centre, ccw=ccw), is_full=False)


def _find_angle(begin: Pair, finish: Pair, centre: Pair, *, ccw: bool) -> float:
    """The angle from the start to the end about the centre, in the arc's sense, from 0 to 2 pi."""
    x, y = begin[0] - centre[0], begin[1] - centre[1]
    x_end, y_end = finish[0] - centre[0], finish[1] - centre[1]
    angle = atan2(x * y_end - y * x_end, x * x_end + y * y_end)
    return (angle if ccw else -angle) % (2 * pi)
