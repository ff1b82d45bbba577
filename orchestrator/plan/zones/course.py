"""Where the axes of a step can be while it moves: as planned, or after any one of them has stopped by itself."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.operation.pair_reach import DETECTION_S
from orchestrator.model.profile import Profile
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.extents import ProfileExtents

PARTS = 256
"""Into which a step is divided at most, in time; a path into as many as its longest profile has segments."""
SHARE = 8
"""Of the time for which axes may go on alone: a finer division changes boxes by little."""


@dataclass(frozen=True, slots=True)
class PathTerms:
    """What an axis of a path may do besides its plan. rate: how much faster than planned it may be sent along it, at
    most (feed override). fit_counts: how far it may be from it where its speed is changed."""

    rate: float
    fit_counts: float


@dataclass(frozen=True)
class MovingAxis:
    """One axis of a step. wait_s: for how long it may go on by its plan after another axis has stopped, before its own
    ramp; None: to its end. margin: how far it may be from its planned position, in its unit. path: of a path."""

    axis: Axis
    profile: Profile
    wait_s: float | None
    margin: float
    path: PathTerms | None = None

    @cached_property
    def rest_s(self) -> float | None:
        """How much later in its plan it may come to rest than another axis that stops, s.

        A ramp of a move takes an axis no farther than its plan does in the time of the ramp, because no plan
        decelerates faster. In that of a path, whose time may run faster, the ramp is in `find_extent`.
        """
        if self.wait_s is None:
            return None
        return self.wait_s + _find_ramp_time(self.profile) if self.path is None else self.wait_s * self.path.rate

    @cached_property
    def _extents(self) -> ProfileExtents:
        return ProfileExtents(self.profile)

    def find_extent(self, begin_s: float, end_s: float) -> tuple[float, float]:
        """Between which positions it is from one instant of its profile to another, in its unit, margins included. On a
        path it may leave that at each instant by its own ramp, straight on."""
        low, high = self._extents.find_range(begin_s, end_s)
        if self.path is not None:
            slowest, fastest = self._extents.find_speeds(begin_s, end_s)
            low -= self._find_ramp_way(-slowest * self.path.rate) + self.path.fit_counts
            high += self._find_ramp_way(fastest * self.path.rate) + self.path.fit_counts
        ends = sorted(self.axis.to_unit(self.profile.start_counts + end) for end in (low, high))
        return ends[0] - self.margin, ends[1] + self.margin

    def _find_ramp_way(self, speed: float) -> float:
        """How far its ramp takes it from a speed, counts (/s): v² / 2a, and v a / 2j for a jerk j."""
        if speed <= 0.0:
            return 0.0
        limits, scale = self.axis.limits, float(self.axis.scale)
        rounding_s = 0.0 if limits.jerk is None else limits.acceleration / limits.jerk
        return speed * (speed / (limits.acceleration * scale) + rounding_s) / 2


@dataclass(frozen=True)
class Course:
    """A step in time. moving: the axes that it moves, by name. standing: where the others that rules depend on are,
    with their uncertainty, and those that it moves from where is not known (`adrift`). unknown: of which nothing but
    their range is known, those included. skew_s: how far axes that keep step are apart. recent: where axes may have
    stopped in motions that end as it begins; it goes on for its stop time then. begin_s: where in its profiles it
    begins. margins: the uncertainty of axes that stand."""

    moving: Mapping[str, MovingAxis]
    standing: Box
    duration_s: float
    skew_s: float
    unknown: Collection[str] = ()
    adrift: Collection[str] = ()
    recent: Box = field(default_factory=dict[str, tuple[float, float]])
    begin_s: float = 0.0
    margins: Mapping[str, float] = field(default_factory=dict[str, float])

    @property
    def moved(self) -> set[str]:
        """All axes that it moves."""
        return {*self.moving, *self.adrift}

    @property
    def is_path(self) -> bool:
        """Whether it is a path, of which no axis can be moved by itself."""
        return any(axis.path is not None for axis in self.moving.values())

    @cached_property
    def segments(self) -> int:
        """Of a path, the segments of its longest profile; else 0."""
        return max((len(axis.profile.durations_s) for axis in self.moving.values() if axis.path is not None), default=0)

    @cached_property
    def whole_box(self) -> Box:
        """Where all axes can be in all of it."""
        ends = {name: axis.find_extent(self.begin_s, self.duration_s) for name, axis in self.moving.items()}
        return {**self.standing, **ends}

    def find_box(self, axes: Collection[str], begin_s: float, end_s: float, *, trust_step: bool) -> Box:
        """Where axes can be together from one instant to another.

        Any axis may have stopped at an instant while the others go on for their stop time, and by their ramps. So each
        axis is where its plan has it between that instant and `rest_s` later, and each combination of such places is
        possible. With `trust_step` the others are apart from it by the skew alone.
        """
        box: dict[str, tuple[float, float]] = {}
        is_alone = sum(axis in self.moving for axis in axes) == 1
        for name in axes:
            axis = self.moving.get(name)
            if axis is None:
                box[name] = self.standing[name]
            elif is_alone:  # whatever stops, it is on its way
                box[name] = axis.find_extent(begin_s, end_s)
            else:
                box[name] = self._find_late_extent(axis, begin_s, end_s, trust_step=trust_step)
        return box

    def _find_late_extent(
        self, axis: MovingAxis, begin_s: float, end_s: float, *, trust_step: bool
    ) -> tuple[float, float]:
        """Where an axis is from one instant to another, or for how long it may go on behind that."""
        rest_s = self.skew_s if trust_step else self.duration_s if axis.rest_s is None else axis.rest_s
        return axis.find_extent(begin_s - self.skew_s, end_s + max(rest_s, self.skew_s))

    def find_begin_box(self, axes: Collection[str], *, trust_step: bool) -> Box | None:
        """Where axes can be together after one has stopped in the motions that end as it begins; None: where they
        begin."""
        if self.recent.keys().isdisjoint(axes):
            return None
        box: dict[str, tuple[float, float]] = {}
        for name in axes:
            axis = self.moving.get(name)
            begin_s = self.begin_s
            span = (
                self.standing[name]
                if axis is None
                else self._find_late_extent(axis, begin_s, begin_s, trust_step=trust_step)
            )
            box[name] = join_spans(span, self.recent.get(name, span))
        return box

    def find_recent(self) -> Box:
        """Where its axes may have stopped shortly before its end, for what begins as it ends."""
        rests_s = [self.duration_s if axis.rest_s is None else axis.rest_s for axis in self.moving.values()]
        is_long = self.duration_s > max(rests_s, default=0.0) + self.skew_s
        spans = {} if is_long else dict(self.recent)
        for name, axis in self.moving.items():
            rest_s = self.duration_s if axis.rest_s is None else axis.rest_s + self.skew_s
            span = axis.find_extent(self.duration_s - rest_s, self.duration_s)
            spans[name] = join_spans(span, spans.get(name, span))
        return spans

    def find_resolution(self, axes: Collection[str], *, trust_step: bool) -> float:
        """Into which spans of time it is worth dividing the step, s: finer ones change boxes by little."""
        rests_s = [self.moving[axis].rest_s for axis in axes if axis in self.moving]
        known_s = [rest_s for rest_s in rests_s if rest_s is not None]
        finest_s = self.duration_s / max(PARTS, self.segments)
        if trust_step or len(rests_s) < 2:
            return finest_s
        return max(min(known_s, default=self.duration_s) / SHARE, finest_s)

    def without_margins(self) -> "Course":
        """The same with axes that are where they are said to be, and keep step at its begin."""
        moving_axes = {name: replace(axis, margin=0.0) for name, axis in self.moving.items()}
        standing = {
            name: (low + self.margins.get(name, 0.0), high - self.margins.get(name, 0.0))
            for name, (low, high) in self.standing.items()
        }
        return replace(self, moving=moving_axes, standing=standing, skew_s=0.0)

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


@dataclass(frozen=True, slots=True)
class Sweep:
    """What a step moves, and where the other axes are. profiles: of the axes that it moves from a known position.
    positions: between what motor positions the others that rules depend on are; without one they may be anywhere in
    their range. adrift: those of them that it moves, anywhere between these. paths: of the axes of a path in time.
    recent, begin_s: as of `Course`."""

    profiles: Mapping[str, Profile]
    positions: Box
    timing: Timing
    adrift: Collection[str] = ()
    paths: Mapping[str, PathTerms] = field(default_factory=dict[str, PathTerms])
    recent: Box = field(default_factory=dict[str, tuple[float, float]])
    begin_s: float = 0.0


def make_moving_axis(fleet: Fleet, name: str, profile: Profile, timing: Timing, path: PathTerms | None) -> MovingAxis:
    """An axis of a step. path: of a path in time."""
    alone_s = timing.alone.get(controller_of(name), DETECTION_S)
    axis, wait_s = fleet.axis(name), None if alone_s is None else max(DETECTION_S, alone_s)
    return MovingAxis(axis, profile, wait_s, find_margin(axis), path)


def join_spans(first: tuple[float, float], second: tuple[float, float]) -> tuple[float, float]:
    """The span of both."""
    return min(first[0], second[0]), max(first[1], second[1])


def _find_ramp_time(profile: Profile) -> float:
    """How long a ramp of a profile takes from its highest speed to rest, s: a stop is no steeper and no gentler."""
    acceleration = profile.peak_acceleration
    if not acceleration:
        return 0.0
    jerk = max(abs(segment.jerk) for segment in profile.segments)
    return profile.peak_velocity / acceleration + (acceleration / jerk if jerk else 0.0)


def find_margin(axis: Axis) -> float:
    """How far an axis may be from its commanded position, in its unit: its following error, rounding to a count, the
    play of its drive and its table of errors. Without `following_error` its controller is taken at its word."""
    counts = 1.0 + (0.0 if axis.play is None else float(axis.play.most - axis.play.least))
    span = 0.0 if axis.correction is None else axis.correction.table.span
    return (axis.following_error or 0.0) + abs(axis.to_length(counts)) + span
