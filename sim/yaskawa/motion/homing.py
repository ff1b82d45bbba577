"""Homing: HM in three stages, FE, FI (L5168-L5278, L5581-L5634, L14199)."""

from math import inf
from typing import TYPE_CHECKING

from sim.yaskawa.motion.axis import Axis
from sim.yaskawa.motion.profile import SPEED_UNIT, Profile, first_sample, plan_jog, plan_stop

if TYPE_CHECKING:
    from sim.yaskawa.motion.control import MotionControl

EDGE_CODE, HOME_CODE, SEEK_CODE = 9, 10, -1


class Homing:
    """Drives axes in the modes `home`, `edge` and `index`."""

    def __init__(self, control: "MotionControl", speed: int) -> None:
        self.control = control
        self.slow = speed * SPEED_UNIT
        """Of the second and third stage of HM, counts/sample."""
        self.polarity = -1
        """`CN` second field: +1 drives forward when the home input is high."""

    def start(self, axis: Axis, at: int) -> None:
        """`BG` after HM, FE or FI."""
        axis.mode = {"HM": "home", "FE": "edge", "FI": "index"}[axis.armed]
        axis.stage = 1
        axis.home_stage = 0
        axis.direction = self.way(axis, at)
        axis.ending_code = EDGE_CODE if axis.mode == "edge" else HOME_CODE
        self.control.plan(axis, at)

    def way(self, axis: Axis, at: int) -> int:
        """In which direction HM and FE go from where the axis stands."""
        return 1 if self._level(axis, axis.reference(at)) == (self.polarity > 0) else -1

    def plan(self, axis: Axis, profile: Profile, at: int) -> None:
        """The profile of the present stage."""
        up, down = axis.acceleration("AC"), axis.acceleration("DC")
        if axis.mode == "index":
            plan_jog(profile, at, axis.speed("JG"), up, down)
        elif axis.stage == 1:
            plan_jog(profile, at, axis.direction * axis.speed("SP"), up, down)
        elif axis.stage == 2:
            plan_stop(profile, at, down)
        else:
            plan_jog(profile, at, self.slow if axis.stage == 4 else -axis.direction * self.slow, up, down)

    def watch(self, axis: Axis, profile: Profile, at: int) -> tuple[float, int]:
        """When the present stage finds what it looks for."""
        if axis.stopping or axis.mode not in ("home", "edge", "index"):
            return inf, SEEK_CODE
        if axis.mode == "index" or axis.stage == 4:
            return self._index(axis, profile, at), SEEK_CODE
        if axis.stage == 2:
            return inf, SEEK_CODE
        edge = self.control.world.home_edge.get(axis.name)
        if edge is None or axis.name in self.control.world.home:
            return inf, SEEK_CODE
        place = edge + axis.physical_zero
        low = not self._level(axis, axis.reference(at))
        return first_sample(profile, at, place if low else place - 1, low), SEEK_CODE

    def input_changed(self, axis: Axis, at: int) -> None:
        """The home input has been switched from outside."""
        if axis.moving and not axis.stopping and (axis.mode == "edge" or axis.stage in (1, 3)):
            self.reached(axis, at)

    def reached(self, axis: Axis, at: int) -> None:
        """The edge or the index has come, or the axis has stopped behind the edge."""
        control, profile = self.control, axis.profile
        if profile is None:
            return
        if axis.mode == "edge":
            axis.stopping = True
            control.plan(axis, at)
            return
        if axis.mode == "index" or axis.stage == 4:
            control.note_end(axis, at)
            code = axis.ending_code
            axis.define(at, 0)
            axis.stop_code = code
            axis.home_stage = 2
            return
        if axis.stage == control.figures.stepper_home_stages + 1 and axis.stepper:
            control.note_end(axis, at)
            axis.rest(at, axis.reference(at) - axis.gear.position(at))
            axis.stop_code = axis.ending_code
            return
        axis.stage += 1
        if axis.stage == 4:
            axis.rest(at, axis.reference(at) - axis.gear.position(at))
            axis.mode = "home"
            axis.home_stage = 1
        control.plan(axis, at)

    def _level(self, axis: Axis, counts: int) -> bool:
        return self.control.world.home_level(axis.name, counts - axis.physical_zero)

    def _index(self, axis: Axis, profile: Profile, at: int) -> float:
        every = self.control.world.index_every.get(axis.name)
        if not every:
            return inf
        forward = axis.mode != "index" or axis.registers["JG"] > 0
        place = axis.reference(at) - axis.physical_zero
        turn = place // every + 1 if forward else -(-place // every) - 1
        return first_sample(profile, at, turn * every + axis.physical_zero, forward)
