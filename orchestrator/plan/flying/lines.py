"""The lines of a scan that flies: where each begins and ends, so that its axes have their speed in all windows."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import NamedTuple

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.steps.fly import FlyTrigger, WindowPlace
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.points import ScanAxis
from orchestrator.model.steps.scan import Scan
from orchestrator.model.triggers import Trigger
from orchestrator.model.units import Unit

_FRACTIONS: dict[WindowPlace, Fraction] = {"start": Fraction(-1, 2), "middle": Fraction(0), "end": Fraction(1, 2)}


class LineEnds(NamedTuple):
    """Where a line begins and ends, run-up and run-down included, by axis that flies, in their unit; forward: whether
    it goes the way of the first line."""

    begin: tuple[float, ...]
    end: tuple[float, ...]
    forward: bool


class FlownAxis(NamedTuple):
    """An axis that flies. first: its first user position, in its unit. spacing: from point to point of the first line,
    also its way in a window, with its sign. share: of the way along the line that it goes, above 0 to 1."""

    name: str
    first: Fraction
    spacing: Fraction
    counts_per_unit: Fraction
    share: float

    @property
    def window_counts(self) -> float:
        """Its way in a window, counts."""
        return abs(float(self.spacing * self.counts_per_unit))


@dataclass(frozen=True, slots=True)
class FlownLines:
    """The lines of a scan that flies, all alike but for their direction. User positions, in the unit of the axes that
    fly.

    units: of all axes of the scan. axes: those that fly, all of one unit, the last ones of the scan. length: of a
    window, along the line. speed, acceleration: along it as well, in the windows and in the run-up, per s and per s².
    run_up_s, run_up: how long and how far along the line the axes take for their speed, the same for coming to rest;
    ramp_s: of it, how long the acceleration rises. tolerance: of its path.
    """

    scan: Scan
    units: Sequence[Unit]
    axes: Sequence[FlownAxis]
    count: int
    length: float
    speed: float
    acceleration: float
    run_up_s: float
    ramp_s: float
    run_up: float
    tolerance: float

    @property
    def words(self) -> str:
        """The axes that fly: `gantry.x and gantry.y`."""
        return " and ".join(axis.name for axis in self.axes)

    @property
    def lead(self) -> FlownAxis:
        """The axis that passes the most counts in a window, by which places on a line are known best."""
        return max(self.axes, key=lambda axis: axis.window_counts)

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
    def window_s(self) -> float:
        """The time in the window of a point, s."""
        return self.length / self.speed

    @property
    def line_s(self) -> float:
        """The time of a line, s, as axes with a limit of jerk take it."""
        return 2 * self.run_up / self.speed + self.run_up_s + self.count * self.window_s

    def find_run_up(self, axis: FlownAxis) -> Fraction:
        """How far an axis goes in the run-up."""
        return Fraction(self.run_up * axis.share)

    def find_speed(self, axis: FlownAxis) -> float:
        """The speed of an axis in the windows, per s."""
        return self.speed * axis.share

    @property
    def ends(self) -> LineEnds:
        """Of a line that goes forward."""
        pairs = [self._find_axis_ends(axis) for axis in self.axes]
        return LineEnds(tuple(begin for begin, _ in pairs), tuple(end for _, end in pairs), forward=True)

    def _find_axis_ends(self, axis: FlownAxis) -> tuple[float, float]:
        way = self.find_run_up(axis) * (1 if axis.spacing > 0 else -1) + axis.spacing / 2
        last = axis.first + axis.spacing * (self.count - 1)
        return self._place(axis, axis.first - way), self._place(axis, last + way)

    def _place(self, axis: FlownAxis, position: Fraction) -> float:
        """An end of a line, on a whole count: the next one begins where this one has ended, and nothing is left to
        move. Of several axes that would turn the line; a path begins and ends within a count."""
        if len(self.axes) > 1:
            return float(position)
        return float(round(position * axis.counts_per_unit) / axis.counts_per_unit)

    def find_ends(self, point: int) -> LineEnds:
        """Of the line that a point of the scan, counted from 0, belongs to."""
        first = point - point % self.count
        ends = self.ends
        if self.scan.grid.find_indices(first)[-1] == 0:
            return ends
        return LineEnds(ends.end, ends.begin, forward=False)

    def find_velocities(self, point: int) -> list[float]:
        """Of the axes that fly, with their signs, in the window of a point."""
        forward = self.find_ends(point).forward
        return [self.find_speed(axis) * (1 if forward == (axis.spacing > 0) else -1) for axis in self.axes]

    def find_begin(self, point: int) -> tuple[float, ...]:
        """Where the axes that fly rest, so that they have their speed from the window of a point on."""
        if not point % self.count:
            return self.find_ends(point).begin
        target, places = self.find_target(point), list[float]()
        for axis, velocity in zip(self.axes, self.find_velocities(point), strict=True):
            way = self.find_run_up(axis) + abs(axis.spacing) / 2
            places.append(self._place(axis, Fraction(target[axis.name]) - (way if velocity > 0.0 else -way)))
        return tuple(places)

    def list_positions(self, point: int, place: WindowPlace = "middle") -> list[Fraction]:
        """Where the axis that leads is at a place in each window of the line of a point, in the order in which they are
        flown."""
        lead, direction = self.lead, 1 if self.find_ends(point).forward else -1
        shift = lead.spacing * _FRACTIONS[place] * direction
        positions = [lead.first + lead.spacing * number + shift for number in range(self.count)]
        return positions[::direction]

    def make_path(self, point: int) -> FollowPath:
        """The path of the line of a point."""
        ends = self.find_ends(point)
        return FollowPath(
            name=self.scan.name,
            axes=self.scan.flown_axes,
            start=list(ends.begin),
            pieces=[LinePiece(piece="line", to=list(ends.end))],
            speed=self.speed,
            tolerance=self.tolerance,
            triggers=self.make_triggers(point),
        )

    def make_triggers(self, point: int) -> list[Trigger]:
        trigger = self.trigger
        if trigger is None:
            return []
        positions = [float(position) for position in self.list_positions(point, self.trigger_place)]
        pulse = {} if self.pulse_ns is None else {"pulse": f"{self.pulse_ns} ns"}
        return [Trigger.model_validate({"output": trigger.output, "at": positions, "of": self.lead.name, **pulse})]

    def make_move(self, point: int) -> Move:
        """The move to where the axes that fly rest before the window of a point."""
        begin = zip(self.scan.flown_axes, self.find_begin(point), strict=True)
        return self.scan.make_move({**self.find_target(point), **dict(begin)})

    def make_ends_scan(self) -> Scan:
        """The scan with the ends of the lines instead of their points."""
        axes, ends = dict(self.scan.axes), self.ends
        for name, begin, end in zip(self.scan.flown_axes, ends.begin, ends.end, strict=True):
            fields = {"from": begin, "to": end, "points": 2, "snake": axes[name].snake}
            axes[name] = ScanAxis.model_validate(fields)
        return self.scan.model_copy(update={"axes": axes})

    def find_target(self, point: int) -> dict[str, float]:
        """The positions of all axes at a point."""
        positions = self.scan.grid.find_position(point, self.units)
        return dict(zip(self.scan.axes, map(float, positions), strict=True))
