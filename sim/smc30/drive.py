"""The motor: position counter, end-of-travel inputs, and the run of steps in progress."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import Enum, auto

from orchestrator.clock.base import NS_PER_S, ClockTimer
from sim.core.controller import CommandedMotion, LimitSwitch
from sim.core.devicetime import DeviceTime
from sim.smc30.profile import StepProfile, stop_profile

COUNTER_MAX = 8_388_607
COUNTER_MIN = -8_388_608
_WHOLE = 1e-6  # steps: rounding of times and square roots may fall short of a step by this much


class RunEnd(Enum):
    """Reason for the end of a run of steps."""

    DONE = auto()
    """The requested steps, or a stop ramp, are complete."""
    SWITCH = auto()
    """The end-of-travel input of its direction is active (L771-L827)."""
    OVERFLOW = auto()
    """The position counter is at its limit (L1239-L1247)."""
    HALTED = auto()
    """Stopped immediately by the firmware."""


Ended = Callable[[RunEnd], None]


@dataclass(frozen=True, slots=True)
class StepOrder:
    """Steps (may be infinite) in one direction. `ended` is called once, perhaps before the start returns."""

    sign: int
    steps: float
    build_profile: Callable[[float], StepProfile]
    """Builds the profile of a given number of steps, for the part that the Stop input leaves."""
    start_rate: float
    slope: float
    ended: Ended


@dataclass(slots=True)
class _StepRun:
    """A running order. Steps of the profile are counted from where the counter was at the start of the run."""

    order: StepOrder
    profile: StepProfile
    motion: CommandedMotion
    origin_ns: int
    """Device instant that the profile's time counts from."""
    timer: ClockTimer | None = None


