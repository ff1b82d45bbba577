"""Axes as joints: their names, and positions in metres and radians (REP 103)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from tutti import AxisInfo, Refusal, StateReading

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Joint:
    """An axis as a joint. size: of the unit of the axis, in m or rad. wrap: the length of a turn, in its unit."""

    name: str
    axis: str
    unit: str
    size: float
    wrap: float | None = None

    def find_nearest(self, position: float, reference: float) -> float:
        """The position in the axis's unit, of one that wraps in the turn that is nearest to `reference`."""
        if self.wrap is None:
            return position
        return position + self.wrap * round((reference - position) / self.wrap)


def make_joints(axes: list[AxisInfo], names: Mapping[str, str]) -> dict[str, Joint]:
    """The joints, by name. names: of joints, the axis of each; without one an axis is named like itself. Axes that have
    neither a length nor an angle are left out. Raises `Refusal`, code `bad-joints`."""
    by_axis = {axis: name for name, axis in names.items()}
    unknown_axes = by_axis.keys() - {info.name for info in axes}
    if unknown_axes or len(by_axis) < len(names):
        text = f"no axis of the fleet: {', '.join(sorted(unknown_axes))}" if unknown_axes else "an axis is named twice"
        raise Refusal("bad-joints", f"names of joints: {text}", "see `tutti axis ls`")
    joints = [
        Joint(by_axis.get(info.name, info.name), info.name, info.unit, info.si_size, info.wrap)
        for info in axes
        if info.si_size is not None
    ]
    if len({joint.name for joint in joints}) < len(joints):
        raise Refusal("bad-joints", "two joints have the same name", "give each a name of its own")
    return {joint.name: joint for joint in joints}


def split_ns(at_ns: int) -> dict[str, int]:
    """The fields of a time or a duration."""
    return {"sec": at_ns // NS_PER_S, "nanosec": at_ns % NS_PER_S}


def join_ns(stamp: Any) -> int:
    """A time or a duration of a message, ns."""
    return stamp.sec * NS_PER_S + stamp.nanosec


def find_utc_ns(reading: StateReading) -> int:
    """The instant of a reading, ns since 1970."""
    instant = datetime.fromisoformat(reading.utc)
    return int(instant.replace(microsecond=0).timestamp()) * NS_PER_S + instant.microsecond * 1000


def find_fleet_ns(reading: StateReading, utc_ns: int) -> int | None:
    """The fleet time at an instant of UTC, by the clock of the computer of a reading; None if that has none."""
    read_ns = find_read_ns(reading)
    return None if read_ns is None else read_ns + utc_ns - find_utc_ns(reading)


def find_read_ns(reading: StateReading) -> int | None:
    """The instant of a reading, fleet time; None if it is not known."""
    return None if reading.read is None else (reading.read.earliest_ns + reading.read.latest_ns) // 2


def is_finite(values: Any) -> bool:
    """Whether all of them are numbers."""
    return all(map(math.isfinite, values))
