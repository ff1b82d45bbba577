"""Mechanical and logical origin return (section 10).

The search patterns of the five methods are described in another volume. Here all of them run past the origin with the
B: speeds, return across it, and creep onto it with the minimum speed S.
"""

import math

from sim.shrc203.axis import EndCause, PathRun, Ready, RunKind, RunOrder, StageAxis
from sim.shrc203.drive import PathGenerator
from sim.shrc203.launch import start_travel
from sim.shrc203.path import SpeedTriple, joined_path

METHODS = ("MARK", "MINI", "MIDDLE", "ORGS", "NORMAL")
"""Methods 0 to 4 of H and HRT (L2690)."""

_CREEP_S = 0.1


def find_origin(drive: PathGenerator, axis: StageAxis, at_ns: int, ready: Ready) -> PathRun:
    """Start the mechanical origin return of one axis; at its end the coordinate there is 0 (L2684)."""
    triple = axis.origin_triple
    creep = SpeedTriple(triple.s, triple.s, triple.r)
    distance = axis.origin - axis.position
    sign = 1 if distance > 0 else -1
    past = math.ceil((triple.s + triple.f) * triple.r / 2000)
    retreat = max(1, math.ceil(triple.s * _CREEP_S))
    if axis.travel is not None:
        # The stage must reverse before it reaches a limit switch.
        room = axis.travel[1] - axis.origin if sign > 0 else axis.origin - axis.travel[0]
        room_behind = axis.origin - axis.travel[0] if sign > 0 else axis.travel[1] - axis.origin
        past, retreat = min(past, max(0, room - 1)), min(retreat, max(0, room_behind - 1))
    path = joined_path([distance + sign * past, -sign * (past + retreat), sign * retreat], [triple, triple, creep])

    def set_origin(run: PathRun, ready_ns: int, cause: EndCause) -> None:
        if cause is EndCause.END:
            axis.offset, axis.zeroed = -axis.position, 0
            axis.errors.discard("S6")
        ready(run, ready_ns, cause)

    return drive.start_run([(axis, path)], RunOrder(triple, RunKind.ORIGIN, at_ns, set_origin))


def go_to_zero(drive: PathGenerator, axis: StageAxis, triple: SpeedTriple, at_ns: int, ready: Ready) -> PathRun:
    """Start the logical origin return: move to coordinate 0 (L2802)."""
    return start_travel(drive, axis, -(axis.position + axis.offset), RunOrder(triple, RunKind.ZERO, at_ns, ready))


def set_zero(axis: StageAxis) -> None:
    """R: set the present coordinate to 0 (L2883)."""
    position_here = axis.position + axis.offset
    axis.zeroed += position_here
    axis.offset -= position_here
    axis.errors.discard("S6")


def undo_zero(axis: StageAxis) -> None:
    """RC: restore the coordinate as if R: had not been given (L2922)."""
    axis.offset += axis.zeroed
    axis.zeroed = 0


def preset_coordinate(axis: StageAxis, coordinate: int) -> None:
    """PSET: (L2229). The amount subtracted by R: belongs to another coordinate system from now on."""
    axis.offset = coordinate - axis.position
    axis.zeroed = 0
    axis.errors.discard("S6")
