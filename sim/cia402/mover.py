"""The commanded motion of the motor, in closed form, with the positions that it passes."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S, ClockTimer
from sim.cia402.profile import MotionPlan, to_linear
from sim.core.controller import CommandedMotion
from sim.core.devicetime import DeviceTime
from sim.core.ramps import first_at

POSITION_RESOLUTION = 0.5
"""Targets are whole units: closer positions are equal."""
PAUSE_NS = 500_000_000
"""Longest pause of an interpolated path within one motion: at low speed, a period may have no unit to move."""


@dataclass(frozen=True, slots=True)
class PositionMark:
    """A position whose callback is called when the motion passes it in direction `sign`, or begins beyond it."""

    place: float
    sign: int
    passed: Callable[[], None]


class MotionGenerator:
    """Commanded motion of one motor.

    Positions are mechanical: in the user's units, from the position at construction, never redefined.

    marks: returns the positions to watch, called at the begin of each plan.
    ended: called when a plan that ends at standstill is over.
    """

    def __init__(
        self, time: DeviceTime, axis: str, marks: Callable[[], Sequence[PositionMark]], ended: Callable[[], None]
    ) -> None:
        self._time = time
        self._axis = axis
        self._marks = marks
        self._ended = ended
        self._rest = 0.0
        self._base = 0.0
        self._plan: MotionPlan | None = None
        self._begin_ns = 0
        self._timers: list[ClockTimer] = []
        self._motion: CommandedMotion | None = None
        self.motions: list[CommandedMotion] = []
        self.shift: Callable[[], float] = lambda: 0.0
        """Offset from mechanical to the user's positions, for the record of motions."""
        self.slowing = False
        """The motion ends because of a stop."""
        self._interpolating = False
        self._path: CommandedMotion | None = None
        """An interpolated path that pauses, and may continue."""
        self._ended_ns = 0

    # Position

    def _state_now(self) -> tuple[float, float]:
        if self._plan is None:
            return self._rest, 0.0
        displacement, speed = self._plan.state_at((self._time.now_ns() - self._begin_ns) / NS_PER_S)
        return self._base + displacement, speed

    @property
    def current_position(self) -> float:
        return self._state_now()[0]

    @property
    def current_speed(self) -> float:
        """Speed in units per second of the drive's crystal."""
        return self._state_now()[1]

    @property
    def is_moving(self) -> bool:
        return self._plan is not None

    @property
    def is_running(self) -> bool:
        """Return whether a motion is recorded as in progress: also between the segments of an interpolated path."""
        return self._motion is not None

    # Orders, effective now

    def start_plan(self, plan: MotionPlan, start_position: float | None = None, *, slowing: bool = False) -> None:
        """Replace the present motion by `plan`, from `start_position` on.

        slowing: because of a stop."""
        start_position = self.current_position if start_position is None else start_position
        self._cancel_timers()
        now_ns = self._time.now_ns()
        self._base, self._plan, self._begin_ns, self.slowing = start_position, plan, now_ns, slowing
        if self._motion is None:
            self._motion = self._resumable_motion(now_ns) or self._begin_motion(now_ns, start_position)
        if slowing and self._motion.slowing_ns is None:
            self._motion.slowing_ns = self._time.true_ns(now_ns)
        self._watch_marks(plan, 0.0)

    def _begin_motion(self, now_ns: int, start_position: float) -> CommandedMotion:
        motion = CommandedMotion(self._axis, self._time.true_ns(now_ns), start_position + self.shift())
        self.motions.append(motion)
        return motion

    def _resumable_motion(self, now_ns: int) -> CommandedMotion | None:
        """Return the path that has only paused briefly."""
        if not self._interpolating or self._path is None:
            return None
        motion, self._path = self._path, None
        if self._time.true_ns(now_ns) - self._ended_ns > PAUSE_NS:
            return None
        motion.end_ns = motion.end_counts = None
        return motion

    def recheck_marks(self) -> None:
        """Evaluate the marks again after a change."""
        if self._plan is not None:
            plan = self._plan
            self._cancel_timers()
            self._watch_marks(plan, (self._time.now_ns() - self._begin_ns) / NS_PER_S)

    def _watch_marks(self, plan: MotionPlan, from_s: float) -> None:
        if not math.isinf(plan.duration_s):
            self._call_after(plan.duration_s, self._finish_plan)
        for mark in self._marks():
            after_s = first_at(plan.segments, plan.duration_s, mark.place - self._base, mark.sign, from_s)
            if after_s is not None and not math.isinf(after_s):
                self._call_after(after_s, mark.passed)

    def follow_target(self, target: float, period_s: float) -> None:
        """Follow one segment of an interpolated path, to `target` in `period_s`. `ended` is not called: the next
        segment may follow."""
        start_position = self.current_position  # live, the position differs when it is read again
        distance = target - start_position
        if abs(distance) >= POSITION_RESOLUTION:
            self.start_plan(to_linear(distance, period_s), start_position=start_position)
        elif self._plan is None and self._motion is not None:
            # It has been at standstill since the end of its last segment.
            self._path = self._motion
            self._close_motion(self._ended_ns)

    def set_interpolating(self, *, on: bool) -> None:
        """Set whether plans are segments of a path: then the end of one is not the end of the motion."""
        self._interpolating, self._path = on, None
        if not on and self._plan is None and self._motion is not None:
            self._close_motion(self._ended_ns)

    def halt_dead(self) -> None:
        """Stop at once: the power stage is off, or there was no motion."""
        self._rest = self.current_position
        self._cancel_timers()
        self._plan = None
        if self._motion is not None:
            self._close_motion(self._time.true_ns(self._time.now_ns()))

    def set_position(self, position: float) -> None:
        """Set the position of a motor at rest that was moved by hand."""
        self._rest = position

    # Internal

    def _call_after(self, after_s: float, callback: Callable[[], None]) -> None:
        at_ns = self._begin_ns + math.ceil(after_s * NS_PER_S)
        plan = self._plan

        def run_callback() -> None:
            if self._plan is plan:
                callback()

        self._timers.append(self._time.call_at(at_ns, run_callback))

    def _finish_plan(self) -> None:
        plan = self._plan
        assert plan is not None
        self._rest = self._base + plan.distance
        self._cancel_timers()
        self._plan = None
        self._ended_ns = self._time.true_ns(self._begin_ns + round(plan.duration_s * NS_PER_S))
        if not self._interpolating:
            self._close_motion(self._ended_ns)
            self._ended()

    def _close_motion(self, at_ns: int) -> None:
        assert self._motion is not None
        self._motion.end_ns, self._motion.end_counts = at_ns, self._rest + self.shift()
        self._motion = None

    def _cancel_timers(self) -> None:
        for timer in self._timers:
            timer.cancel()
        self._timers.clear()
