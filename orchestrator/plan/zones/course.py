"""Where the axes of a step can be while it moves: as planned, or after any one of them has stopped by itself."""

from bisect import bisect_right
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.operation.pair_reach import DETECTION_S
from orchestrator.model.profile import MotionState, Profile, find_turning_points
from orchestrator.plan.zones.chain import Box

PARTS = 256
"""Into which a step is divided at most, in time."""
SHARE = 8
"""Of the time for which axes may go on alone: a finer division changes boxes by little."""


@dataclass(frozen=True)
class MovingAxis:
    """One axis of a step. wait_s: for how long it may go on by its plan after another axis has stopped, before its own
    ramp; None: to its end. margin: how far it may be from its planned position, in its unit."""

    axis: Axis
    profile: Profile
    wait_s: float | None
    margin: float

    @cached_property
    def rest_s(self) -> float | None:
        """`wait_s` with the time of a ramp from its highest speed, which is one of its plan."""
        return None if self.wait_s is None else self.wait_s + _find_ramp_time(self.profile)

    @cached_property
    def _starts(self) -> list[float]:
        return [segment.start_s for segment in self.profile.segments]

    @cached_property
    def _at(self) -> Callable[[float], MotionState]:
        return self.profile.make_evaluator()

    def find_extent(self, begin_s: float, end_s: float) -> tuple[float, float]:
        """Between which positions it is from one instant of its profile to another, in its unit, margins included."""
        profile = self.profile
        ends = [self._at(begin_s).position, self._at(end_s).position]
        first = max(bisect_right(self._starts, begin_s) - 1, 0)
        for segment in profile.segments[first:]:
            if segment.start_s >= end_s:
                break
            for turn_s in find_turning_points(segment.velocity, segment.acceleration, segment.jerk):
                if 0.0 < turn_s < segment.duration_s and begin_s < segment.start_s + turn_s < end_s:
                    ends.append(segment.state_at(turn_s).position)
        low, high = sorted(self.axis.to_unit(profile.start_counts + end) for end in (min(ends), max(ends)))
        return low - self.margin, high + self.margin


@dataclass(frozen=True)
class Course:
    """A step in time. moving: the axes that it moves, by name. standing: where the others that rules depend on are,
    with their uncertainty, and those that it moves from where is not known (`adrift`). unknown: of which nothing but
    their range is known, those included. skew_s: how far axes that keep step are apart."""

    moving: Mapping[str, MovingAxis]
    standing: Box
    duration_s: float
    skew_s: float
    unknown: Collection[str] = ()
    adrift: Collection[str] = ()

    @property
    def moved(self) -> set[str]:
        """All axes that it moves."""
        return {*self.moving, *self.adrift}

    @cached_property
    def whole_box(self) -> Box:
        """Where all axes can be in all of it."""
        ends = {name: axis.find_extent(0.0, self.duration_s) for name, axis in self.moving.items()}
        return {**self.standing, **ends}

    def find_box(self, axes: Collection[str], begin_s: float, end_s: float, *, trust_step: bool) -> Box:
        """Where axes can be together from one instant to another.

        Any axis may have stopped at an instant while the others go on for their stop time, and by their ramps. A ramp
        takes an axis no farther than its plan does in the time of the ramp, because no plan decelerates faster. So each
        axis is where its plan has it between that instant and `rest_s` later, and each combination of such places is
        possible. With `trust_step` the others are apart from it by the skew alone.
        """
        box: dict[str, tuple[float, float]] = {}
        moving_count = sum(axis in self.moving for axis in axes)
        for name in axes:
            axis = self.moving.get(name)
            if axis is None:
                box[name] = self.standing[name]
                continue
            if moving_count == 1:
                rest_s, skew_s = 0.0, 0.0  # whatever stops, it is on its way
            else:
                skew_s = self.skew_s
                rest_s = skew_s if trust_step else self.duration_s if axis.rest_s is None else axis.rest_s
            box[name] = axis.find_extent(begin_s - skew_s, end_s + max(rest_s, skew_s))
        return box

    def find_resolution(self, axes: Collection[str], *, trust_step: bool) -> float:
        """Into which spans of time it is worth dividing the step, s: finer ones change boxes by little."""
        rests_s = [self.moving[axis].rest_s for axis in axes if axis in self.moving]
        known_s = [rest_s for rest_s in rests_s if rest_s is not None]
        if trust_step or len(rests_s) < 2:
            return self.duration_s / PARTS
        return max(min(known_s, default=self.duration_s) / SHARE, self.duration_s / PARTS)

    def stretch(self, factor: float) -> "Course":
        """The same ways in a longer time."""
        moving_axes = {
            name: replace(axis, profile=axis.profile.stretch_time(factor)) for name, axis in self.moving.items()
        }
        return replace(self, moving=moving_axes, duration_s=self.duration_s * factor)

    def take_alone(self, name: str) -> tuple["Course", "Course"]:
        """A step of one axis alone, with the others where they begin, and the step of the others after it."""
        axis, other_axes = self.moving[name], {key: axis for key, axis in self.moving.items() if key != name}
        begins = {key: axis.find_extent(0.0, 0.0) for key, axis in other_axes.items()}
        end = axis.find_extent(self.duration_s, self.duration_s)
        first_course = replace(self, moving={name: axis}, standing={**self.standing, **begins})
        return first_course, replace(self, moving=other_axes, standing={**self.standing, name: end})


class Timing(NamedTuple):
    """How far apart in time axes may be. alone: for how long controllers go on without their adapters, s, as of
    `make_fault_reach`. skew_s: what the step allows between members at its start, its end and on the way."""

    alone: Mapping[str, float | None]
    skew_s: float = 0.0


def make_moving_axis(fleet: Fleet, name: str, profile: Profile, timing: Timing) -> MovingAxis:
    """An axis of a step."""
    alone_s = timing.alone.get(controller_of(name), DETECTION_S)
    axis = fleet.axis(name)
    return MovingAxis(axis, profile, None if alone_s is None else max(DETECTION_S, alone_s), find_margin(axis))


def _find_ramp_time(profile: Profile) -> float:
    """How long a ramp of a profile takes from its highest speed to rest, s: a stop is no steeper and no gentler."""
    acceleration = profile.peak_acceleration
    if not acceleration:
        return 0.0
    jerk = max(abs(segment.jerk) for segment in profile.segments)
    return profile.peak_velocity / acceleration + (acceleration / jerk if jerk else 0.0)


def find_margin(axis: Axis) -> float:
    """How far an axis may be from its commanded position, in its unit: its following error, rounding to a count, and
    the play of its drive. Without `following_error` its controller is taken at its word."""
    counts = 1.0 + (0.0 if axis.play is None else float(axis.play.most - axis.play.least))
    return (axis.following_error or 0.0) + abs(axis.to_length(counts))
