"""Masters of gears: the position that a slave follows (L5426)."""

from collections.abc import Callable

from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.control import MotionControl


def select_master(motion: MotionControl, axis: ServoAxis, source: str) -> None:
    """`GA` for one axis (L5426)."""
    axis.gear.select_master(source, _master_position(motion, source), motion.timebase.next_sample())


def _master_position(motion: MotionControl, source: str) -> Callable[[float], float]:
    if source in ("S", "T"):
        system = motion.systems[source]
        return system.travelled_distance
    if source == "N":
        virtual = motion.find_axis("N")
        return lambda at: virtual.follower_travel(at, commanded=True)
    axis = motion.find_axis(source[-1])
    if source.startswith("D") and len(source) == 2:
        return lambda at: float(axis.auxiliary)
    is_commanded = len(source) == 2
    return lambda at: axis.follower_travel(at, commanded=is_commanded)
