"""Independent motion of single axes: moves, jogs, homing, and stops by a latch."""

from sim.yaskawa.base import fixed
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.codes import (
    FORWARD_CODE,
    LATCH_CODE,
    LATCH_SHORT_CODE,
    REVERSE_CODE,
)
from sim.yaskawa.motion.homing import HomingStages
from sim.yaskawa.motion.limits import NO_FORWARD
from sim.yaskawa.motion.profile import MoveSpeeds, VelocityProfile, first_sample, plan_jog, plan_move, plan_stop
from sim.yaskawa.motion.services import MotionServices


class IndependentMotion:
    """Plans the profiles of single axes. Instants are samples."""

    def __init__(self, control: MotionServices, homing: HomingStages) -> None:
        self._control = control
        self._homing = homing

    def begin_motion(self, axes: list[ServoAxis], at: int) -> None:
        """`BG` on axes that have been checked: start all at the same sample."""
        for axis in axes:
            self._start_axis(axis, at)

    def _start_axis(self, axis: ServoAxis, at: int) -> None:
        origin = axis.take_gear_share(at)
        axis.profile = VelocityProfile(at, origin, axis.registers["IT"] / fixed.ONE)
        axis.path = axis.profile
        axis.stopping, axis.ending_code, axis.stop_code = False, 1, 0
        axis.move_start = axis.reference_at(at)
        axis.mark = axis.command_at(at)
        if axis.armed in ("HM", "FE", "FI"):
            self._homing.start_homing(axis, at)
        elif axis.armed == "JG":
            axis.mode = "jog"
            self.plan_profile(axis, at)
        else:
            axis.mode = "move"
            step = fixed.to_integer(axis.registers["PR"])
            axis.target = origin + step if axis.armed == "PR" else fixed.to_integer(axis.registers["PA"])
            self.plan_profile(axis, at)
        self._control.record.note_start(axis, at)

    def plan_profile(self, axis: ServoAxis, at: int) -> None:
        """Replan the profile from the state at `at` with the present registers."""
        profile = axis.profile
        if profile is None or not axis.is_moving:
            return
        up, down = axis.acceleration_register("AC"), axis.acceleration_register("DC")
        if axis.stopping:
            plan_stop(profile, at, down)
        elif axis.mode == "move":
            plan_move(profile, at, axis.target, MoveSpeeds(axis.speed_register("SP"), up, down))
        elif axis.mode == "jog":
            plan_jog(profile, at, axis.speed_register("JG"), up, down)
        else:
            self._homing.plan_stage(axis, profile, at)
        self.schedule_axis(axis, at)

    def schedule_axis(self, axis: ServoAxis, at: int) -> None:
        """Find when the profile ends and when it reaches a limit."""
        profile = axis.profile
        if profile is None:
            return
        axis.end = profile.last_sample()
        axis.watch, axis.watch_code = self._homing.find_stage_end(axis, profile, at)
        if axis.virtual or axis.stopping:
            return
        forward = self._motion_direction(axis, at) > 0
        for threshold in self._control.limits.limit_thresholds(axis, forward=forward):
            sample = first_sample(profile, at, threshold - axis.gear.position(at), upward=forward)
            if sample < axis.watch:
                axis.watch, axis.watch_code = sample, FORWARD_CODE if forward else REVERSE_CODE

    def _motion_direction(self, axis: ServoAxis, at: int) -> int:
        if axis.mode == "move":
            return 1 if axis.target >= axis.path.position(at) else -1
        velocity = axis.path.velocity(at + 1)
        return 1 if velocity > 0 or (velocity == 0 and axis.registers["JG"] >= 0) else -1

    def capture_latch(self, axis: ServoAxis, instant: float) -> None:
        """Handle a latch input that has captured the position at an instant between samples (L413, L2541); LT stops the
        axis beyond it (L7138)."""
        axis.latch_armed, axis.latch_used = False, True
        axis.latched = axis.actual_between(instant)
        distance = fixed.to_integer(axis.registers["LT"])
        profile = axis.profile
        if distance in (0, NO_FORWARD) or profile is None or axis.mode not in ("move", "jog") or axis.stopping:
            return
        at = self._control.timebase.next_sample()
        rate, down = profile.velocity(at), axis.acceleration_register("DC")
        target = axis.latched + (abs(distance) if rate >= 0 else -abs(distance))
        if rate * rate / (2 * down) > abs(target - profile.position(at)):
            axis.stopping, axis.ending_code = True, LATCH_SHORT_CODE
            self.plan_profile(axis, at)
            return
        axis.mode, axis.target, axis.ending_code = "move", float(target), LATCH_CODE
        plan_move(profile, at, axis.target, MoveSpeeds(abs(rate), axis.acceleration_register("AC"), down))
        self.schedule_axis(axis, at)
