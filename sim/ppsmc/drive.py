"""Pulse generators: running paths, in closed form between events, and the ground truth of their motion."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_S
from sim.core.controller import CommandedMotion
from sim.core.devicetime import DeviceTime
from sim.ppsmc.axis import Ended, MotionRun, StepperAxis
from sim.ppsmc.legs import MotionEnd, MotionLeg
from sim.ppsmc.path import SpeedProfile, StepPath, deceleration_path, speed_change_path
from sim.ppsmc.sensors import UntilSwitch, limit_switch


@dataclass(slots=True)
class PulseGenerator:
    """Moves axes along paths, until the end, a stop, or a switch."""

    time: DeviceTime
    limit_clears_reference: bool = False
    """A limit switch that stops a motion clears the reference of its axis."""
    motions: list[CommandedMotion] = field(default_factory=list[CommandedMotion])

    def start_run(self, axis: StepperAxis, leg: MotionLeg, ended: Ended) -> None:
        """Run `leg` from the axis's counter, now or at its device time, slightly ahead."""
        now_ns = self.time.now_ns()
        start_ns = now_ns if leg.at_ns is None else max(now_ns, leg.at_ns)
        true_ns = self.time.clock.now_ns() if start_ns == now_ns else self.time.true_ns(start_ns)
        motion = CommandedMotion(axis.name, true_ns, self.to_coordinate(axis, axis.steps))
        run = MotionRun(
            axis=axis,
            path=leg.path,
            profile=leg.profile,
            start_ns=start_ns,
            base=axis.steps,
            until=leg.until,
            ended=ended,
            motion=motion,
            soft=leg.soft,
        )
        axis.run = run
        self.motions.append(motion)
        self.arm_run(run)

    def quit_run(self, run: MotionRun) -> None:
        """Decelerate to the start-stop speed and stop (L2546)."""
        run.quit = True
        run.motion.slowing_ns = self.time.clock.now_ns()
        self._decelerate_run(run)

    def change_speed(self, run: MotionRun, sign: int, profile: SpeedProfile) -> None:
        """Change to another endless speed."""
        run.profile = profile
        self._replace_path(run, lambda x, v: speed_change_path(x, v, sign, profile))

    def halt_run(self, run: MotionRun) -> None:
        """Stop dead at the present position without notification: the power is off, or the controller is reset."""
        self._settle_axis(run, None)

    def arm_run(self, run: MotionRun) -> None:
        """Schedule the earliest end of the motion, from the present state of switches and path."""
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        seconds = max(0.0, run.path_seconds(self.time.now_ns()))
        reason = MotionEnd.STOPPED if run.stopping else MotionEnd.DONE
        due, bound = run.path.duration, None
        for sign in (1, -1):
            for until_switch, end in (
                (UntilSwitch(limit_switch(sign), on=True), MotionEnd.LIMIT),
                (run.until, MotionEnd.SWITCH),
            ):
                switch = None if until_switch is None else self._find_switch(run, until_switch, sign, seconds)
                if switch is not None and switch[0] < due:
                    (due, bound), reason = switch, end
        if math.isinf(due):
            return
        at_ns = run.start_ns + math.ceil(due * NS_PER_S - 1e-3)
        if due <= seconds and at_ns <= self.time.now_ns():
            self._finish_run(run, reason, bound)
        else:
            run.timer = self.time.call_at(at_ns, lambda: self._finish_run(run, reason, bound))

    def _find_switch(
        self, run: MotionRun, until: UntilSwitch, sign: int, after: float
    ) -> tuple[float, float | None] | None:
        """Return when `until` first holds while moving in direction `sign`, and the displacement there (None:
        present position)."""
        axis = run.axis
        toward = run.path.first_at(-sign * math.inf, sign, after)
        if toward is None:
            return None
        position = run.base + run.path.state_at(toward)[0] - axis.origin
        if axis.switches.is_on(until.switch, round(position)) == until.on:
            return toward, None
        bound = axis.switches.find_bound(until, position, sign)
        if bound is None:
            return None
        displacement = bound + axis.origin - run.base
        at = run.path.first_at(displacement, sign, after)
        return None if at is None else (at, displacement)

    def _decelerate_run(self, run: MotionRun) -> None:
        if not run.stopping:
            run.stopping = True
            self._replace_path(run, lambda x, v: deceleration_path(x, v, run.profile))

    def _replace_path(self, run: MotionRun, successor: Callable[[float, float], StepPath]) -> None:
        now_ns = self.time.now_ns()
        x, v = run.path.state_at(run.path_seconds(now_ns))
        run.start_ns = now_ns
        run.path = successor(x, v)
        self.arm_run(run)

    def _finish_run(self, run: MotionRun, reason: MotionEnd, bound: float | None) -> None:
        if reason is MotionEnd.SWITCH and run.soft and not run.stopping:
            run.found = True
            run.until = None
            self._decelerate_run(run)
            return
        end = run.path.end if reason in (MotionEnd.DONE, MotionEnd.STOPPED) else bound
        self._settle_axis(run, end)
        run.ended(MotionEnd.SWITCH if run.found and reason is MotionEnd.STOPPED and not run.quit else reason)

    def _settle_axis(self, run: MotionRun, displacement: float | None) -> None:
        if run.timer is not None:
            run.timer.cancel()
            run.timer = None
        axis = run.axis
        if displacement is None:
            displacement = run.path.state_at(run.path_seconds(self.time.now_ns()))[0]
        axis.steps = run.base + round(displacement)
        axis.run = None
        # A halt can precede a skewed start.
        run.motion.end_ns = max(run.motion.start_ns, self.time.clock.now_ns())
        run.motion.end_counts = self.to_coordinate(axis, axis.steps)

    # Positions of the axes

    def exact_state(self, axis: StepperAxis) -> tuple[float, float]:
        """Return step counter, not rounded, and velocity (steps per device second), now."""
        run = axis.run
        if run is None:
            return float(axis.steps), 0.0
        x, v = run.path.state_at(run.path_seconds(self.time.now_ns()))
        return run.base + x, v

    def step_counter(self, axis: StepperAxis) -> int:
        """Return the step counter now."""
        return round(self.exact_state(axis)[0])

    @staticmethod
    def to_coordinate(axis: StepperAxis, steps: float) -> float:
        """Convert `steps` to the axis's unit."""
        settings = axis.settings
        return (
            steps
            * settings.gden.numerator
            * settings.gnum.denominator
            / (settings.gden.denominator * settings.gnum.numerator)
        )
