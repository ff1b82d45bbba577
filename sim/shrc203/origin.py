"""Mechanical and logical origin return (section 10).

How the five methods search is described in another volume. Here all of them run past the origin with the
B: speeds, come back across it, and creep onto it with the minimum speed S.
"""

import math

from sim.shrc203.axis import Axis
from sim.shrc203.drive import Cause, Drive, Kind, Run
from sim.shrc203.launch import Ready, travel
from sim.shrc203.path import Triple, joined

METHODS = ("MARK", "MINI", "MIDDLE", "ORGS", "NORMAL")
"""Methods 0 to 4 of H and HRT (L2690)."""

_CREEP_S = 0.1


def find_origin(drive: Drive, axis: Axis, at_ns: int, ready: Ready) -> Run:
    """Mechanical origin return of one axis; at its end the coordinate there is 0 (L2684)."""
    triple = axis.origin_triple
    creep = Triple(triple.s, triple.s, triple.r)
    away = axis.origin - axis.position
    sign = 1 if away > 0 else -1
    past = math.ceil((triple.s + triple.f) * triple.r / 2000)
    back = max(1, math.ceil(triple.s * _CREEP_S))
    if axis.travel is not None:
        # The stage must turn before a limit switch does it.
        room = axis.travel[1] - axis.origin if sign > 0 else axis.origin - axis.travel[0]
        behind = axis.origin - axis.travel[0] if sign > 0 else axis.travel[1] - axis.origin
        past, back = min(past, max(0, room - 1)), min(back, max(0, behind - 1))
    path = joined([away + sign * past, -sign * (past + back), sign * back], [triple, triple, creep])

    def found(run: Run, ready_ns: int, cause: Cause) -> None:
        if cause is Cause.END:
            axis.offset, axis.zeroed = -axis.position, 0
            axis.errors.discard("S6")
        ready(run, ready_ns, cause)

    return drive.start([(axis, path)], triple, Kind.ORIGIN, at_ns, found)


def go_to_zero(drive: Drive, axis: Axis, triple: Triple, at_ns: int, ready: Ready) -> Run:
    """Logical origin return: move to coordinate 0 (L2802)."""
    return travel(drive, axis, -(axis.position + axis.offset), triple, Kind.ZERO, at_ns, ready)


def set_zero(axis: Axis) -> None:
    """R: the coordinate here becomes 0 (L2883)."""
    here = axis.position + axis.offset
    axis.zeroed += here
    axis.offset -= here
    axis.errors.discard("S6")


def undo_zero(axis: Axis) -> None:
    """RC: the coordinate is again what it would be without R: (L2922)."""
    axis.offset += axis.zeroed
    axis.zeroed = 0


def preset(axis: Axis, coordinate: int) -> None:
    """PSET: (L2229). What R: took off is part of another coordinate system from now on."""
    axis.offset = coordinate - axis.position
    axis.zeroed = 0
    axis.errors.discard("S6")
