"""A planned path in chunks: each is loaded while the one before it is executed, and ends in a stopping tail.

A chunk follows the path up to its end, and then brakes along it to rest. The next chunk begins a little before that end
(`SWITCH_S`), with the same motion up to it: so every member can change over at an instant of its own in between. Where
no next chunk comes, the members brake along the path together.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.names import controller_of
from orchestrator.model.profile import Profile
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_profiles import Array, FittedAxis, FittedMotion, PathStates, fit_stretch

SWITCH_S = 0.1  # in which a chunk and the one after it are the same
END_STEP_S = 0.1  # between two ends that are tried
RAMPS_S = (0.1, 0.15, 0.2, 0.3, 0.4, 0.6, 0.8, 1.2, 1.6, 2.4, 3.2)
RAMP_SAMPLES = 33
MOST_USE = 0.985  # of acceleration and jerk in a ramp: the cubics may exceed the path by a hundredth
LEAST_FAST_S = 1.0  # at a higher rate: less is not worth two ramps
SLOW_BEFORE_S = 0.02  # a higher rate ends before the place that does not allow it
BRAKE_SEARCH_S = 1.0  # after the earliest instant at which a hold could begin


class ChunkPlan(NamedTuple):
    """A chunk, in seconds of the motion: from `begin_s`; along the path to `end_s`; at rest at `stop_s`.

    last: it ends where the path ends. profiles: by axis, from `begin_s` to `stop_s`. clock: with the tail.
    """

    begin_s: float
    end_s: float
    stop_s: float
    last: bool
    profiles: Mapping[str, Profile]
    clock: PathClock

    @property
    def stop_path_s(self) -> float:
        """The path time at which it comes to rest."""
        return self.clock.find_path_s(self.stop_s)


class _ChunkEnd(NamedTuple):
    """Where a chunk ends, as in `ChunkPlan`."""

    clock: PathClock
    end_s: float
    stop_s: float
    last: bool


@dataclass(frozen=True, slots=True)
class PathCourse:
    """The motion along a path, from where the axes stand at the start of the motion.

    motion: of all axes, over path time. axes: by column; their start_counts are where they stand. columns: the axes
    that the path moves. origin: positions of the axes at the start, in their units. fit_error: how far a ramp may be
    off the path.
    """

    motion: FittedMotion
    axes: Sequence[FittedAxis]
    columns: Sequence[int]
    origin: Array
    fit_error: float

    @property
    def duration_s(self) -> float:
        """Of the whole path, at rate 1."""
        return self.motion.duration_s

    def find_peaks(self) -> tuple[dict[str, float], dict[str, float]]:
        """The largest acceleration and jerk of each axis on the whole path, counts/s², counts/s³."""
        steepest, hardest = (
            {
                axis.name: float(peak) * abs(axis.counts_per_unit)
                for axis, peak in zip(self.axes, peaks.max(axis=0), strict=True)
            }
            for peaks in (self.motion.peak_accelerations, np.abs(self.motion.jerks))
        )
        return steepest, hardest

    def find_speed(self, member: str) -> float:
        """The highest speed of a member's axes together, in their units/s."""
        columns = [column for column in self.columns if controller_of(self.axes[column].name) == member]
        return float(np.sqrt((self.motion.velocities[:, columns] ** 2).sum(axis=1).max()))

    def restart(self, path_s: float, counts: Mapping[str, int]) -> "PathCourse":
        """The same path for a motion that begins at rest at `path_s`, where the axes stand at `counts`."""
        axes = [axis._replace(start_counts=counts.get(axis.name, axis.start_counts)) for axis in self.axes]
        return replace(self, axes=axes, origin=self.motion.evaluate(np.array([path_s]))[0][0])

    # Rates

    def begin_at(self, path_s: float, rate: float = 1.0) -> PathClock:
        """The clock of a motion that begins at rest at `path_s`, with `rate` or, if that is more, with 1. Raises
        `Refusal`."""
        if path_s <= 0.0:
            return PathClock.from_rest(0.0, 0.0)
        for ramp_s in RAMPS_S:
            clock = PathClock.from_rest(path_s, ramp_s, min(rate, 1.0))
            if self._fits(clock, 0.0, ramp_s):
                return clock
        raise Refusal("path-ramp", "from this place of the path no start along it keeps the limits", "run it again")

    def require_rate(self, path_s: float, rate: float) -> None:
        """Raise `Refusal` for a rate that no second of the rest of the path allows: the axis, and the highest one."""
        most, _ = self._find_rates()
        remainder = self.motion.times_s[:-1] >= path_s
        steps = np.diff(self.motion.times_s)[remainder]
        if rate <= 1.0 or float(steps[most[remainder] >= rate].sum()) >= LEAST_FAST_S:
            return
        highest = max(1.0, float(most[remainder].max(initial=1.0)))
        text = f"{rate:.0%} is too fast for the rest of the path; its axes allow {highest:.0%}"
        raise Refusal("override", text, f"choose at most {int(100 * highest)} %")

    def adapt_rate(self, clock: PathClock, from_s: float, rate: float, within_s: float) -> PathClock:
        """The clock from `from_s` on for `within_s`: at `rate`, or at 1 where the axes do not allow that. They allow 1
        everywhere. Raises `Refusal`."""
        if rate <= 1.0:
            return self._reach_rate(clock, from_s, rate)
        slow_s = self._find_slow(clock.find_path_s(from_s), rate)
        if clock.rate < rate:
            try:
                faster = self.change_rate(clock, from_s, rate)
            except Refusal:
                return self._reach_rate(clock, from_s, 1.0)
            if slow_s - faster.ramps[-1].end_path_s < rate * LEAST_FAST_S:
                return self._reach_rate(clock, from_s, 1.0)
            clock = faster
        arrives_s = clock.find_instant(slow_s)
        if arrives_s > from_s + within_s + LEAST_FAST_S:
            return clock
        # As late as a ramp fits in before the slow place, and at once if none does.
        for ramp_s in RAMPS_S:
            begin_s = clock.find_instant(slow_s - (rate + 1.0) / 2 * ramp_s - SLOW_BEFORE_S)
            if begin_s >= max(from_s, clock.ramps[-1].end_s):
                slower = clock.change_rate(begin_s, 1.0, ramp_s)
                if self._fits(slower, begin_s, ramp_s):
                    return slower
        return self.change_rate(clock, from_s, 1.0)

    def _reach_rate(self, clock: PathClock, from_s: float, rate: float) -> PathClock:
        return clock if clock.rate == rate else self.change_rate(clock, from_s, rate)

    def _find_slow(self, path_s: float, rate: float) -> float:
        """The first instant of the path from `path_s` on at which an axis does not allow `rate`."""
        most, times_s = self._find_rates()
        slow = np.flatnonzero((most < rate) & (times_s[1:] > path_s))
        return float(max(times_s[slow[0]], path_s)) if len(slow) else self.duration_s

    def _find_rates(self) -> tuple[Array, Array]:
        """(the highest rate that each cubic allows, the instants between them)."""
        motion = self.motion
        peaks = (
            np.maximum(np.abs(motion.velocities[:-1]), np.abs(motion.velocities[1:])),
            motion.peak_accelerations / MOST_USE,
            np.abs(motion.jerks),
        )
        rates = [
            (self._limits(order) / np.maximum(values, 1e-300)).min(axis=1) ** (1.0 / (order + 1))
            for order, values in enumerate(peaks)
        ]
        return np.minimum(np.minimum(rates[0], rates[1]), rates[2]), motion.times_s

    def brake(self, clock: PathClock, from_s: float) -> PathClock:
        """The clock that brakes along the path as soon as possible after `from_s`. Raises `Refusal`."""
        return self.change_rate(clock, from_s, 0.0)

    def change_rate(self, clock: PathClock, from_s: float, rate: float) -> PathClock:
        """The clock with another rate as soon as possible after `from_s`. Raises `Refusal`."""
        at_s = max(from_s, clock.ramps[-1].end_s)
        for begin_s in np.arange(at_s, at_s + BRAKE_SEARCH_S, END_STEP_S / 2).tolist():
            for ramp_s in RAMPS_S:
                changed_rate = clock.change_rate(begin_s, rate, ramp_s)
                if changed_rate.ramps[-1].end_path_s >= self.duration_s:
                    break
                if self._fits(changed_rate, begin_s, ramp_s):
                    return changed_rate
        text = f"no change of speed within {BRAKE_SEARCH_S:g} s keeps the limits of the axes, or the path ends before"
        raise Refusal("path-ramp", text, "try again a little later")

    # Chunks

    def plan_chunk(self, clock: PathClock, begin_s: float, most_s: float) -> ChunkPlan:
        """The chunk from `begin_s` on, at most `most_s` long with its tail. Raises `Refusal`, `PlanError`."""
        return self._make_chunk(self._find_end(clock, begin_s, most_s), begin_s)

    def plan_stop(self, clock: PathClock, begin_s: float) -> ChunkPlan:
        """The chunk from `begin_s` to the end of a clock that comes to rest."""
        return self._make_chunk(_find_stop(clock), begin_s)

    def has_chunks(self, most_s: float) -> bool:
        """Whether it can be executed in chunks that are at most so long, and braked along the path behind each."""
        begin_s, clock = 0.0, self.begin_at(0.0)
        try:
            while not (end := self._find_end(clock, begin_s, most_s)).last:
                begin_s = end.end_s - SWITCH_S
        except Refusal:
            return False
        return True

    def _find_end(self, clock: PathClock, begin_s: float, most_s: float) -> _ChunkEnd:
        """The end of the chunk from `begin_s` on, at most `most_s` long with its tail. Raises `Refusal`."""
        ends_s = clock.find_instant(self.duration_s)
        if ends_s - begin_s <= most_s:
            return _ChunkEnd(clock, ends_s, ends_s, last=True)
        if clock.rate <= 0.0:
            return _find_stop(clock)
        least_s = max(begin_s + SWITCH_S, clock.ramps[-1].end_s)
        latest_s = begin_s + most_s - RAMPS_S[0]
        for end_s in np.arange(latest_s, least_s, -END_STEP_S).tolist():
            for ramp_s in RAMPS_S:
                if end_s + ramp_s > begin_s + most_s:
                    break
                tail = clock.change_rate(end_s, 0.0, ramp_s)
                if tail.ramps[-1].end_path_s < self.duration_s and self._fits(tail, end_s, ramp_s):
                    return _ChunkEnd(tail, end_s, end_s + ramp_s, last=False)
        text = f"from {begin_s:.1f} s of the path on, it could not be braked along the path within {most_s:.1f} s"
        raise Refusal("path-brake", text, "allow the path less `acceleration` than its axes, or corners that stop")

    def _make_chunk(self, end: _ChunkEnd, begin_s: float) -> ChunkPlan:
        clock, end_s, stop_s, last = end
        parts = self._cut(clock, begin_s, stop_s)
        durations = np.concatenate([np.diff(part.times_s) for part in parts]).tolist()
        accelerations = np.concatenate([part.accelerations for part in parts])
        jerks = np.concatenate([part.jerks for part in parts])
        positions, velocities, *_ = self._evaluate(clock, np.array([begin_s, stop_s]))
        profiles = {
            self.axes[column].name: Profile(
                start_counts=self.axes[column].start_counts,
                end_counts=self.axes[column].end_counts if last else self._round(column, positions[1, column]),
                scale_counts=self.axes[column].counts_per_unit,
                durations_s=durations,
                accelerations=accelerations[:, column].tolist(),
                jerks=jerks[:, column].tolist(),
                first_position=float(positions[0, column] - self.origin[column]),
                first_velocity=float(velocities[0, column]),
            )
            for column in self.columns
        }
        return ChunkPlan(begin_s=begin_s, end_s=end_s, stop_s=stop_s, last=last, profiles=profiles, clock=clock)

    def _round(self, column: int, position: float) -> int:
        axis = self.axes[column]
        return axis.start_counts + round(axis.counts_per_unit * float(position - self.origin[column]))

    def _cut(self, clock: PathClock, begin_s: float, stop_s: float) -> list[FittedMotion]:
        """The cubics of the motion between two instants: those of the path where the rate is constant, others in
        ramps."""
        marks = {begin_s, stop_s}
        marks |= {at for ramp in clock.ramps for at in (ramp.begin_s, ramp.end_s) if begin_s < at < stop_s}
        edges = sorted(marks)
        parts: list[FittedMotion] = []
        for first_s, last_s in pairwise(edges):
            times = clock.evaluate(np.array([first_s, (first_s + last_s) / 2, last_s]))
            if times.changes[1] == 0.0 and times.rates[1] > 0.0:
                ends = float(times.path_s[0]), float(times.path_s[2])
                parts.append(_slice(self.motion, *ends).stretch_time(1.0 / float(times.rates[1])))
            else:
                parts.append(self._fit_ramp(clock, first_s, last_s))
        return parts

    def _fit_ramp(self, clock: PathClock, first_s: float, last_s: float) -> FittedMotion:
        def evaluate(times_s: Array) -> PathStates:
            return PathStates(*self._evaluate(clock, first_s + times_s)[:3])

        return fit_stretch(evaluate, last_s - first_s, self.axes, self.fit_error)

    # Limits

    def _evaluate(self, clock: PathClock, times_s: Array) -> tuple[Array, Array, Array, Array]:
        path_s, rates, changes, jerks = clock.evaluate(times_s)
        q, v, a, j = self.motion.evaluate(path_s)
        r, c = rates[:, None], changes[:, None]
        return q, v * r, a * r**2 + v * c, j * r**3 + 3 * a * r * c + v * jerks[:, None]

    def _fits(self, clock: PathClock, begin_s: float, ramp_s: float) -> bool:
        """Whether a ramp keeps all limits."""
        _, v, a, j = self._evaluate(clock, begin_s + ramp_s * np.linspace(1e-6, 1.0 - 1e-6, RAMP_SAMPLES))
        uses = [
            (np.abs(values).max(axis=0) / self._limits(order)).max()
            for order, values in ((0, v), (1, a / MOST_USE), (2, j))
        ]
        return max(uses) <= 1.0 + 1e-9

    def _limits(self, order: int) -> Array:
        return np.array([(axis.velocity, axis.acceleration, axis.jerk)[order] for axis in self.axes])


def _find_stop(clock: PathClock) -> _ChunkEnd:
    """The end of a clock that comes to rest."""
    brake = clock.ramps[-1]
    return _ChunkEnd(clock, brake.begin_s, brake.end_s, last=False)


def _slice(motion: FittedMotion, begin_s: float, stop_s: float) -> FittedMotion:
    """The cubics of a motion between two instants."""
    first = int(np.searchsorted(motion.times_s, begin_s, side="right")) - 1
    last = int(np.searchsorted(motion.times_s, stop_s, side="left")) - 1
    first, last = max(0, first), min(max(first, last), len(motion.jerks) - 1)
    times_s = np.concatenate([[begin_s], motion.times_s[first + 1 : last + 1], [stop_s]])
    shift = begin_s - float(motion.times_s[first])
    accelerations = motion.accelerations[first : last + 1].copy()
    accelerations[0] += motion.jerks[first] * shift
    positions, velocities, *_ = motion.evaluate(times_s)
    return FittedMotion(times_s, positions, velocities, accelerations, motion.jerks[first : last + 1])
