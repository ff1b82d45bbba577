"""Motion of one controller as its special modes use it: homing, sequences and cams."""

from collections.abc import Mapping
from typing import Protocol

from sim.yaskawa.base.timebase import ServoTimebase
from sim.yaskawa.base.world import PhysicalEnvironment
from sim.yaskawa.motion.axis import ServoAxis
from sim.yaskawa.motion.cam import ElectronicCam
from sim.yaskawa.motion.figures import MotionFigures
from sim.yaskawa.motion.limits import TravelLimits
from sim.yaskawa.motion.record import MotionRecord
from sim.yaskawa.motion.sequence import CoordinateSystem


class MotionServices(Protocol):
    """Axes and systems of one controller, profile planning, and the ground truth. Instants are samples."""

    @property
    def axes(self) -> Mapping[str, ServoAxis]: ...

    @property
    def systems(self) -> Mapping[str, CoordinateSystem]: ...

    @property
    def cam(self) -> ElectronicCam: ...

    @property
    def timebase(self) -> ServoTimebase: ...

    @property
    def environment(self) -> PhysicalEnvironment: ...

    @property
    def limits(self) -> TravelLimits: ...

    @property
    def record(self) -> MotionRecord: ...

    @property
    def figures(self) -> MotionFigures: ...

    def plan_profile(self, axis: ServoAxis, at: int) -> None:
        """Replan the profile from the state at `at` with the present registers."""
        ...

    def schedule_axis(self, axis: ServoAxis, at: int) -> None:
        """Find when the profile ends and when it reaches a limit."""
        ...