class StepGenerator:
    """One motor. `_counter` is the position counter and `_place` the steps from the first power-up, both at rest."""

    def __init__(
        self, time: DeviceTime, axis: str, motions: list[CommandedMotion], travel: tuple[int, int] | None
    ) -> None:
        self._time = time
        self.axis = axis
        self._motions = motions
        self._travel = travel
        self._limits: LimitSwitch | None = None
        self._counter = 0
        self._place = 0
        self._run: _StepRun | None = None
        self._frozen: StepOrder | None = None
        self.held = False
        """The Stop input is active."""
        self.overflow = False
        """The counter's limit has stopped the motor, and the counter has not been set since (decision 17)."""

    # Position

    @property
    def is_moving(self) -> bool:
        return self._run is not None

    @property
    def is_occupied(self) -> bool:
        """A run is in progress, or resumes when the Stop input is released."""
        return self._run is not None or self._frozen is not None

    def exact_state(self) -> tuple[float, float]:
        """Return the counter, not rounded to whole steps, and the velocity in steps per device second."""
        if self._run is None:
            return float(self._counter), 0.0
        steps, rate = self._run_progress(self._run)
        return self._counter + self._run.order.sign * steps, self._run.order.sign * rate

    @property
    def position_counter(self) -> int:
        """Position counter: completed steps."""
        return self._counter + self._steps_made()

    @property
    def physical_steps(self) -> int:
        """Steps from the first power-up."""
        return self._place + self._steps_made()

    def set_counter(self, value: int) -> None:
        self.overflow = False
        self._counter = value - self._steps_made()

    def _steps_made(self) -> int:
        run = self._run
        return 0 if run is None else run.order.sign * math.floor(self._run_progress(run)[0] + _WHOLE)

    def _run_progress(self, run: _StepRun) -> tuple[float, float]:
        return run.profile.state_at((self._time.now_ns() - run.origin_ns) / NS_PER_S)

    # Runs

    def start_run(self, order: StepOrder) -> None:
        """Run an order."""
        if self.held:
            self._frozen = order
            return
        if order.steps < 1:
            order.ended(RunEnd.DONE)
        elif self.is_limit_active(order.sign):
            order.ended(RunEnd.SWITCH)
        elif self._steps_to_limit(order.sign) < 1:
            self.overflow = True
            order.ended(RunEnd.OVERFLOW)
        else:
            motion = CommandedMotion(self.axis, self._time.clock.now_ns(), float(self._counter))
            self._motions.append(motion)
            now_ns = self._time.now_ns()
            self._run = _StepRun(order, order.build_profile(order.steps), motion, now_ns)
            self._schedule_event(self._run)

    def _steps_to_limit(self, sign: int) -> int:
        return COUNTER_MAX - self._counter if sign > 0 else self._counter - COUNTER_MIN

    def _schedule_event(self, run: _StepRun) -> None:
        """Schedule one event: the earliest of the profile's end, the counter's limit and a travel switch."""
        if run.timer is not None:
            run.timer.cancel()
        steps, end = run.profile.distance, RunEnd.DONE
        room = self._steps_to_limit(run.order.sign)
        if room < steps:
            steps, end = float(room), RunEnd.OVERFLOW
        if self._travel is not None and self._limits is None:
            low, high = self._travel
            distance = high - self._place if run.order.sign > 0 else self._place - low
            if distance < steps:
                steps, end = float(distance), RunEnd.SWITCH
        due_ns = run.origin_ns + math.ceil(run.profile.reached_s(steps) * NS_PER_S)
        run.timer = self._time.call_at(due_ns, lambda: self._finish_run(run, round(steps), end))

    def _finish_run(self, run: _StepRun, steps: int, end: RunEnd) -> None:
        self._record_end(run, steps)
        self.overflow = self.overflow or end is RunEnd.OVERFLOW
        run.order.ended(end)

    def _record_end(self, run: _StepRun, steps: int) -> None:
        if run.timer is not None:
            run.timer.cancel()
        self._counter += run.order.sign * steps
        self._place += run.order.sign * steps
        run.motion.end_ns = self._time.clock.now_ns()
        run.motion.end_counts = float(self._counter)
        self._run = None

    def _cut_run(self) -> _StepRun | None:
        """Stop immediately on the last completed step; return the run that was in progress."""
        run = self._run
        if run is not None:
            self._record_end(run, abs(self._steps_made()))
        return run

    def halt_run(self, end: RunEnd = RunEnd.HALTED) -> None:
        """Stop immediately and notify the originator of the run."""
        frozen, self._frozen = self._frozen, None
        run = self._cut_run()
        for order in (None if run is None else run.order, frozen):
            if order is not None:
                order.ended(end)

    def discard_run(self) -> None:
        """Stop immediately without notification."""
        self._frozen = None
        self._cut_run()

    def ramp_down(self) -> None:
        """Decelerate with the parameters of the run (L1950-L1954); it ends as if its steps were complete."""
        frozen, self._frozen = self._frozen, None
        if frozen is not None:
            frozen.ended(RunEnd.DONE)
        run = self._run
        if run is None:
            return
        steps, rate = self._run_progress(run)
        ramp = stop_profile(steps, rate, run.order.start_rate, run.order.slope, run.profile.distance)
        if ramp is None:
            self.halt_run(RunEnd.DONE)
            return
        if run.motion.slowing_ns is None:
            run.motion.slowing_ns = self._time.clock.now_ns()
        run.profile, run.origin_ns = ramp, self._time.now_ns()
        self._schedule_event(run)

    # Inputs

    def push_axis(self, steps: int) -> None:
        """Move the axis at rest by hand; the counter does not count it."""
        if self._run is not None:
            raise ValueError("the motor keeps torque on the axis; push it at rest only")
        self._place += steps

    def set_stop_input(self, *, held: bool) -> None:
        """Set the Stop input: freeze; on its release restart the remaining steps from the start rate (decision 20)."""
        self.held = held
        if held:
            if (run := self._run) is not None:
                distance = run.profile.distance
                step_count = abs(self._steps_made())
                self._cut_run()
                self._frozen = replace(run.order, steps=distance - step_count)
        elif (frozen := self._frozen) is not None:
            self._frozen = None
            self.start_run(frozen)

    def is_limit_active(self, sign: int) -> bool:
        """Return whether the end-of-travel input of a direction is active."""
        if self._limits is not None:
            return self._limits in ("both", "forward" if sign > 0 else "reverse")
        if self._travel is None:
            return False
        return self.physical_steps >= self._travel[1] if sign > 0 else self.physical_steps <= self._travel[0]

    def set_limits(self, limits: LimitSwitch) -> None:
        """Set the active end-of-travel inputs, which then do not follow the travel."""
        self._limits = None if limits == "none" else limits
        if (run := self._run) is None:
            return
        if self.is_limit_active(run.order.sign):
            self.halt_run(RunEnd.SWITCH)
        else:
            self._schedule_event(run)
