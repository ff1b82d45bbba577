"""Contour mode of the controller: entering, running, stopping and leaving it (L3439-L3489, L13907-L13970)."""

from math import inf

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.motion.codes import STOP_CODE
from sim.yaskawa.motion.contour import ContourMotion, ContourRecord
from sim.yaskawa.motion.profile import VelocityProfile, plan_stop
from sim.yaskawa.motion.services import MotionServices


class ContourMode:
    """The contour that the controller executes, if any."""

    def __init__(self, control: MotionServices) -> None:
        self._control = control
        self.running: ContourMotion | None = None
        self.interval = 0
        """`DT`."""
        self.is_late = False
        """A record ended before the next one was given."""

    def enter_contour(self, axes: tuple[str, ...], now: int) -> None:
        """`CM`."""
        for name in axes:
            if self._control.axes[name].is_moving and self._control.axes[name].mode != "contour":
                raise CommandError(7)
        if self.running is not None:
            if self.running.is_executing:
                raise CommandError(7)
            self.leave_contour(now)
        positions = tuple(self._control.axes[name].path.position(now) for name in axes)
        self.running = ContourMotion(axes, now, positions)

    def stop_contour(self, at: int, code: int) -> None:
        """Stop: at the end of the record, or by decelerating each axis."""
        if self.running is not None and code == STOP_CODE and self._control.figures.contour_stops_at_record:
            self.running.waiting = ContourRecord((0,) * len(self.running.axes), 0)
            if not self.running.is_executing:
                self.leave_contour(at)
            return
        contour, self.running = self.running, None
        if contour is None:
            return
        if contour.started is None:
            contour.begin_from(tuple(self._control.axes[name].path.position(at) for name in contour.axes))
        for index, name in enumerate(contour.axes):
            axis = self._control.axes[name]
            velocity = contour.velocity(index, at)
            profile = VelocityProfile(at, contour.position(index, at), 1.0, velocity)
            axis.profile = axis.path = profile
            axis.mode, axis.stopping, axis.ending_code = "move", True, code
            if axis.motion is None:
                self._control.record.note_start(axis, at)
            self._control.record.note_slowing(axis, at)
            plan_stop(profile, at, axis.acceleration_register("DC"))
            profile.land_at(fixed.round_half_up(profile.end_position))
            self._control.schedule_axis(axis, at)

    def next_record(self, contour: ContourMotion, at: int) -> None:
        """Execute the waiting record, at the end of the one before."""
        contour.end = inf
        record, contour.waiting = contour.waiting, None
        if record is None:
            self.is_late = True
        elif record.samples:
            contour.execute_record(record, at)
        else:
            self.leave_contour(at)

    def leave_contour(self, at: int, code: int = 51) -> None:
        """End contouring (D18)."""
        contour, self.running = self.running, None
        if contour is None:
            return
        if contour.started is None:
            return  # its axes stand where they stood
        for index, name in enumerate(contour.axes):
            axis = self._control.axes[name]
            has_moved = axis.mode == "contour"
            axis.stand_at(at, fixed.round_half_up(contour.position(index, at)))
            if has_moved:
                axis.stop_code = code
                last = contour.changed[index]
                self._control.record.note_end(axis, last if last is not None and last <= at else contour.started or at)
