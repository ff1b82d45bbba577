"""The lines of a scan that flies: where each begins and ends, so that the axis has its speed in all windows."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, sqrt
from typing import NamedTuple

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.steps.fly import LEAST_WINDOW_NS, FlyOptions, FlyTrigger, WindowPlace
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.points import GridPoints, ScanAxis
from orchestrator.model.steps.scan import Scan
from orchestrator.model.triggers import Trigger
from orchestrator.model.units import Unit, UnitError, parse_quantity, parse_rate
from orchestrator.plan.targets import find_jerk

MARGIN_COUNTS = 2  # of each run-up: its ends are rounded to counts
LEAST_WINDOW_COUNTS = 2
# A make that switches outputs in a stream of positions makes a path slower until it is whole periods long: so a line
# with triggers is a little shorter than so many of these. A whole number of the usual periods.
PERIOD_S, PERIOD_MARGIN_S = 0.02, 0.0002
TOLERANCE = Fraction(1, 4)  # of a window
EVEN = 1e-9  # of a distance: rounding of values that are written as decimals
_FRACTIONS: dict[WindowPlace, Fraction] = {"start": Fraction(-1, 2), "middle": Fraction(0), "end": Fraction(1, 2)}


class LineEnds(NamedTuple):
    """Where a line begins and ends, run-up and run-down included, in the unit of its axis; forward: whether it goes the
    way of the first line."""

    begin: float
    end: float
    forward: bool


@dataclass(frozen=True, slots=True)
class FlownLines:
    """The lines of a scan that flies, all alike but for their direction. User positions, in the unit of the axis.

    units: of all axes of the scan. first: position of the axis that flies. spacing: from point to point of the first
    line, also the length of a window, with its sign. speed: in the windows, per s. run_up_s, run_up: how long and how
    far the axis takes for its speed, the same for coming to rest; ramp_s: of it, how long its acceleration rises.
    tolerance: of its path.
    """

    scan: Scan
    units: Sequence[Unit]
    first: Fraction
    spacing: Fraction
    count: int
    speed: float
    run_up_s: float
    ramp_s: float
    run_up: float
    tolerance: float
    counts_per_unit: Fraction

    @property
    def axis(self) -> str:
        """The axis that flies."""
        return self.scan.flown_axis

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
        return abs(float(self.spacing)) / self.speed

    @property
    def line_s(self) -> float:
        """The time of a line, s, as an axis with a limit of jerk takes it."""
        return 2 * self.run_up / self.speed + self.run_up_s + self.count * self.window_s

    @property
    def ends(self) -> LineEnds:
        """Of a line that goes forward."""
        way = Fraction(self.run_up) * (1 if self.spacing > 0 else -1) + self.spacing / 2
        last = self.first + self.spacing * (self.count - 1)
        # On whole counts: the next line begins where this one has ended, and nothing is left to move.
        begin, end = (round(position * self.counts_per_unit) for position in (self.first - way, last + way))
        return LineEnds(float(begin / self.counts_per_unit), float(end / self.counts_per_unit), forward=True)

    def find_ends(self, point: int) -> LineEnds:
        """Of the line that a point of the scan, counted from 0, belongs to."""
        first = point - point % self.count
        ends = self.ends
        if GridPoints(self.scan.axes).find_indices(first)[-1] == 0:
            return ends
        return LineEnds(ends.end, ends.begin, forward=False)

    def find_velocity(self, point: int) -> float:
        """Of the axis that flies, with its sign, in the window of a point."""
        is_rising = self.find_ends(point).forward == (self.spacing > 0)
        return self.speed if is_rising else -self.speed

    def find_begin(self, point: int) -> float:
        """Where the axis that flies rests, so that it has its speed from the window of a point on."""
        if not point % self.count:
            return self.find_ends(point).begin
        way = Fraction(self.run_up) + abs(self.spacing) / 2
        position = Fraction(self.find_target(point)[self.axis]) - (way if self.find_velocity(point) > 0.0 else -way)
        return float(round(position * self.counts_per_unit) / self.counts_per_unit)

    def list_positions(self, point: int, place: WindowPlace = "middle") -> list[Fraction]:
        """A place in each window of the line of a point, in the order in which they are flown."""
        direction = 1 if self.find_ends(point).forward else -1
        shift = self.spacing * _FRACTIONS[place] * direction
        positions = [self.first + self.spacing * number + shift for number in range(self.count)]
        return positions[::direction]

    def make_path(self, point: int) -> FollowPath:
        """The path of the line of a point."""
        ends = self.find_ends(point)
        return FollowPath(
            name=self.scan.name,
            axes=[self.axis],
            start=[ends.begin],
            pieces=[LinePiece(piece="line", to=[ends.end])],
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
        return [Trigger.model_validate({"output": trigger.output, "at": positions, "of": self.axis, **pulse})]

    def make_move(self, point: int) -> Move:
        """The move to where the axis that flies rests before the window of a point."""
        return self.scan.make_move({**self.find_target(point), self.axis: self.find_begin(point)})

    def make_ends_scan(self) -> Scan:
        """A scan from point to point that has the ends of the lines instead of their points."""
        name, axis = self.axis, self.scan.axes[self.axis]
        fields = {"from": self.ends.begin, "to": self.ends.end, "points": 2, "snake": axis.snake}
        ends = ScanAxis.model_validate(fields)
        return self.scan.model_copy(update={"axes": {**self.scan.axes, name: ends}, "fly": None})

    def find_target(self, point: int) -> dict[str, float]:
        """The positions of all axes at a point."""
        positions = GridPoints(self.scan.axes).find_position(point, self.units)
        return dict(zip(self.scan.axes, map(float, positions), strict=True))


def plan_lines(scan: Scan, fleet: Fleet) -> FlownLines:
    """The lines of a scan that flies, whose positions are all quantities. Raises `Refusal` for what cannot be flown,
    wherever its axes are."""
    assert scan.fly is not None
    name = scan.flown_axis
    axis, owner = fleet.axis(name), controller_of(name)
    if axis.turn_length is not None:
        text = f"axis {name} wraps, and a line has a beginning and an end"
        raise Refusal("fly-axis", text, "scan it point by point: leave out `fly`", owner)
    try:
        first, spacing, count = _find_spacing(scan, axis.unit)
        tolerance = _parse_tolerance(scan.fly, axis.unit, name, spacing)
        speed = _find_speed(scan.fly, axis, spacing)
    except UnitError as error:
        raise Refusal("bad-unit", f"`fly`: {error}", "correct the unit", owner) from None
    window = abs(float(spacing))
    counts_per_unit = abs(Fraction(axis.counts_per_unit))
    if window * float(counts_per_unit) < LEAST_WINDOW_COUNTS:
        text = f"the windows of {name} are {window * float(counts_per_unit):.3g} counts long; the least are 2"
        raise Refusal("fly-window", text, "put its points farther apart", owner)
    if speed > axis.limits.velocity * (1 + EVEN):
        text = (
            f"{name} flies at {speed:g} {axis.unit}/s through windows of {window:g} {axis.unit}; its limit is "
            f"{axis.limits.velocity:g} {axis.unit}/s"
        )
        fitting_ms = window / axis.limits.velocity * 1e3
        remedy = f"`duration: {fitting_ms * 1.0005:.4g} ms` or longer fits, or points that are closer together"
        raise Refusal("fly-speed", text, remedy, owner)
    _require_detector(scan.fly, name, window / speed)
    ramp_s = axis.limits.acceleration / find_jerk(axis)
    run_up_s = speed / axis.limits.acceleration + ramp_s
    run_up = speed * run_up_s / 2 + MARGIN_COUNTS / float(counts_per_unit)
    if scan.fly.trigger is not None:
        line_s = 2 * run_up / speed + run_up_s + count * window / speed
        run_up += speed * (ceil(line_s / PERIOD_S) * PERIOD_S - PERIOD_MARGIN_S - line_s) / 2
    return FlownLines(
        scan=scan,
        units=[Unit(fleet.axis(named_axis).unit) for named_axis in scan.axes],
        first=first,
        spacing=spacing,
        count=count,
        speed=min(speed, axis.limits.velocity),
        run_up_s=run_up_s,
        ramp_s=ramp_s,
        run_up=run_up,
        tolerance=tolerance,
        counts_per_unit=counts_per_unit,
    )


def check_room(lines: FlownLines, axis: Axis, offset: Fraction) -> None:
    """Raise `Refusal` for lines that leave the soft limits with their run-up or run-down. offset: user minus motor
    position."""
    limits = axis.soft_limits_counts
    if limits is None:
        return
    low, high = sorted(axis.to_unit(limit) + float(offset) for limit in limits)
    least, most = sorted(lines.ends[:2])
    excess = max(low - least, most - high)
    if excess * float(lines.counts_per_unit) > 0.5:
        limit, line_end = (low, least) if low - least == excess else (high, most)
        text = (
            f"{lines.axis} needs {lines.run_up:.4g} {axis.unit} before and behind its windows for "
            f"{lines.speed:g} {axis.unit}/s; its lines reach {line_end:.6g} {axis.unit}, {excess:.4g} {axis.unit} "
            f"beyond its soft limit {limit:g} {axis.unit}"
        )
        fitting = _describe_fitting(lines, axis, lines.run_up - excess)
        remedy = f"{fitting}scan a shorter line, or change the soft limits in the fleet file"
        raise Refusal("fly-room", text, remedy, controller_of(lines.axis))


def _describe_fitting(lines: FlownLines, axis: Axis, room: float) -> str:
    """Which time in a window fits a shorter run-up, in words; empty if none does. room: for the run-up."""
    has_trigger = lines.scan.fly is not None and lines.scan.fly.trigger is not None
    room -= MARGIN_COUNTS / float(lines.counts_per_unit) + lines.speed * PERIOD_S / 2 * has_trigger
    if room <= 0.0:
        return ""
    acceleration, ramp_s = axis.limits.acceleration, lines.ramp_s
    speed = acceleration * (sqrt(ramp_s**2 + 8 * room / acceleration) - ramp_s) / 2
    return f"`duration: {abs(float(lines.spacing)) / speed * 1.0005e3:.4g} ms` or longer fits; or "


def _find_spacing(scan: Scan, unit: Unit | str) -> tuple[Fraction, Fraction, int]:
    """The first position of the innermost axis, the distance of two, and their number. Raises `Refusal`,
    `UnitError`."""
    name = scan.flown_axis
    axis = scan.axes[name]
    count = axis.count
    positions = [axis.position(number, Unit(unit)) for number in range(count if axis.values is not None else 2)]
    spacing = positions[1] - positions[0]
    if axis.values is not None:
        spacing = (positions[-1] - positions[0]) / (count - 1)
        off = max(abs(position - positions[0] - spacing * k) for k, position in enumerate(positions))
        if off > abs(spacing) * Fraction(EVEN):
            text = f"the `values` of {name} are not evenly spaced, and one speed cannot fit windows of several lengths"
            raise Refusal("fly-spacing", text, "write `from`, `to` and `points`, or leave out `fly`")
    if spacing == 0:
        text = f"all points of {name} are at {float(positions[0]):g} {unit}, so that it would not move"
        raise Refusal("fly-spacing", text, "write another `to`, or leave out `fly`")
    return positions[0], spacing, count


def _require_detector(fly: FlyOptions, axis: str, window_s: float) -> None:
    """Raise `Refusal` for windows that are shorter than the detector takes."""
    detector, trigger = fly.detector, fly.trigger
    least_s = 0.0 if detector is None else detector.least_window_s
    if window_s < least_s * (1 - EVEN):
        text = f"the windows of {axis} last {window_s * 1e3:.4g} ms; the detector takes one in {least_s * 1e3:.4g} ms"
        remedy = f"`duration: {least_s * 1e3:.4g} ms` or longer fits, or leave `duration` and `speed` out"
        raise Refusal("fly-detector", text, remedy, controller_of(axis))
    if trigger is not None and trigger.gate and detector is not None and detector.dead_time >= window_s * NS_PER_S:
        text = f"a gate in windows of {window_s * 1e3:.4g} ms has no time beside a dead time as long"
        raise Refusal("fly-detector", text, "write a longer `duration`", controller_of(axis))


def _find_speed(fly: FlyOptions, axis: Axis, spacing: Fraction) -> float:
    """The speed in the windows, in the unit of the axis per s. Raises `Refusal`, `UnitError`."""
    unit = axis.unit
    if fly.duration is not None:
        return abs(float(spacing)) / (fly.duration / NS_PER_S)
    if fly.speed is None:
        least_s = max(LEAST_WINDOW_NS / NS_PER_S, 0.0 if fly.detector is None else fly.detector.least_window_s)
        return min(axis.limits.velocity, abs(float(spacing)) / least_s)
    value = fly.speed
    if isinstance(value, str) and value.strip().endswith("%"):
        raise Refusal("bad-unit", f"`fly`: a speed of {value} says no time for a point", 'write e.g. "5 mm/s"')
    speed = parse_rate(value, Unit(unit), 1) if isinstance(value, str) else float(value or 0.0)
    if not speed > 0.0:
        raise Refusal("fly-speed", f"`fly`: the speed is {value}; it must be above 0", "choose a value above 0")
    return speed


def _parse_tolerance(fly: FlyOptions, unit: Unit | str, name: str, spacing: Fraction) -> float:
    if fly.tolerance is None:
        return abs(float(spacing * TOLERANCE))
    return float(parse_quantity(fly.tolerance, Unit(unit), name))
