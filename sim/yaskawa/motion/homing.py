"""Homing: HM in three stages, FE, FI (L5168-L5278, L5581-L5634, L14199)."""

from math import inf

from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.profile import SPEED_UNIT, VelocityProfile, first_sample, plan_jog, plan_stop
from sim.yaskawa.motion.services import MotionServices

EDGE_CODE, HOME_CODE, SEEK_CODE = 9, 10, -1


class HomingStages:
    """Drives axes in the modes `home`, `edge` and `index`."""

    def __init__(self, control: MotionServices, speed: int) -> None:
        self.control = control
        self.slow = speed * SPEED_UNIT
        """Speed of the second and third stage of HM, counts/sample."""
        self.polarity = -1
        """`CN` second field: +1 drives forward when the home input is high."""

    def start_homing(self, axis: ServoAxis, at: int) -> None:
        """`BG` after HM, FE or FI."""
        axis.mode = {"HM": "home", "FE": "edge", "FI": "index"}[axis.armed]
        axis.stage = 1
        axis.home_stage = 0
        axis.direction = self.search_direction(axis, at)
        axis.ending_code = EDGE_CODE if axis.mode == "edge" else HOME_CODE
        self.control.plan_profile(axis, at)

    def search_direction(self, axis: ServoAxis, at: int) -> int:
        """Return the direction in which HM and FE move from the present position."""
        return 1 if self._home_level(axis, axis.reference_at(at)) == (self.polarity > 0) else -1

    def plan_stage(self, axis: ServoAxis, profile: VelocityProfile, at: int) -> None:
        """Plan the profile of the present stage."""
        up, down = axis.acceleration_register("AC"), axis.acceleration_register("DC")
        if axis.mode == "index":
            plan_jog(profile, at, axis.speed_register("JG"), up, down)
        elif axis.stage == 1:
            plan_jog(profile, at, axis.direction * axis.speed_register("SP"), up, down)
        elif axis.stage == 2:
            plan_stop(profile, at, down)
        else:
            plan_jog(profile, at, self.slow if axis.stage == 4 else -axis.direction * self.slow, up, down)

    def find_stage_end(self, axis: ServoAxis, profile: VelocityProfile, at: int) -> tuple[float, int]:
        """Return when the present stage finds its target."""
        if axis.stopping or axis.mode not in ("home", "edge", "index"):
            return inf, SEEK_CODE
        if axis.mode == "index" or axis.stage == 4:
            return self._next_index(axis, profile, at), SEEK_CODE
        if axis.stage == 2:
            return inf, SEEK_CODE
        edge = self.control.environment.home_edge.get(axis.name)
        if edge is None or axis.name in self.control.environment.home:
            return inf, SEEK_CODE
        position = edge + axis.physical_zero
        low = not self._home_level(axis, axis.reference_at(at))
        return first_sample(profile, at, position if low else position - 1, upward=low), SEEK_CODE

    def input_changed(self, axis: ServoAxis, at: int) -> None:
        """Handle a change of the home input from outside."""
        if axis.is_moving and not axis.stopping and (axis.mode == "edge" or axis.stage in (1, 3)):
            self.handle_reached(axis, at)

    def handle_reached(self, axis: ServoAxis, at: int) -> None:
        """Handle the edge or the index, or the stop of the axis beyond the edge."""
        control, profile = self.control, axis.profile
        if profile is None:
            return
        if axis.mode == "edge":
            axis.stopping = True
            control.plan_profile(axis, at)
            return
        if axis.mode == "index" or axis.stage == 4:
            control.record.note_end(axis, at)
            code = axis.ending_code
            axis.define_position(at, 0)
            axis.stop_code = code
            axis.home_stage = 2
            return
        if axis.stage == control.figures.stepper_home_stages + 1 and axis.is_stepper:
            control.record.note_end(axis, at)
            axis.stand_at(at, axis.reference_at(at) - axis.gear.position(at))
            axis.stop_code = axis.ending_code
            return
        axis.stage += 1
        if axis.stage == 4:
            axis.stand_at(at, axis.reference_at(at) - axis.gear.position(at))
            axis.mode = "home"
            axis.home_stage = 1
        control.plan_profile(axis, at)

    def _home_level(self, axis: ServoAxis, counts: int) -> bool:
        return self.control.environment.home_level(axis.name, counts - axis.physical_zero)

    def _next_index(self, axis: ServoAxis, profile: VelocityProfile, at: int) -> float:
        every = self.control.environment.index_every.get(axis.name)
        if not every:
            return inf
        forward = axis.mode != "index" or axis.registers["JG"] > 0
        position = axis.reference_at(at) - axis.physical_zero
        turn = position // every + 1 if forward else -(-position // every) - 1
        return first_sample(profile, at, turn * every + axis.physical_zero, upward=forward)
