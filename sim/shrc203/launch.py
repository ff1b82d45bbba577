"""From what a buffer holds to a running motion."""

from collections.abc import Callable

from sim.shrc203.axis import Axis
from sim.shrc203.drive import Cause, Drive, Kind, Run
from sim.shrc203.entries import Arc, Jog, Line, Travel
from sim.shrc203.geometry import arc_paths, line_paths
from sim.shrc203.path import Triple, endless, trapezoid

Ready = Callable[[Run, int, Cause], None]


def travel(drive: Drive, axis: Axis, distance: int, triple: Triple, kind: Kind, at_ns: int, ready: Ready) -> Run:
    """Move one axis by `distance` pls, as far as the software limits let it (decision 29)."""
    soft_sign = 0
    if axis.soft_limits is not None and distance:
        low, high = axis.soft_limits
        here = axis.position + axis.offset
        allowed = min(distance, max(high - here, 0)) if distance > 0 else max(distance, min(low - here, 0))
        if allowed != distance:
            soft_sign = 1 if distance > 0 else -1
            distance = allowed
    return drive.start([(axis, trapezoid(distance, triple))], triple, kind, at_ns, ready, soft_sign)


def interpolate(drive: Drive, entry: Line | Arc, triple: Triple, at_ns: int, ready: Ready) -> Run:
    """Run a line or an arc at the minimum speed S of `triple` (L4585)."""
    speed = triple.s
    paths = line_paths(entry, speed) if isinstance(entry, Line) else arc_paths(entry, speed)
    return drive.start(paths, triple, Kind.INTERPOLATION, at_ns, ready)


def launch(drive: Drive, entry: Travel | Jog | Line | Arc, at_ns: int, ready: Ready) -> Run:
    """Start what a buffer holds. Speeds given with it replace the working triple of its first axis (L3867)."""
    first = entry.axes[0]
    if entry.triple is not None:
        first.triple = entry.triple
    if isinstance(entry, Travel):
        distance = entry.pulses - (first.position + first.offset) if entry.absolute else entry.pulses
        return travel(drive, first, distance, first.triple, Kind.MOVE, at_ns, ready)
    if isinstance(entry, Jog):
        path = endless(float(entry.sign * first.triple.s))
        return drive.start([(first, path)], first.triple, Kind.JOG, at_ns, ready)
    return interpolate(drive, entry, first.triple, at_ns, ready)
