"""Start of a motion from a buffered operation."""

from sim.shrc203.axis import PathRun, Ready, RunKind, RunOrder, StageAxis
from sim.shrc203.drive import PathGenerator
from sim.shrc203.entries import ArcMove, JogMove, LinearMove, TravelMove
from sim.shrc203.geometry import arc_paths, line_paths
from sim.shrc203.path import SpeedTriple, endless_path, trapezoid_path


def start_travel(drive: PathGenerator, axis: StageAxis, distance: int, order: RunOrder) -> PathRun:
    """Move one axis by `distance` pls, as far as the software limits allow (decision 29)."""
    soft_sign = 0
    if axis.soft_limits is not None and distance:
        low, high = axis.soft_limits
        position_here = axis.position + axis.offset
        allowed_distance = (
            min(distance, max(high - position_here, 0)) if distance > 0 else max(distance, min(low - position_here, 0))
        )
        if allowed_distance != distance:
            soft_sign = 1 if distance > 0 else -1
            distance = allowed_distance
    return drive.start_run([(axis, trapezoid_path(distance, order.triple))], order, soft_sign)


def start_interpolation(
    drive: PathGenerator, entry: LinearMove | ArcMove, triple: SpeedTriple, at_ns: int, ready: Ready
) -> PathRun:
    """Run a line or an arc at the minimum speed S of `triple` (L4585)."""
    speed = triple.s
    paths = line_paths(entry, speed) if isinstance(entry, LinearMove) else arc_paths(entry, speed)
    return drive.start_run(paths, RunOrder(triple, RunKind.INTERPOLATION, at_ns, ready))


def start_entry(
    drive: PathGenerator, entry: TravelMove | JogMove | LinearMove | ArcMove, at_ns: int, ready: Ready
) -> PathRun:
    """Start a buffered operation. Speeds given with it replace the working triple of its first axis (L3867)."""
    first = entry.axes[0]
    if entry.triple is not None:
        first.triple = entry.triple
    if isinstance(entry, TravelMove):
        distance = entry.pulses - (first.position + first.offset) if entry.absolute else entry.pulses
        return start_travel(drive, first, distance, RunOrder(first.triple, RunKind.MOVE, at_ns, ready))
    if isinstance(entry, JogMove):
        path = endless_path(float(entry.sign * first.triple.s))
        return drive.start_run([(first, path)], RunOrder(first.triple, RunKind.JOG, at_ns, ready))
    return start_interpolation(drive, entry, first.triple, at_ns, ready)
