"""All motion of one controller: starting, stopping, ending it at its exact samples, and its ground truth."""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.timebase import ServoTimebase
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.cam import ElectronicCam
from sim.yaskawa.motion.camming import CamFollowers
from sim.yaskawa.motion.codes import (
    ERROR_CODE,
    FORWARD_CODE,
    LATCH_CODE,
    LATCH_OVERRUN_CODE,
    REVERSE_CODE,
    STOP_CODE,
)
from sim.yaskawa.motion.contouring import ContourMode
from sim.yaskawa.motion.coordinated import CoordinatedMotion
from sim.yaskawa.motion.figures import MotionFigures
from sim.yaskawa.motion.homing import HomingStages
from sim.yaskawa.motion.independent import IndependentMotion
from sim.yaskawa.motion.limits import TravelLimits
from sim.yaskawa.motion.record import MotionRecord
from sim.yaskawa.motion.sequence import CoordinateSystem


@dataclass(frozen=True, slots=True)
class MotionAlerts:
    """Calls of the motion.

    limit_reached: a moving axis reaches a limit.
    error_exceeded: an amplifier switches off because of its position error (`OE`).
    """

    limit_reached: Callable[[], None]
    error_exceeded: Callable[[], None]


class MotionControl:
    """Axes, coordinate systems, contour and cam. Instants are samples; `now` is the present sample."""

    def __init__(
        self,
        timebase: ServoTimebase,
        environment: PhysicalEnvironment,
        letters: str,
        figures: MotionFigures,
        alerts: MotionAlerts,
    ) -> None:
        self.timebase = timebase
        self.figures = figures
        self.environment = environment
        self.alerts = alerts
        self.axes: dict[str, ServoAxis] = {
            name: ServoAxis(name, index, figures.lag) for index, name in enumerate(letters)
        }
        self.real = tuple(self.axes.values())
        if figures.virtual_axis:
            self.axes["N"] = ServoAxis("N", len(letters), figures.lag)
            self.axes["N"].motor_off, self.axes["N"].frozen = False, None
        self._all = tuple(self.axes.values())
        self.systems = {name: CoordinateSystem(name, figures.vector) for name in figures.systems}
        self.limits = TravelLimits(environment)
        self.record = MotionRecord(timebase, self.real, lambda: self.cam.master, environment.names)
        self.cam = ElectronicCam(figures.cam_points)
        self.homing = HomingStages(self, figures.home_speed)
        self.independent = IndependentMotion(self, self.homing)
        self.contouring = ContourMode(self)
        self.coordinated = CoordinatedMotion(self)
        self.camming = CamFollowers(self)
        self.abort_input = False

    # Active motion

    def find_axis(self, name: str) -> ServoAxis:
        """Return the axis of a letter; 4 when there is none."""
        axis = self.axes.get(name)
        if axis is None:
            raise CommandError(28 if name in ("S", "T") else 4)
        return axis

    def all_axes(self) -> tuple[ServoAxis, ...]:
        return self._all

    def is_active(self) -> bool:
        """Return whether any motion is commanded."""
        return any(axis.mode and axis.mode != "cam" for axis in self._all)

    def next_event(self) -> float:
        """Return the next sample with an event."""
        # Called at each command: usually nothing moves, and that case must be fast.
        due = inf
        at_rest = True
        for axis in self._all:
            if axis.end < due:
                due = axis.end
            if axis.watch < due:
                due = axis.watch
            if axis.mode or axis.gear.on:
                at_rest = False
        for system in self.systems.values():
            if system.running:
                due = min(due, system.end_sample())
        if self.contouring.running is not None:
            due = min(due, self.contouring.running.end)
        if not at_rest and self._needs_polling():
            due = min(due, self.timebase.current_sample() + 1)
        return due

    def _needs_polling(self) -> bool:
        """Return whether limits or cams have to be checked in every sample."""
        is_moving = is_geared = False
        for axis in self._all:
            is_geared = is_geared or axis.gear.on
            if not axis.mode or axis.mode == "cam":
                continue
            if self.cam.waiting:
                return True
            is_moving = True
            if axis.virtual:
                continue
            if axis.mode in ("sequence", "contour") and self.limits.is_bounded(axis):
                return True
            if axis.frozen is not None and axis.error_limit:
                return True
        return is_moving and is_geared and any(axis.gear.on and self.limits.is_bounded(axis) for axis in self.real)

    # Independent motion

    def plan_profile(self, axis: ServoAxis, at: int) -> None:
        """Replan the profile from the state at `at` with the present registers."""
        self.independent.plan_profile(axis, at)

    def schedule_axis(self, axis: ServoAxis, at: int) -> None:
        """Find when the profile ends and when it reaches a limit."""
        self.independent.schedule_axis(axis, at)

    # Stopping

    def stop_axis(self, axis: ServoAxis, at: int, code: int = STOP_CODE) -> None:
        """Decelerate an axis in any mode (L10124)."""
        if axis.mode == "sequence":
            self.coordinated.stop_sequence(axis, at, code)
            return
        if axis.gear.is_engaged and not axis.gear.gantry:
            if axis.only_follows and code in (FORWARD_CODE, REVERSE_CODE):
                axis.stop_code = code
            axis.registers["GR"] = 0
            self.set_gear_ratio(axis, 0.0, at)
        if axis.mode == "contour":
            self.contouring.stop_contour(at, code)
        elif axis.mode == "cam":
            self.camming.disengage_slave(axis, at)
        elif axis.is_moving and not axis.stopping:
            axis.stopping = True
            axis.ending_code = LATCH_OVERRUN_CODE if axis.ending_code == LATCH_CODE else code
            self.record.note_slowing(axis, at)
            self.plan_profile(axis, at)

    def freeze_motion(self, at: int, code: int, axes: tuple[ServoAxis, ...] | None = None) -> None:
        """Stop the profiler dead (L2191); sequences and the contour with it."""
        for axis in axes if axes is not None else self.all_axes():
            if not axis.is_moving and axis.mode != "cam" and not axis.gear.is_engaged:
                continue
            position_here = axis.path.position(at)
            if axis.mode == "sequence":
                self.coordinated.drop_member(axis.name, at)
            if axis.mode == "contour":
                self.contouring.running = None
            was_moving = axis.is_moving
            axis.stand_at(at, fixed.round_half_up(position_here))
            if was_moving:
                axis.stop_code = code
            self.record.note_slowing(axis, at)
            self.record.note_end(axis, at)
        for system in self.systems.values():
            if system.running and all(self.axes[name].mode != "sequence" for name in system.axes):
                self.coordinated.close_sequence(system)

    def check_limits(self, at: int) -> None:
        """Handle a change of a limit switch."""
        for axis in self.real:
            if (not axis.is_moving and not axis.only_follows) or axis.stopping:
                continue
            velocity = axis.command_velocity(at) or axis.command_velocity(at + 1)
            if velocity and self.limits.limit_active(axis, forward=velocity > 0, now=at):
                self.stop_axis(axis, at, FORWARD_CODE if velocity > 0 else REVERSE_CODE)
                self.alerts.limit_reached()
            elif axis.profile is not None and axis.watch > at:
                # A limit reached in this very sample is processed first: a search that starts after it would not find
                # it.
                self.schedule_axis(axis, at)

    # Events

    def settle_motion(self, now: int) -> bool:
        """Advance everything to sample `now`; return whether anything has changed."""
        has_changed = False
        for axis in self._all:
            while axis.watch <= now or axis.end <= now:
                has_changed = True
                if axis.watch < axis.end and axis.watch <= now:
                    self._handle_limit(axis, int(axis.watch))
                else:
                    self._finish_axis(axis, int(axis.end))
        for system in self.systems.values():
            if system.running and system.end_sample() <= now:
                has_changed = True
                self.coordinated.finish_sequence(system, int(system.end_sample()))
        while self.contouring.running is not None and self.contouring.running.end <= now:
            has_changed = True
            self.contouring.next_record(self.contouring.running, int(self.contouring.running.end))
        if self._needs_polling():
            has_changed = self._poll_limits(now) or has_changed
        return has_changed

    def _handle_limit(self, axis: ServoAxis, at: int) -> None:
        axis.watch = inf
        if axis.watch_code in (FORWARD_CODE, REVERSE_CODE):
            self.stop_axis(axis, at, axis.watch_code)
            self.alerts.limit_reached()
        else:
            self.homing.handle_reached(axis, at)

    def _finish_axis(self, axis: ServoAxis, at: int) -> None:
        profile = axis.profile
        if axis.mode == "home" and not axis.stopping and profile is not None:
            self.homing.handle_reached(axis, at)
            return
        axis.end = axis.watch = inf
        axis.mode, axis.stopping = "", False
        axis.stop_code = axis.ending_code
        if profile is not None:
            rounded_end = fixed.round_half_up(profile.end_position)
            if rounded_end != profile.end_position:
                profile.land_at(rounded_end)
        self.record.note_end(axis, at)

    def _poll_limits(self, now: int) -> bool:
        has_changed = False
        for axis in self.real:
            is_running = axis.mode in ("sequence", "contour", "move", "jog") and not axis.stopping
            if (is_running or axis.only_follows) and self.limits.is_bounded(axis):
                velocity = axis.command_velocity(now)
                if velocity and self.limits.is_blocked(axis, forward=velocity > 0, now=now):
                    self.stop_axis(axis, now, FORWARD_CODE if velocity > 0 else REVERSE_CODE)
                    self.alerts.limit_reached()
                    has_changed = True
            if axis.frozen is not None and axis.registers["OE"] and not axis.motor_off:
                limit = axis.error_limit
                if limit and abs(axis.position_error(now)) > limit:
                    self.switch_off_on_error(axis, now)
                    has_changed = True
        return self.camming.poll_waiting(now) or has_changed

    def switch_off_on_error(self, axis: ServoAxis, now: int) -> None:
        """`OE`: switch the amplifier off; the motion of the axis ends there (D47)."""
        self.freeze_motion(now, ERROR_CODE, (axis,))
        axis.stop_code = ERROR_CODE
        axis.off_on_error = True
        self.alerts.error_exceeded()
        self.switch_motor_off(axis, now)

    def switch_motor_off(self, axis: ServoAxis, now: int) -> None:
        axis.freeze_motor(now)
        axis.motor_off = True

    def switch_motor_on(self, axis: ServoAxis, now: int) -> None:
        """`SH`: command := actual, servo on (L9924)."""
        axis.motor_off = axis.off_on_error = False
        actual = axis.actual_at(now)
        if actual != axis.reference_at(now):
            axis.stand_at(now, actual - axis.gear.position(now))
        axis.thaw_motor()

    # Gearing

    def set_gear_ratio(self, axis: ServoAxis, ratio: float, at: int) -> None:
        """`GR`: takes effect at once; a slave of a moving master begins or ends its motion."""
        axis.gear.set_ratio(ratio, at)
        follows = any(axis in self.record.geared_followers(master) for master in self.all_axes() if master.is_moving)
        if follows:
            self.record.note_start(axis, at)
        elif axis.motion is not None and not axis.is_moving:
            self.record.note_end(axis, at)
