"""Evaluation of polls: what has changed since the last reading, what is wrong, and what that ends."""

from adapters.contract import ControllerReading
from adapters.controller.components import Components
from adapters.controller.monitoring.pairs import PairWatch
from adapters.controller.state.armed_step import StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.stops import ControllerStops


class ReadingEvaluation:
    """Compares each reading of one controller with the last one, and reports what has changed."""

    def __init__(self, context: ControllerContext, parts: Components, stops: ControllerStops) -> None:
        self._context = context
        self._parts = parts
        self._stops = stops
        self._pairs = PairWatch(context.config)

    def handle_reading(self, reading: ControllerReading) -> None:
        """Compare a fresh reading with the last one, and report what has changed."""
        status = self._parts.status
        last_reading, status.reading = status.reading, reading
        status.may_move = False
        unreferenced_axes = self._parts.referencing.handle_reading(reading)
        unreferenced_axes += self._parts.surveillance.find_jumps(last_reading, reading)
        self._parts.surveillance.follow_play(reading)
        status.play.forget(unreferenced_axes)
        if reading.restarted:
            self._parts.publisher.emit_event("fault", "the controller was restarted; its axes are no longer referenced")
            self._parts.withdrawal.drop_step("the controller was restarted")
            self._parts.jogging.drop_all("the controller was restarted")
        if unreferenced_axes or reading.restarted:
            self._parts.tasks.spawn(self._parts.referencing.load_soft_limits(list(self._context.config.axes)))
        self._parts.jogging.handle_reading(reading)
        self._report_switches(last_reading, reading)
        self._report_faults(reading)
        failure = self._motion_failure(last_reading, reading)
        if failure is not None:
            self._parts.tasks.spawn(self._parts.withdrawal.fail_step(failure))
        self._stop_pairs(last_reading, reading)
        self._repeat_lost_stop(reading)

    def _report_switches(self, last_reading: ControllerReading | None, reading: ControllerReading) -> None:
        """Report limit switches that an axis has run into, and inputs that have changed."""
        for name, axis_reading in reading.axes.items():
            old = last_reading.axes[name].limit if last_reading is not None else "none"
            if axis_reading.limit not in ("none", old):
                self._parts.publisher.emit_event("limit", f"axis {name} is on its {axis_reading.limit} limit switch")
        for name, point in self._context.config.inputs.items():
            level = reading.inputs.get(point.number)
            if last_reading is not None and last_reading.inputs.get(point.number) != level:
                active = level == (point.active == "high")
                self._parts.publisher.emit_event("input", f"input {name} is {'active' if active else 'inactive'}")

    def _report_faults(self, reading: ControllerReading) -> None:
        """Report faults that are new, and the end of the last one."""
        status = self._parts.status
        faults = [*reading.faults, *self._parts.settling.find_following_errors(reading)]
        faults += self._pairs.find_deviations(reading)
        faults += [difference.to_fault() for difference in status.differences.values()]
        known_faults = {(fault.code, fault.axis) for fault in status.faults}
        for fault in faults:
            if (fault.code, fault.axis) not in known_faults:
                self._parts.publisher.emit_event("fault", fault.text, fault=fault)
        if status.faults and not faults:
            self._parts.publisher.emit_event("cleared", "all faults are cleared")
        status.faults = faults
        if faults and status.jogging:
            self._parts.tasks.spawn(self._parts.jogging.stop_axes(sorted(status.jogging), faults[0].text))

    def _stop_pairs(self, last_reading: ControllerReading | None, reading: ControllerReading) -> None:
        """Stop the controller because of an axis of two motors, unless its step is stopped already."""
        status, present = self._parts.status, self._parts.steps.present
        reason = self._pairs.explain_stop(last_reading, reading, status.faults)
        is_stopped = status.stop_unseen or (present is not None and present.phase is StepPhase.MOVING)
        if reason is not None and not is_stopped:
            self._parts.tasks.spawn(self._stops.stop(abort=False, reason=reason))

    def _repeat_lost_stop(self, reading: ControllerReading) -> None:
        """Repeat a stop without effect: a stop on a disturbed line may be lost. A controller that moves after the time
        of its stop, without a step, jog or homing, is stopped again."""
        status = self._parts.status
        if not status.stop_unseen or reading.at_ns < status.stopped_ns:
            return
        if not any(axis.moving for axis in reading.axes.values()):
            # A step that was loaded when the stop was lost begins in spite of it.
            status.stop_unseen = reading.at_ns < status.begun_by_ns
            return
        is_owned = self._parts.steps.present is not None or bool(status.moved_singly)
        if not is_owned and reading.at_ns > status.stopping_until_ns:
            self._context.log.warning(
                "the controller moves although it was stopped; the stop is sent again",
                controller=self._context.controller,
            )
            self._parts.tasks.spawn(
                self._stops.stop(abort=False, reason="repeated stop: the controller moved after an earlier one")
            )

    def _motion_failure(self, before: ControllerReading | None, reading: ControllerReading) -> str | None:
        """Return the reason why a step that moves, or is about to move, must be aborted after this poll, or None; a
        failure of one axis is a failure of the step."""
        armed_step = self._parts.steps.present
        moving_step = armed_step if armed_step is not None and armed_step.phase is StepPhase.MOVING else None
        outside_text = self._parts.surveillance.find_outside_motion(self._parts.steps.ordered_axes, reading)
        misplaced_text = self._parts.surveillance.find_misplaced_axes(reading)
        if moving_step is None or before is None:
            return misplaced_text
        if self._parts.status.faults:
            return self._parts.status.faults[0].text
        for name in moving_step.axes:
            axis_reading, old = reading.axes[name], before.axes[name]
            if axis_reading.position_lost and not old.position_lost:
                return f"axis {name} has lost its position"
            # The axis leaves a switch that was active at the start.
            if axis_reading.limit not in ("none", old.limit):
                return f"axis {name} has run into its {axis_reading.limit} limit switch"
            if old.enabled and not axis_reading.enabled:
                return f"the motor of axis {name} has switched off"
        return misplaced_text or outside_text
