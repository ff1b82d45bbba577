"""Straight paths by the controller's own interpolation (KP:, L4649): all axes together at one composite speed, without
ramps.

The interpolation keeps the axes on the path, but starts and stops at full speed. It is useful where the path is so slow
that every axis may start at its share of the speed. There it may follow the plan more closely than moves of single
axes, whose durations result from whole numbers for each.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor, hypot

from adapters.shrc203.fleetaxes import axis_bounds, expected_nm, motor_number
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.shapes.trapezoid import SPEED_MAX, ShrcLeg
from adapters.shrc203.wire.replies import axis_argument
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.profile import Profile

_ROUNDING = 1e-9


@dataclass(frozen=True, slots=True)
class SteadyAxis:
    """One axis of an interpolated path: `distance` pls (> 0) at a constant speed, not a whole number."""

    distance: int
    duration_s: float

    @property
    def motion_legs(self) -> tuple[ShrcLeg, ...]:
        return (ShrcLeg(self.duration_s, self.distance / self.duration_s, 0.0),)


@dataclass(frozen=True, slots=True)
class StraightPath:
    """A straight path in two or three axes. distances: pls by motor, ascending, signed. speed: composite, pls/s."""

    distances: Mapping[int, int]
    speed: int

    @property
    def duration_s(self) -> float:
        """Return the length of the path divided by its speed (L4585)."""
        return hypot(*self.distances.values()) / self.speed

    @property
    def load_command(self) -> str:
        """Return `KP:A+P1000-P200,S100F100R1`: the speed is the S of the first axis (L4756), and F must not be below
        it."""
        way = "".join(f"{'-' if distance < 0 else '+'}P{abs(distance)}" for distance in self.distances.values())
        return f"KP:{axis_argument(self.distances)}{way},S{self.speed}F{self.speed}R1"

    @property
    def loaded_reply(self) -> str:
        """Return the answer to `?:KP` when it is loaded (L1590)."""
        return ",".join([axis_argument(self.distances), *map(str, self.distances.values())])


def fit_straight_path(
    config: Controller, options: ShrcOptions, profiles: Mapping[str, Profile], names: Sequence[str], factor: float
) -> StraightPath | None:
    """Return the straight path that the controller can execute for the profiles of `names`, in the planned duration or
    the next longer one; a longer duration is reported, and planned again.

    None when the profiles are not a straight path, or not one that may begin at full speed. factor: seconds of the
    controller's crystal per host second."""
    axes = [config.axes[name] for name in names]
    if len(names) < 2 or not (_one_shape([profiles[name] for name in names]) and _one_pulse(axes, options)):
        return None
    distances = dict(
        sorted((motor_number(config.axes[n]), profiles[n].end_counts - profiles[n].start_counts) for n in names)
    )
    length = hypot(*distances.values())
    speed = floor(length / (profiles[names[0]].duration_s * factor) * (1 + _ROUNDING))
    by_motor = {motor_number(axis): axis for axis in axes}
    if not 1 <= speed <= SPEED_MAX or not all(
        _may_begin(by_motor[number], speed * abs(distance) / length) for number, distance in distances.items()
    ):
        return None
    return StraightPath(distances, speed)


def _one_shape(profiles: Sequence[Profile]) -> bool:
    """Return whether all profiles have one shape, each with its scale: a straight path in the space of the axes."""
    first = profiles[0]
    return all(
        tuple(profile.durations_s) == tuple(first.durations_s)
        and tuple(profile.accelerations) == tuple(first.accelerations)
        for profile in profiles[1:]
    )


def _one_pulse(axes: Sequence[Axis], options: ShrcOptions) -> bool:
    """Return whether a pulse is known to have the same length on every axis; otherwise the path is wrong
    (L4587-L4589)."""
    sizes = {expected_nm(axis, options.nm_per_pulse) for axis in axes}
    return len(sizes) == 1 and None not in sizes


def _may_begin(axis: Axis, speed: float) -> bool:
    """Return whether the axis may start and stop at this speed (pls/s) without a ramp."""
    limits = axis_bounds(axis)
    least = 0.0 if axis.start_rate is None else axis.start_rate.min * float(axis.scale)
    return least <= speed <= min(limits.start_max, limits.speed)
