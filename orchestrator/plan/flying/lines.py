"""The lines of a scan that flies, straight or curved: what is alike in both."""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.steps.fly import FlyTrigger, WindowPlace
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.points import ScanAxis
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.triggers import Trigger
from orchestrator.model.units import Unit
from orchestrator.plan.path_profiles import Array, FittedMotion
from orchestrator.plan.shape import WayEnd, WayLimits


@dataclass(frozen=True, slots=True)
class FlownLines(ABC):
    """The lines of a scan that flies, all alike but for their direction. User positions, in the unit of the axes that
    fly, which are the last ones of the scan.

    units: of all axes of the scan. counts_per_unit: of those that fly. count: of the points of a line. tolerance: of
    its path. run_up_s: how long the axes take for their speed at most, the same for coming to rest.
    """

    scan: Scan
    units: Sequence[Unit]
    counts_per_unit: Sequence[Fraction]
    count: int
    tolerance: float
    run_up_s: float

    @property
    @abstractmethod
    def window_s(self) -> float:
        """The time in the window of a point, s."""

    @property
    @abstractmethod
    def slowest(self) -> float:
        """The lowest speed of all axes together in the windows, per s."""

    @property
    @abstractmethod
    def lead(self) -> str:
        """The axis that passes the most counts in the windows, by which places on a line are known best."""

    @property
    @abstractmethod
    def turn_speeds(self) -> Sequence[float]:
        """By axis that flies, the speed that it needs between lines at least, per s: at which they begin and end."""

    @property
    @abstractmethod
    def rooms(self) -> Sequence[float] | None:
        """By axis that flies, how far it goes at most beyond its windows between lines; None: as far as it takes."""

    @abstractmethod
    def describe(self) -> str:
        """How the lines are flown, in words."""

    @abstractmethod
    def find_begin(self, point: int) -> tuple[float, ...]:
        """Where the axes that fly rest, so that they have their speed from the window of a point on."""

    @abstractmethod
    def find_end(self, point: int) -> tuple[float, ...]:
        """Where they come to rest behind the line of a point."""

    @abstractmethod
    def find_states(self, point: int, part: int) -> list[WayEnd]:
        """Where the axes that fly are, and how fast, at the beginning of the window of a point, part 0, or at its end,
        part 1."""

    @abstractmethod
    def make_windows(self, point: int, count: int) -> FittedMotion:
        """The motion of the axes that fly through the windows of so many points of one line."""

    @abstractmethod
    def list_top_speeds(self, point: int, count: int) -> Array:
        """The highest speed of each axis that flies in each of so many windows of one line, shape (windows, axes)."""

    @abstractmethod
    def share_out(self, limits: Sequence[WayLimits]) -> Sequence[WayLimits]:
        """The limits of the axes that fly with which they take up their speed and come to rest. limits: their own."""

    @abstractmethod
    def list_positions(self, point: int, place: WindowPlace = "middle") -> Sequence[Fraction]:
        """Where the axis that leads is at a place in each window of the line of a point, in the order in which they are
        flown."""

    @abstractmethod
    def make_path(self, point: int) -> FollowPath:
        """The path of the line of a point, from rest to rest. Raises `Refusal` for a curve, which is flown in one
        motion with its run-up only."""

    @abstractmethod
    def list_reach(self) -> Sequence[Sequence[float]]:
        """By axis that flies, where a line that goes forward begins, and where it ends."""

    @property
    def words(self) -> str:
        """The axes that fly: `gantry.x and gantry.y`."""
        return " and ".join(self.scan.flown_axes)

    @property
    def trigger(self) -> FlyTrigger | None:
        """What is switched in each window."""
        return None if self.scan.fly is None else self.scan.fly.trigger

    @property
    def trigger_place(self) -> WindowPlace:
        """Where in each window that is."""
        return "middle" if self.trigger is None else "start" if self.trigger.gate else self.trigger.at

    @property
    def pulse_ns(self) -> int | None:
        """How long the output is active each time; None: as long as one is without more."""
        if self.trigger is None or not self.trigger.gate:
            return None if self.trigger is None else self.trigger.pulse
        detector = None if self.scan.fly is None else self.scan.fly.detector
        return round(self.window_s * NS_PER_S) - (0 if detector is None else detector.dead_time)

    @property
    def line_count(self) -> int:
        """The number of lines."""
        return self.scan.point_count // self.count

    @property
    def coarsest(self) -> float:
        """The largest count of the axes that fly, in their unit."""
        return 1.0 / min(map(float, self.counts_per_unit))

    def make_triggers(self, point: int) -> list[Trigger]:
        """What is switched in the windows of the line of a point."""
        trigger = self.trigger
        if trigger is None:
            return []
        positions = [float(position) for position in self.list_positions(point, self.trigger_place)]
        pulse = {} if self.pulse_ns is None else {"pulse": f"{self.pulse_ns} ns"}
        return [Trigger.model_validate({"output": trigger.output, "at": positions, "of": self.lead, **pulse})]

    def make_move(self, point: int) -> Move:
        """The move to where the axes that fly rest before the window of a point."""
        begin = zip(self.scan.flown_axes, self.find_begin(point), strict=True)
        return self.scan.make_move({**self.find_target(point), **dict(begin)})

    def make_ends_scan(self) -> Scan:
        """The scan with the reach of the lines instead of their points."""
        axes = dict(self.scan.axes)
        for name, positions in zip(self.scan.flown_axes, self.list_reach(), strict=True):
            axes[name] = ScanAxis.model_validate({"values": list(positions), "snake": axes[name].snake})
        return self.scan.model_copy(update={"axes": axes})

    def find_target(self, point: int) -> dict[str, float]:
        """The positions of all axes at a point."""
        positions = self.scan.grid.find_position(point, self.units)
        return dict(zip(self.scan.axes, map(float, positions), strict=True))

    def is_forward(self, point: int) -> bool:
        """Whether the line of a point, counted from 0, goes the way of the first one."""
        return self.scan.grid.find_indices(point - point % self.count)[-1] == 0
