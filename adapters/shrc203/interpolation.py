"""Straight lines by the unit's own interpolation (KP:, L4649): all axes together at one composite speed, without ramps.

It keeps the axes on the line by itself, but starts and stops at full speed. So it is of use where the line is so slow
that every axis may start at its part of the speed, and there it may follow the plan more closely than moves of single
axes, whose durations come out of whole numbers for each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, hypot

from adapters.shrc203.axes import letter
from adapters.shrc203.fleetaxes import bounds, expected_nm, motor
from adapters.shrc203.options import Options
from adapters.shrc203.trapezoid import SPEED_MAX, Leg
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.profile import Profile

_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class Steady:
    """One axis of an interpolated line: `distance` pls (> 0) at a constant speed, not a whole number."""

    distance: int
    duration_s: float

    @property
    def legs(self) -> tuple[Leg, ...]:
        return (Leg(self.duration_s, self.distance / self.duration_s, 0.0),)


@dataclass(frozen=True, slots=True)
class Straight:
    """A line in two or three axes. distances: pls by motor, ascending, with their signs. speed: composite, pls/s."""

    distances: Mapping[int, int]
    speed: int

    @property
    def duration_s(self) -> float:
        """The length of the line by its speed (L4585)."""
        return hypot(*self.distances.values()) / self.speed

    @property
    def command(self) -> str:
        """`KP:A+P1000-P200,S100F100R1`: the speed is the S of the first axis (L4756), and F must not be below it."""
        way = "".join(f"{'-' if each < 0 else '+'}P{abs(each)}" for each in self.distances.values())
        return f"KP:{letter(self.distances)}{way},S{self.speed}F{self.speed}R1"

    @property
    def held(self) -> str:
        """What `?:KP` answers when it is loaded (L1590)."""
        return ",".join([letter(self.distances), *map(str, self.distances.values())])


def straight_line(
    config: Controller, options: Options, profiles: Mapping[str, Profile], names: Sequence[str], factor: float
) -> Straight | None:
    """The line that the unit can make of the profiles of `names`, in the planned duration or the next longer one: what
    is longer is answered, and planned anew. None when they are no straight line, or one that may not be begun at full
    speed. factor: seconds of the unit's crystal in one of the host's."""
    axes = [config.axes[name] for name in names]
    if len(names) < 2 or not (_one_shape([profiles[name] for name in names]) and _one_pulse(axes, options)):
        return None
    distances = dict(sorted((motor(config.axes[n]), profiles[n].end_counts - profiles[n].start_counts) for n in names))
    length = hypot(*distances.values())
    speed = floor(length / (profiles[names[0]].duration_s * factor) * (1 + _ROUNDING))
    by_motor = {motor(axis): axis for axis in axes}
    if not 1 <= speed <= SPEED_MAX or not all(
        _may_begin(by_motor[number], speed * abs(each) / length) for number, each in distances.items()
    ):
        return None
    return Straight(distances, speed)


def _one_shape(profiles: Sequence[Profile]) -> bool:
    """Whether all are one shape, each with its scale: a straight line in the space of the axes."""
    first = profiles[0]
    return all(
        tuple(each.durations_s) == tuple(first.durations_s) and tuple(each.accelerations) == tuple(first.accelerations)
        for each in profiles[1:]
    )


def _one_pulse(axes: Sequence[Axis], options: Options) -> bool:
    """Whether a pulse is known to be as far on every axis, without which the line is wrong (L4587-L4589)."""
    sizes = {expected_nm(axis, options.nm_per_pulse) for axis in axes}
    return len(sizes) == 1 and None not in sizes


def _may_begin(axis: Axis, speed: float) -> bool:
    """Whether the axis may start and stop at this speed (pls/s) without a ramp."""
    limits = bounds(axis)
    least = 0.0 if axis.start_rate is None else axis.start_rate.min * float(axis.scale)
    return least <= speed <= min(limits.start_max, limits.speed)
