"""All motion of one controller: starting, stopping, ending it at its exact samples, and its ground truth."""

from collections.abc import Callable
from math import inf

from sim.core.controller import CommandedMotion, LimitSwitch
from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.model import MotionFigures
from sim.yaskawa.base.timebase import NEVER_NS, ServoTimebase
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.cam import ElectronicCam
from sim.yaskawa.motion.camming import CamFollowers
from sim.yaskawa.motion.contour import ContourMotion, ContourRecord
from sim.yaskawa.motion.coordinated import CoordinatedMotion
from sim.yaskawa.motion.homing import HomingStages
from sim.yaskawa.motion.profile import VelocityProfile, first_sample, plan_jog, plan_move, plan_stop
from sim.yaskawa.motion.sequence import CoordinateSystem

FORWARD_CODE, REVERSE_CODE, STOP_CODE, ABORT_INPUT_CODE, ABORT_CODE, ERROR_CODE = 2, 3, 4, 6, 7, 8
SELECTIVE_CODE = 11
"""Stopped by the selective abort of `CN` (L9860)."""
LATCH_CODE, LATCH_OVERRUN_CODE, LATCH_SHORT_CODE = 40, 41, 42
"""Stop code at the target of LT, stopped on the way to it, or too near to stop (L7151-L7159)."""
NO_FORWARD, NO_REVERSE = 2147483647, -2147483648


