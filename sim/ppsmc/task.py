"""Activity of one axis: a sequence of motions and pauses, written as a generator."""

from collections.abc import Callable

from orchestrator.clock.base import ClockTimer
from sim.ppsmc.axis import LIMIT_ERROR, StepperAxis
from sim.ppsmc.drive import PulseGenerator
from sim.ppsmc.legs import MotionEnd, MotionLeg, PauseStep, Steps, TaskKind
from sim.ppsmc.sensors import limit_switch


class AxisTask:
    """Runs the steps of one axis; `finished` receives whether they completed by themselves."""

    def __init__(
        self,
        drive: PulseGenerator,
        axis: StepperAxis,
        kind: TaskKind,
        steps: Steps,
        finished: Callable[["AxisTask", bool], None],
    ) -> None:
        self.axis = axis
        self.kind = kind
        self.leg: MotionLeg | None = None
        self._drive = drive
        self._steps = steps
        self._finished = finished
        self._timer: ClockTimer | None = None

    def begin_task(self) -> None:
        """Make the first step; it can end at once."""
        self.axis.task = self
        self._next_step(None)

    def stop_task(self) -> None:
        """Stop as by q: decelerate, and discard the rest."""
        if self.axis.run is not None:
            self._drive.quit_run(self.axis.run)
        else:
            self._finish_task(by_itself=False)

    def abort_task(self) -> None:
        """Stop dead without notification."""
        if self._timer is not None:
            self._timer.cancel()
        if self.axis.run is not None:
            self._drive.halt_run(self.axis.run)
        self._steps.close()
        self.axis.task = None

    def _next_step(self, end: MotionEnd | None) -> None:
        self._timer = None
        while True:
            try:
                step = next(self._steps) if end is None else self._steps.send(end)
            except StopIteration:
                self._finish_task(by_itself=True)
                return
            if isinstance(step, PauseStep):
                self.leg = None
                self._timer = self._drive.time.call_after(step.duration_ns, lambda: self._next_step(MotionEnd.DONE))
                return
            self.leg = step
            sign = step.path.start_sign
            if sign == 0:
                end = MotionEnd.DONE
            elif self._is_blocked(sign):
                if not step.seeks_limit:
                    self.axis.error = LIMIT_ERROR
                    self._finish_task(by_itself=False)
                    return
                end = MotionEnd.LIMIT
            else:
                self._drive.start_run(self.axis, step, self._handle_run_end)
                return

    def _is_blocked(self, sign: int) -> bool:
        """Return whether the limit in this direction is active: an axis never moves towards it (L2996)."""
        axis = self.axis
        return axis.switches.is_on(limit_switch(sign), axis.steps - axis.origin)

    def _handle_run_end(self, end: MotionEnd) -> None:
        leg = self.leg
        if end is MotionEnd.STOPPED:
            self._finish_task(by_itself=False)
        elif end is MotionEnd.LIMIT and leg is not None and not leg.seeks_limit:
            self.axis.error = LIMIT_ERROR
            if self._drive.limit_clears_reference:
                self.axis.referenced = False
            self._finish_task(by_itself=False)
        else:
            self._next_step(end)

    def _finish_task(self, *, by_itself: bool) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        self._steps.close()
        self.axis.task = None
        self._finished(self, by_itself)
