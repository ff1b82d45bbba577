"""The rows of lines that are flown in one motion: given out line by line while it flies.

A row is given out as soon as it is certain that its line was flown as planned: what was released reaches beyond its
end at the planned speed, and every member has published a reading behind it that shows it in motion and without fault.
When an axis was in a window follows from the evidence of the start, and from the bound of the clock, which is fitted
anew with each chunk. As with single lines, an axis that is off its plan by a distance is off in time by that divided by
the speed.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import ceil, inf
from typing import Literal

import numpy as np

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.jobs.run.flown_rows import OTHER_TIME, find_error, make_position_finder
from orchestrator.coordinator.jobs.run.trigger_watch import TriggerWatch
from orchestrator.coordinator.jobs.run.window_instants import make_interval_finder
from orchestrator.coordinator.motion.report import judge_starts
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import FEED_HOLD
from orchestrator.coordinator.motion.step import BRAKED, MotionStep, PlannedMotion
from orchestrator.model.report import PointRecord, PointWindow, StepReport, Verdict
from orchestrator.model.steps.order import StepPlace
from orchestrator.plan.flying.flight import FlightLine
from orchestrator.plan.flying.path import FlownPart
from orchestrator.plan.path_clock import PathClock

LEAST_RATE = 0.01
"""Of the planned speed: an axis that is slower passes no place at an instant that is known."""


@dataclass(frozen=True, slots=True)
class FlightEnd:
    """How a flight has ended. rows: those that were not given out before. next_point: of the scan, from 0, that is
    flown next. late: it was braked because a chunk came too late. broken: points whose windows were
    disturbed. is_interrupted: it was braked on its way, and goes on."""

    rows: list[PointRecord]
    next_point: int
    late: bool = False
    broken: range = range(0)
    is_interrupted: bool = False


class FlightRows:
    """The rows of the flight that a step is. place: of its first line."""

    def __init__(self, services: MotionServices, place: StepPlace, part: FlownPart) -> None:
        self._services = services
        self._view = services.fleet.view
        self._now_ns = services.leadership.fleet_now_ns
        self._place = place
        self._part = part
        self._waiting = list(part.flight.lines)
        self._confirmed_s = -inf
        self._motion: PlannedMotion | None = None
        self._step: MotionStep | None = None
        self._switched: TriggerWatch | None = None
        """What is known of its output while it flies; None: nothing is."""

    @property
    def motion(self) -> PlannedMotion | None:
        """The flight, once it is agreed on."""
        return self._motion

    @property
    def steps(self) -> int:
        """The steps of the scan that it stands for."""
        lines = len(self._part.flight.lines)
        return lines * (self._place.scan.points_steps if self._place.scan is not None else 1)

    def find_line_end(self, after_s: float) -> float | None:
        """When the line that is flown at an instant of the flight is over, or the next one; None behind all of them."""
        return next((line.end_s for line in self._part.flight.lines if line.end_s >= after_s), None)

    @property
    def point(self) -> int:
        """The point of the scan, from 0, that it flies through now."""
        at_s = self._find_now_s()
        lines = [line for line in self._part.flight.lines if line.begin_s <= at_s]
        if not lines:
            return self._part.first
        return lines[-1].first + min(lines[-1].points - 1, int((at_s - lines[-1].begin_s) / lines[-1].window_s))

    def _find_now_s(self) -> float:
        t0_ns = 0 if self._motion is None else self._motion.start.state.t0_fleet_ns
        return (self._now_ns() - t0_ns) / NS_PER_S if t0_ns else -inf

    def observe(self, step: MotionStep | None) -> None:
        """Take the present motion of the step, and what its members have published meanwhile."""
        motion = None if step is None else step.motion
        if motion is None:
            return
        self._step, self._motion = step, motion
        is_shown = self._outputs and self._part.shows_switching and motion.feed is not None
        if is_shown and (self._switched is None or self._switched.motion is not motion):
            self._switched = TriggerWatch(self._services, motion, self._outputs[0])
        t0_ns = motion.start.state.t0_fleet_ns
        if t0_ns and motion.watch.failure is None:
            readings_ns = [self._find_reading_ns(member) for member in motion.agreement.proposals]
            self._confirmed_s = max(self._confirmed_s, (min(readings_ns, default=0) - t0_ns) / NS_PER_S)

    def _find_reading_ns(self, member: str) -> int:
        """Until when a member is known to have followed its plan: its last reading; 0: not at all."""
        motion, state = self._motion, self._view.last_state(member)
        assert motion is not None
        if state is None or state.read_fleet_ns is None or state.faults or self._view.is_silent(member):
            return 0
        if state.instance != motion.planned.instances.get(member, state.instance):
            return 0
        flown_axes = self._part.lines.scan.flown_axes
        members_moving: list[bool] = []
        for name in motion.agreement.profiles(member):
            axis = state.axes[name]
            if not axis.enabled or axis.fault:
                return 0
            if f"{member}.{name}" in flown_axes:
                members_moving.append(axis.moving)
        # One that is slow on a line may look as at rest; all of a member move by the same course.
        return 0 if members_moving and not any(members_moving) else state.read_fleet_ns

    # Rows

    def take(self) -> list[PointRecord]:
        """The rows of lines that have become certain; with triggers whose owner shows them at the end only, none is
        before the end of the flight."""
        verdict = self._judge_starts()
        if verdict is None or (self._outputs and self._switched is None):
            return []
        return self._take_until(self._confirmed_s, verdict, None if self._switched is None else self._switched.count)

    @property
    def waits_for_switching(self) -> bool:
        """Whether a line is certain but for what was switched in it, which can be read now."""
        if self._switched is None or self._judge_starts() is None:
            return False
        line = next(self._find_certain_lines(self._confirmed_s), None)
        return line is not None and not self._is_switching_known(line, self._switched.count)

    async def look_at_switching(self) -> None:
        """Fetch what was switched up to now. Raises nothing."""
        if self._switched is not None:
            await self._switched.look()

    def finish(self, report: StepReport) -> FlightEnd:
        """The rows that were not given out, and where the scan goes on."""
        code = "" if report.refused is None else report.refused.code
        verdict = self._judge_starts()
        if report.state == "done":
            # What a trigger missed concerns the row of its point alone.
            other_deviations = [text for text in report.deviations if not text.startswith(tuple(self._outputs))]
            row_verdict = report.verdict if other_deviations or verdict is None else verdict
            return FlightEnd(self._take_until(inf, row_verdict), self._part.end)
        if code not in (FEED_HOLD, BRAKED):
            rows = [] if verdict is None else self._take_until(self._confirmed_s, verdict)
            return FlightEnd([*rows, *self._list_broken(report.state)], self._part.first)
        is_late = code == BRAKED
        rows = [] if verdict is None else self._take_until(inf, verdict)
        if not self._waiting:
            return FlightEnd(rows, self._part.end, late=is_late, is_interrupted=True)
        line, flown_count = self._waiting[0], 0
        if verdict is not None:
            edges = line.begin_s + line.window_s * np.arange(1, line.points + 1)
            flown_count = int(np.searchsorted(edges, self._find_released_s(), side="right"))
            rows += self._make_rows(line, flown_count, verdict)
        broken_points = self._find_broken(line, flown_count)
        return FlightEnd(rows, line.first + flown_count, late=is_late, broken=broken_points, is_interrupted=True)

    def _take_until(self, certain_s: float, verdict: Verdict, switched: int | None = None) -> list[PointRecord]:
        """The rows of lines that are over at an instant of the motion. verdict: on what is known of it. switched: how
        many windows are known to have been switched in; None: no more will be known."""
        rows: list[PointRecord] = []
        while (line := next(self._find_certain_lines(certain_s), None)) is not None:
            if switched is not None and not self._is_switching_known(line, switched):
                break
            rows += self._make_rows(self._waiting.pop(0), line.points, verdict)
        return rows

    def _find_certain_lines(self, certain_s: float) -> Iterator[FlightLine]:
        """The lines whose rows were not given out, and that are over at an instant of the motion."""
        released_s, clock = self._find_released_s(), self._clock
        if clock is None:
            return
        for line in self._waiting:
            if line.end_s > released_s or float(clock.find_instants(np.array([line.end_s]))[0]) > certain_s:
                return
            yield line

    def _is_switching_known(self, line: FlightLine, count: int) -> bool:
        """Whether it is known what was switched in a line. count: the windows of which it is."""
        return line.first + line.points - self._part.first <= count

    @property
    def _clock(self) -> PathClock | None:
        """The time of the flight in the time of its motion, as far as it is released."""
        feed = None if self._motion is None else self._motion.feed
        return None if feed is None else feed.chunk.clock

    def _find_released_s(self) -> float:
        """How far the flight is released, in its own time, without its stopping tail."""
        feed = None if self._motion is None else self._motion.feed
        if feed is None:
            return -inf
        return inf if feed.chunk.last else feed.chunk.clock.find_path_s(feed.chunk.end_s)

    def _find_broken(self, line: FlightLine, flown_count: int) -> range:
        """The points of a line behind its first ones that were flown, whose windows have begun when the flight was at
        rest."""
        feed = None if self._motion is None else self._motion.feed
        stop_s = line.begin_s if feed is None else feed.chunk.stop_path_s
        begun_count = max(flown_count, min(line.points, ceil((stop_s - line.begin_s) / line.window_s)))
        return range(line.first + flown_count, line.first + begun_count)

    def _judge_starts(self) -> Verdict | None:
        """The verdict on the starts of all members; None as long as one is not known."""
        motion = self._motion
        return None if motion is None else judge_starts(motion.agreement, motion.watch.reports)

    def _make_rows(self, line: FlightLine, count: int, verdict: Verdict) -> list[PointRecord]:
        """The rows of the first points of a line. A window at another speed than planned is not good, and neither is
        one in which the speed changes."""
        motion, lines = self._motion, self._part.lines
        assert self._clock is not None and motion is not None and motion.agreement.path is not None
        find_interval = make_interval_finder(motion, lines)
        find_positions = make_position_finder(lines, line.first, count, find_error(motion.agreement.path, lines))
        parts = line.begin_s + line.window_s * np.arange(2 * count + 1) / 2
        at_s = self._clock.find_instants(parts)
        rates = self._clock.evaluate(at_s).rates
        rows: list[PointRecord] = []
        for number in range(count):
            part = slice(2 * number, 2 * number + 3)
            lower, middle, upper = (
                find_interval(instant_s, rate)
                for instant_s, rate in zip(at_s[part].tolist(), rates[part].tolist(), strict=True)
            )
            took_s = float(at_s[part][-1] - at_s[part][0])
            window = PointWindow(lower=lower, middle=middle, upper=upper, positions=find_positions(number, middle))
            row = self._make_row(line.first + number, "done", verdict=verdict, window=window, took_s=took_s)
            is_at_speed = abs(took_s / line.window_s - 1) <= OTHER_TIME
            is_at_speed = is_at_speed and bool((np.abs(rates[part] - 1) <= OTHER_TIME).all())
            is_good = row.good and is_at_speed and self._is_switched(line.first + number)
            rows.append(row.model_copy(update={"good": is_good}))
        return rows

    @property
    def _outputs(self) -> list[str]:
        """What is switched in each window."""
        return [] if self._part.lines.trigger is None else [self._part.lines.trigger.output]

    def _is_switched(self, point: int) -> bool:
        """Whether the outputs are known to have been switched in the window of a point, within what was promised."""
        if not self._outputs or self._step is None:
            return not self._outputs
        number, totals = point - self._part.first + 1, self._step.switched.get(self._outputs[0])
        if self._switched is not None and number <= self._switched.count:
            return number not in self._switched.wrong
        return totals is not None and number <= totals.rows and number not in totals.wrong

    def _make_row(
        self,
        point: int,
        state: Literal["done", "failed", "stopped"],
        verdict: Verdict = "none",
        window: PointWindow | None = None,
        took_s: float | None = None,
    ) -> PointRecord:
        target = self._part.lines.find_target(point)
        return PointRecord(
            step=self._place.first,
            point=point + 1,
            state=state,
            verdict=verdict,
            t0_fleet_ns=None if self._motion is None else self._motion.start.state.t0_fleet_ns,
            took_s=took_s,
            target=target,
            measured=dict.fromkeys(target),
            window=window,
            good=window is not None and verdict != "red",
        )

    def make_broken_rows(self, points: range) -> list[PointRecord]:
        """Rows of points whose windows were disturbed, and are not flown again."""
        return [self._make_row(point, "stopped") for point in points]

    def _list_broken(self, state: Literal["done", "failed", "stopped", "skipped"]) -> list[PointRecord]:
        """The rows of the lines that had begun when the flight failed, and were not certain; at least one."""
        words: Literal["failed", "stopped"] = "stopped" if state == "stopped" else "failed"
        at_s = self._find_now_s()
        begun_lines = [line for line in self._waiting if line.begin_s <= at_s]
        if not begun_lines:
            first = self._waiting[0].first if self._waiting else self._part.first
            return [self._make_row(first, words)]
        points = range(begun_lines[0].first, begun_lines[-1].first + begun_lines[-1].points)
        return [self._make_row(point, words) for point in points]