class MotionControl:
    """Axes, coordinate systems, contour and cam. Instants are samples; `now` is the present sample."""

    def __init__(
        self,
        timebase: ServoTimebase,
        environment: PhysicalEnvironment,
        letters: str,
        figures: MotionFigures,
        on_limit: Callable[[], None],
        on_error: Callable[[], None],
    ) -> None:
        self.timebase = timebase
        self.figures = figures
        self.environment = environment
        self.on_limit = on_limit
        self.on_error = on_error
        self.axes: dict[str, ServoAxis] = {
            name: ServoAxis(name, index, figures.lag) for index, name in enumerate(letters)
        }
        self.real = tuple(self.axes.values())
        if figures.virtual_axis:
            self.axes["N"] = ServoAxis("N", len(letters), figures.lag)
            self.axes["N"].motor_off, self.axes["N"].frozen = False, None
        self._all = tuple(self.axes.values())
        self.systems = {name: CoordinateSystem(name, figures.vector) for name in figures.systems}
        self.contour: ContourMotion | None = None
        self.contour_interval = 0
        self.contour_late = False
        self.cam = ElectronicCam(figures.cam_points)
        self.motions: list[CommandedMotion] = []
        self.homing = HomingStages(self, figures.home_speed)
        self.coordinated = CoordinatedMotion(self)
        self.camming = CamFollowers(self)
        self.abort_input = False

    # Active motion

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
        if self.contour is not None:
            due = min(due, self.contour.end)
        if not at_rest and self._needs_polling():
            due = min(due, self.timebase.current_sample() + 1)
        return due

    def _needs_polling(self) -> bool:
        """Return whether limits or cams have to be checked in every sample."""
        moving = geared = False
        for axis in self._all:
            geared = geared or axis.gear.on
            if not axis.mode or axis.mode == "cam":
                continue
            if self.cam.waiting:
                return True
            moving = True
            if axis.virtual:
                continue
            if axis.mode in ("sequence", "contour") and self._is_bounded(axis):
                return True
            if axis.frozen is not None and self._error_limit(axis):
                return True
        return moving and geared and any(axis.gear.on and self._is_bounded(axis) for axis in self.real)

    def _is_bounded(self, axis: ServoAxis) -> bool:
        return (
            axis.registers["FL"] != fixed.from_integer(NO_FORWARD)
            or axis.registers["BL"] != fixed.from_integer(NO_REVERSE)
            or axis.name in self.environment.travel
            or self.environment.limits.get(axis.name, "none") != "none"
        )

    def _error_limit(self, axis: ServoAxis) -> int:
        return fixed.to_integer(axis.registers["ER"])

    # Independent motion

    def begin_motion(self, axes: list[ServoAxis], at: int) -> None:
        """`BG` on axes that have been checked: start all at the same sample."""
        for axis in axes:
            self._start_axis(axis, at)

    def _start_axis(self, axis: ServoAxis, at: int) -> None:
        origin = axis.path.position(at)
        axis.profile = VelocityProfile(at, origin, axis.registers["IT"] / fixed.ONE)
        axis.path = axis.profile
        axis.stopping, axis.ending_code, axis.stop_code = False, 1, 0
        axis.move_start = axis.reference_at(at)
        axis.mark = axis.command_at(at)
        if axis.armed in ("HM", "FE", "FI"):
            self.homing.start_homing(axis, at)
        elif axis.armed == "JG":
            axis.mode = "jog"
            self.plan_profile(axis, at)
        else:
            axis.mode = "move"
            step = fixed.to_integer(axis.registers["PR"])
            axis.target = origin + step if axis.armed == "PR" else fixed.to_integer(axis.registers["PA"])
            self.plan_profile(axis, at)
        self.note_start(axis, at)

    def plan_profile(self, axis: ServoAxis, at: int) -> None:
        """Replan the profile from the state at `at` with the present registers."""
        profile = axis.profile
        if profile is None or not axis.is_moving:
            return
        up, down = axis.acceleration_register("AC"), axis.acceleration_register("DC")
        if axis.stopping:
            plan_stop(profile, at, down)
        elif axis.mode == "move":
            plan_move(profile, at, axis.target, axis.speed_register("SP"), up, down)
        elif axis.mode == "jog":
            plan_jog(profile, at, axis.speed_register("JG"), up, down)
        else:
            self.homing.plan_stage(axis, profile, at)
        self.schedule_axis(axis, at)

    def schedule_axis(self, axis: ServoAxis, at: int) -> None:
        """Find when the profile ends and when it reaches a limit."""
        profile = axis.profile
        if profile is None:
            return
        axis.end = profile.last_sample()
        axis.watch, axis.watch_code = self.homing.find_stage_end(axis, profile, at)
        if axis.virtual or axis.stopping:
            return
        forward = self._motion_direction(axis, at) > 0
        for threshold in self._limit_thresholds(axis, forward):
            sample = first_sample(profile, at, threshold - axis.gear.position(at), forward)
            if sample < axis.watch:
                axis.watch, axis.watch_code = sample, FORWARD_CODE if forward else REVERSE_CODE

    def _motion_direction(self, axis: ServoAxis, at: int) -> int:
        if axis.mode == "move":
            return 1 if axis.target >= axis.path.position(at) else -1
        velocity = axis.path.velocity(at + 1)
        return 1 if velocity > 0 or (velocity == 0 and axis.registers["JG"] >= 0) else -1

    def _limit_thresholds(self, axis: ServoAxis, forward: bool) -> list[int]:
        limit = fixed.to_integer(axis.registers["FL" if forward else "BL"])
        found = [limit + 1 if forward else limit - 1] if limit != (NO_FORWARD if forward else NO_REVERSE) else []
        travel = self.environment.travel.get(axis.name)
        if travel is not None and axis.name not in self.environment.limits:
            found.append(travel[1 if forward else 0] + axis.physical_zero)
        return found

    def limit_active(self, axis: ServoAxis, forward: bool, now: int) -> bool:
        """Return whether the limit switch is pressed."""
        if axis.virtual:
            return False
        pressed: LimitSwitch | None = self.environment.limits.get(axis.name)
        if pressed is not None:
            return pressed in ("both", "forward" if forward else "reverse")
        travel = self.environment.travel.get(axis.name)
        if travel is None:
            return False
        place = axis.physical_at(now + 1)
        return place >= travel[1] if forward else place <= travel[0]

    def is_blocked(self, axis: ServoAxis, forward: bool, now: int) -> bool:
        """Return whether a limit switch or a software limit forbids motion in that direction."""
        place = axis.reference_at(now)
        limit = fixed.to_integer(axis.registers["FL" if forward else "BL"])
        return self.limit_active(axis, forward, now) or (place > limit if forward else place < limit)

    # Stopping

    def stop_axis(self, axis: ServoAxis, at: int, code: int = STOP_CODE) -> None:
        """Decelerate an axis in any mode (L10124)."""
        if axis.mode == "sequence":
            self.coordinated.stop_sequence(axis, at, code)
            return
        if axis.gear.is_engaged and not axis.gear.gantry:
            if self._only_follows(axis) and code in (FORWARD_CODE, REVERSE_CODE):
                axis.stop_code = code
            axis.registers["GR"] = 0
            self.set_gear_ratio(axis, 0.0, at)
        if axis.mode == "contour":
            self._stop_contour(at, code)
        elif axis.mode == "cam":
            self.camming.disengage_slave(axis, at)
        elif axis.is_moving and not axis.stopping:
            axis.stopping = True
            axis.ending_code = LATCH_OVERRUN_CODE if axis.ending_code == LATCH_CODE else code
            self._note_slowing(axis, at)
            self.plan_profile(axis, at)

    def _only_follows(self, axis: ServoAxis) -> bool:
        """Return whether it is moved by gearing alone, which a limit ends (L5543)."""
        return axis.gear.is_engaged and not axis.gear.gantry and not axis.is_moving

    def _stop_contour(self, at: int, code: int) -> None:
        if self.contour is not None and code == STOP_CODE and self.figures.contour_stops_at_record:
            self.contour.waiting = ContourRecord((0,) * len(self.contour.axes), 0)
            if not self.contour.is_executing:
                self.leave_contour(at)
            return
        contour, self.contour = self.contour, None
        if contour is None:
            return
        for index, name in enumerate(contour.axes):
            axis = self.axes[name]
            velocity = contour.velocity(index, at)
            profile = VelocityProfile(at, contour.position(index, at), 1.0, velocity)
            axis.profile = axis.path = profile
            axis.mode, axis.stopping, axis.ending_code = "move", True, code
            if axis.motion is None:
                self.note_start(axis, at)
            self._note_slowing(axis, at)
            plan_stop(profile, at, axis.acceleration_register("DC"))
            profile.land_at(fixed.round_half_up(profile.end_position))
            self.schedule_axis(axis, at)

    def freeze_motion(self, at: int, code: int, axes: tuple[ServoAxis, ...] | None = None) -> None:
        """Stop the profiler dead (L2191); sequences and the contour with it."""
        for axis in axes if axes is not None else self.all_axes():
            if not axis.is_moving and axis.mode != "cam" and not axis.gear.is_engaged:
                continue
            here = axis.path.position(at)
            if axis.mode == "sequence":
                self.coordinated.drop_member(axis.name, at)
            if axis.mode == "contour":
                self.contour = None
            was_moving = axis.is_moving
            axis.stand_at(at, fixed.round_half_up(here))
            if was_moving:
                axis.stop_code = code
            self._note_slowing(axis, at)
            self.note_end(axis, at)
        for system in self.systems.values():
            if system.running and all(self.axes[name].mode != "sequence" for name in system.axes):
                self.coordinated.close_sequence(system)

    def check_limits(self, at: int) -> None:
        """Handle a change of a limit switch."""
        for axis in self.real:
            if (not axis.is_moving and not self._only_follows(axis)) or axis.stopping:
                continue
            velocity = axis.command_velocity(at) or axis.command_velocity(at + 1)
            if velocity and self.limit_active(axis, velocity > 0, at):
                self.stop_axis(axis, at, FORWARD_CODE if velocity > 0 else REVERSE_CODE)
                self.on_limit()
            elif axis.profile is not None and axis.watch > at:
                # A limit reached in this very sample is processed first: a search that starts after it would not find
                # it.
                self.schedule_axis(axis, at)

    def capture_latch(self, axis: ServoAxis, now: int) -> None:
        """Handle a latch input that has captured the position (L2541); LT stops the axis beyond it (L7138)."""
        axis.latch_armed, axis.latch_used = False, True
        axis.latched = axis.actual_at(now)
        distance = fixed.to_integer(axis.registers["LT"])
        profile = axis.profile
        if distance in (0, NO_FORWARD) or profile is None or axis.mode not in ("move", "jog") or axis.stopping:
            return
        at = self.timebase.next_sample()
        rate, down = profile.velocity(at), axis.acceleration_register("DC")
        target = axis.latched + (abs(distance) if rate >= 0 else -abs(distance))
        if rate * rate / (2 * down) > abs(target - profile.position(at)):
            axis.stopping, axis.ending_code = True, LATCH_SHORT_CODE
            self.plan_profile(axis, at)
            return
        axis.mode, axis.target, axis.ending_code = "move", float(target), LATCH_CODE
        plan_move(profile, at, axis.target, abs(rate), axis.acceleration_register("AC"), down)
        self.schedule_axis(axis, at)

    # Events

    def settle_motion(self, now: int) -> bool:
        """Advance everything to sample `now`; return whether anything has changed."""
        changed = False
        for axis in self._all:
            while axis.watch <= now or axis.end <= now:
                changed = True
                if axis.watch < axis.end and axis.watch <= now:
                    self._handle_limit(axis, int(axis.watch))
                else:
                    self._finish_axis(axis, int(axis.end))
        for system in self.systems.values():
            if system.running and system.end_sample() <= now:
                changed = True
                self.coordinated.finish_sequence(system, int(system.end_sample()))
        while self.contour is not None and self.contour.end <= now:
            changed = True
            self._next_record(self.contour, int(self.contour.end))
        if self._needs_polling():
            changed = self._poll_limits(now) or changed
        return changed

    def _handle_limit(self, axis: ServoAxis, at: int) -> None:
        axis.watch = inf
        if axis.watch_code in (FORWARD_CODE, REVERSE_CODE):
            self.stop_axis(axis, at, axis.watch_code)
            self.on_limit()
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
            whole = fixed.round_half_up(profile.end_position)
            if whole != profile.end_position:
                profile.land_at(whole)
        self.note_end(axis, at)

    def _next_record(self, contour: ContourMotion, at: int) -> None:
        contour.end = inf
        record, contour.waiting = contour.waiting, None
        if record is None:
            self.contour_late = True
        elif record.samples:
            contour.execute_record(record, at)
        else:
            self.leave_contour(at)

    def leave_contour(self, at: int, code: int = 51) -> None:
        """End contouring (D18)."""
        contour, self.contour = self.contour, None
        if contour is None:
            return
        for index, name in enumerate(contour.axes):
            axis = self.axes[name]
            moved = axis.mode == "contour"
            axis.stand_at(at, fixed.round_half_up(contour.position(index, at)))
            if moved:
                axis.stop_code = code
                last = contour.changed[index]
                self.note_end(axis, last if last is not None and last <= at else contour.started or at)

    def _poll_limits(self, now: int) -> bool:
        changed = False
        for axis in self.real:
            running = axis.mode in ("sequence", "contour", "move", "jog") and not axis.stopping
            if (running or self._only_follows(axis)) and self._is_bounded(axis):
                velocity = axis.command_velocity(now)
                if velocity and self.is_blocked(axis, velocity > 0, now):
                    self.stop_axis(axis, now, FORWARD_CODE if velocity > 0 else REVERSE_CODE)
                    self.on_limit()
                    changed = True
            if axis.frozen is not None and axis.registers["OE"] and not axis.motor_off:
                limit = self._error_limit(axis)
                if limit and abs(axis.position_error(now)) > limit:
                    self.switch_off_on_error(axis, now)
                    changed = True
        return self.camming.poll_waiting(now) or changed

    def switch_off_on_error(self, axis: ServoAxis, now: int) -> None:
        """`OE`: switch the amplifier off; the motion of the axis ends there (D47)."""
        self.freeze_motion(now, ERROR_CODE, (axis,))
        axis.stop_code = ERROR_CODE
        axis.off_on_error = True
        self.on_error()
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

    # Contour

    def enter_contour(self, axes: tuple[str, ...], now: int) -> None:
        """`CM`."""
        for name in axes:
            if self.axes[name].is_moving and self.axes[name].mode != "contour":
                raise CommandError(7)
        if self.contour is not None:
            if self.contour.is_executing:
                raise CommandError(7)
            self.leave_contour(now)
        positions = tuple(self.axes[name].path.position(now) for name in axes)
        self.contour = ContourMotion(axes, now, positions)

    # Gearing

    def set_gear_ratio(self, axis: ServoAxis, ratio: float, at: int) -> None:
        """`GR`: takes effect at once; a slave of a moving master begins or ends its motion."""
        axis.gear.set_ratio(ratio, at)
        follows = any(axis in self._geared_followers(master) for master in self.all_axes() if master.is_moving)
        if follows:
            self.note_start(axis, at)
        elif axis.motion is not None and not axis.is_moving:
            self.note_end(axis, at)

    # Ground truth

    def note_start(self, axis: ServoAxis, at: int) -> None:
        """Record the start of a commanded motion, of the axis and of its geared followers."""
        for follower in (axis, *self._geared_followers(axis)):
            if follower.motion is None:
                start_ns = self.timebase.true_ns(at)
                follower.motion = CommandedMotion(follower.name, start_ns, follower.command_at(at))
                self.motions.append(follower.motion)

    def resume_samples(self) -> None:
        """Restart the motions that began without a sample clock at its next sample."""
        for axis in self.real:
            if axis.motion is not None and axis.motion.start_ns == NEVER_NS:
                axis.motion.start_ns = self.timebase.true_ns(self.timebase.current_sample() + 1)

    def _note_slowing(self, axis: ServoAxis, at: int) -> None:
        """Record that a stop takes effect at sample `at`."""
        if axis.motion is not None and axis.motion.slowing_ns is None:
            axis.motion.slowing_ns = self.timebase.true_ns(at)

    def note_end(self, axis: ServoAxis, at: int) -> None:
        """Record the last commanded change at sample `at`."""
        for follower in (axis, *self._geared_followers(axis)):
            motion = follower.motion
            if motion is not None and (follower is axis or not follower.is_moving):
                motion.end_ns = self.timebase.true_ns(at)
                motion.end_counts = follower.command_at(at)
                follower.motion = None

    def _geared_followers(self, master: ServoAxis) -> list[ServoAxis]:
        return [
            axis
            for axis in self.real
            if axis is not master
            and (
                (axis.gear.is_engaged and axis.gear.source.removeprefix("C") == master.name)
                or (axis.mode == "cam" and self.cam.master == master.name)
            )
        ]
