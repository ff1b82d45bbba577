"""A path step in counts: one profile per axis from where the axes stand, what limits it where, and how fast each member
moves when."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from math import hypot, inf
from typing import Literal, NamedTuple

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.frame import FrameSpec
from orchestrator.model.linear_map import CorrectedMap
from orchestrator.model.names import controller_of
from orchestrator.model.numbers import split_number
from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.report import PathBound, PathReport, PathStretch, PositionBound
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import Unit, UnitError, parse_quantity
from orchestrator.plan.corrected import bound_corrected, limit_axes, require_own_zero, turn_states
from orchestrator.plan.path.axes import AlongLimits, PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.plan import PathPlan, find_frame, plan_path
from orchestrator.plan.path.resolve import parse_along, parse_speed
from orchestrator.plan.path_course import PathCourse
from orchestrator.plan.path_line import fit_line, sample_speeds
from orchestrator.plan.path_lines import LineTimes, time_lines
from orchestrator.plan.path_profiles import Array, FittedAxis, PathStates, find_fit_error, fit_profiles
from orchestrator.plan.play import bound_path
from orchestrator.plan.racks import require_single_motor
from orchestrator.plan.step import AxisMove, StepPlan
from orchestrator.plan.targets import find_jerk, make_axis_move
from orchestrator.plan.virtual_bound import CurvedLine

MAX_STRETCHES = 200  # of a report
ORDERS = ("", "velocity", "acceleration", "jerk")
ALONG = ("its table", "speed along the path", "acceleration along the path", "jerk along the path")
SAMPLES = 2001  # of the speeds of members
MAX_START_COUNTS = 1  # by which an axis may stand beside the start of its path: rounding


class PathStart(NamedTuple):
    """An axis of a path before it. here: its exact motor position, which is start_counts and what it is `ahead` of its
    motor by the play of its drive, in counts; offset: user minus motor position, both in its unit. order: of the
    profiles that its controller executes."""

    name: str
    axis: Axis
    here: Fraction
    start_counts: int
    offset: Fraction
    order: Literal[2, 3]
    ahead: int = 0


@dataclass(frozen=True, slots=True)
class PlannedPath:
    """A planned path.

    exact: the end of each axis (motor position) and its counts. tolerance, fit_error: in the unit of `report`.
    counts_per_unit: by axis, in that unit. times_s, speeds: samples of the plan, by axis, in that unit/s. course: the
    motion, for members that execute it in chunks; a line on a trapezoid has none.
    lines: of the file that it was made of. bounds: of compensated axes, by what the fleet file states of them.
    line: of curved virtual axes, on which the path keeps them.
    """

    plan: StepPlan
    moves: list[AxisMove]
    exact: Mapping[str, tuple[Fraction, int]]
    report: PathReport
    tolerance: float
    fit_error: float
    counts_per_unit: Mapping[str, float]
    times_s: Array
    speeds: Mapping[str, Array]
    course: PathCourse | None
    lines: LineTimes | None = None
    bounds: Mapping[str, PositionBound] = field(default_factory=dict[str, PositionBound])
    line: CurvedLine | None = None

    @property
    def compensation_error(self) -> float:
        """How far the axes together may be off the path because their compensation is not exact, in its unit."""
        return hypot(*(bound.table + bound.play for bound in self.bounds.values()))

    def find_speeds(self, member: str) -> tuple[Array, Array]:
        """Instants, s, and the speed of the axes of a member together, in the unit of `report` per s."""
        squares = [speeds**2 for axis, speeds in self.speeds.items() if controller_of(axis) == member]
        return self.times_s, np.sqrt(np.sum(squares, axis=0))

    def make_report(self, duration_s: float, bound: PathBound | None) -> PathReport:
        """The report of the path in another time, as its members have agreed on it, with its bound."""
        factor = duration_s / self.report.duration_s
        stretches = [
            stretch.model_copy(update={"from_s": stretch.from_s * factor, "to_s": stretch.to_s * factor})
            for stretch in self.report.stretches
        ]
        return self.report.model_copy(update={"duration_s": duration_s, "stretches": stretches, "bound": bound})


def plan_path_step(
    step: FollowPath, starts: Sequence[PathStart], frames: Mapping[str, FrameSpec] | None = None
) -> PlannedPath:
    """Plan a path whose axes stand at its start. frames: those of the fleet file. Raises `Refusal`, `PlanError`."""
    step, starts = _apply_fraction(step, starts)
    unit = find_unit(starts)
    tolerance = _parse_tolerance(step, unit)
    table_map = _find_corrected(step, starts, frames or {})
    require_start(step, starts, frames or {})
    plan = plan_path(step, _describe_axes(starts, table_map), frames)
    motion = _PathOfAxes(plan, starts, table_map)
    ends = motion.evaluate(np.array([plan.duration_s])).positions[0].tolist()
    axes: list[FittedAxis] = []
    exact: dict[str, tuple[Fraction, int]] = {}
    for start, end in zip(starts, ends, strict=True):
        exact[start.name] = Fraction(end), start.axis.to_target_counts(Fraction(end)) - start.ahead
        axes.append(make_fitted_axis(start, exact[start.name][1]))

    slow = next((start for start in starts if start.order < 3), None)
    stretches, course = _list_stretches(plan), None
    if slow is not None and len(step.pieces) == 1 and isinstance(step.pieces[0], LinePiece):
        fitted_line = fit_line(axes, plan.length, _find_line_limits(step, unit))
        times_s = np.linspace(0.0, fitted_line.duration_s, SAMPLES)
        speeds = sample_speeds(fitted_line, axes, times_s)
        stretches = [PathStretch(from_s=0.0, to_s=plan.duration_s, binds=f"a trapezoid, which {slow.name} needs")]
    else:
        fitted_line = fit_profiles(motion.evaluate_motors, plan.duration_s, axes, tolerance)
        _require_orders(start for start in starts if start.name in fitted_line.profiles)
        times_s = np.linspace(0.0, plan.duration_s, SAMPLES)
        speeds = np.abs(motion.evaluate(times_s).velocities).T
        moved_axes = [column for column, axis in enumerate(axes) if axis.name in fitted_line.profiles]
        course = PathCourse(
            fitted_line.motion, axes, moved_axes, fitted_line.motion.positions[0], find_fit_error(axes, tolerance)
        )
    path = PlannedPath(
        plan=StepPlan(fitted_line.duration_s, fitted_line.profiles, fitted_line.standing),
        moves=make_moves(starts, exact),
        exact=exact,
        report=PathReport(
            unit=unit,
            frame=step.frame or "",
            length=plan.length,
            duration_s=plan.duration_s,
            stretches=stretches,
        ),
        tolerance=tolerance,
        fit_error=fitted_line.error,
        counts_per_unit={axis.name: axis.counts_per_unit for axis in axes},
        times_s=times_s,
        speeds={start.name: row for start, row in zip(starts, speeds, strict=True)},
        course=course,
        lines=time_lines(step, plan),
        bounds=_bound_axes(starts, table_map, is_straight=course is None),
    )
    return replace(path, report=path.make_report(fitted_line.duration_s, None))


def _find_corrected(
    step: FollowPath, starts: Sequence[PathStart], frames: Mapping[str, FrameSpec]
) -> CorrectedMap | None:
    """The map of a corrected frame, whose tables count from the references. Raises `Refusal`."""
    table_map = None if step.frame is None else find_frame(step, frames).corrected
    if table_map is not None:
        require_own_zero(table_map, {start.name: start.offset for start in starts})
    return table_map


class _PathOfAxes:
    """A path as motions of its axes, in motor positions without play and tables of their own, and of their motors."""

    def __init__(self, plan: PathPlan, starts: Sequence[PathStart], corrected: CorrectedMap | None) -> None:
        self._plan, self._starts, self._corrected = plan, starts, corrected
        self._shift = np.array([float(start.offset) for start in starts])
        self._is_compensated = any(start.axis.is_compensated for start in starts)

    def evaluate(self, times_s: Array) -> PathStates:
        rows = self._plan.evaluate(times_s)
        states = PathStates(rows.positions - self._shift, rows.velocities, rows.accelerations)
        return states if self._corrected is None else turn_states(self._corrected, states)

    def evaluate_motors(self, times_s: Array) -> PathStates:
        states = self.evaluate(times_s)
        return _turn_motors(self._starts, states) if self._is_compensated else states


def _turn_motors(starts: Sequence[PathStart], axes: PathStates) -> PathStates:
    """The states of the motors for those of their axes; how far these are ahead stays as at the start."""
    motors = PathStates(*(states.copy() for states in axes))
    for column, start in enumerate(starts):
        if start.axis.correction is not None:
            table = start.axis.correction.table
            motors.positions[:, column], ratios = table.invert_all(axes.positions[:, column])
            motors.velocities[:, column] *= ratios
        motors.positions[:, column] -= start.axis.to_length(start.ahead)
    return motors


def _bound_axes(
    starts: Sequence[PathStart], corrected: CorrectedMap | None, *, is_straight: bool
) -> dict[str, PositionBound]:
    """How far compensated axes may be off a path; of a corrected frame its virtual axes. is_straight: of their motors,
    so that tables count at its ends only."""
    bounds: dict[str, PositionBound] = {}
    for start in starts:
        bound, correction = bound_path(start.axis), start.axis.correction
        if bound is not None and correction is not None and is_straight:
            span = correction.table.span
            bound = bound.model_copy(update={"most": bound.most + span, "table": bound.table + span})
        if bound is not None:
            bounds[start.name] = bound
    if corrected is None:
        return bounds
    spans = [high - low for low, high in corrected.errors.find_ranges(corrected.box)] if is_straight else None
    return bound_corrected(corrected, [start.axis for start in starts], bounds, spans)


def make_moves(starts: Sequence[PathStart], exact: Mapping[str, tuple[Fraction, int]]) -> list[AxisMove]:
    """The moves of the axes of a path to its end. exact: their ends, with their counts."""
    return [
        make_axis_move(start.name, start.axis, start.start_counts, exact[start.name][1], start.order)
        for start in starts
    ]


def make_fitted_axis(start: PathStart, end_counts: int) -> FittedAxis:
    """An axis of a path with its limits and its ends."""
    limits = start.axis.limits
    return FittedAxis(
        name=start.name,
        counts_per_unit=float(start.axis.counts_per_unit),
        velocity=limits.velocity,
        acceleration=limits.acceleration,
        start_counts=start.start_counts,
        end_counts=end_counts,
        jerk=limits.jerk or inf,
    )


def _apply_fraction(step: FollowPath, starts: Sequence[PathStart]) -> tuple[FollowPath, Sequence[PathStart]]:
    """A path at a speed in percent: without limit along it, and with that fraction of what its axes allow. Raises
    `PathRefusal`."""
    parts = split_number(step.speed) if isinstance(step.speed, str) else None
    if parts is None or parts[1] != "%":
        return step, starts
    fraction = float(parts[0]) / 100
    if not 0.0 < fraction <= 1.0:
        text = f"`speed` of the path is {step.speed}, of what its axes allow"
        raise PathRefusal("bad-limit", text, "choose a value above 0 to 100 %")
    slow_starts: list[PathStart] = []
    for start in starts:
        limits = start.axis.limits.model_copy(update={"velocity": start.axis.limits.velocity * fraction})
        slow_starts.append(start._replace(axis=start.axis.model_copy(update={"limits": limits})))
    return step.model_copy(update={"speed": None}), slow_starts


def _find_line_limits(step: FollowPath, unit: Unit) -> AlongLimits:
    """The limits along a path of one line. Raises `PathRefusal`."""
    along, speed = parse_along(step, unit), parse_speed(step.pieces[0], unit, 0)
    return along if speed == inf else replace(along, speed=min(speed, along.speed or inf))


def _describe_axes(starts: Sequence[PathStart], corrected: CorrectedMap | None) -> list[PathAxis]:
    axes = [_describe_axis(start) for start in starts]
    return axes if corrected is None else limit_axes(corrected, axes)


def _describe_axis(start: PathStart) -> PathAxis:
    """An axis for the planner, which knows user positions only."""
    require_single_motor(start.name, start.axis, "follow the path")
    axis, limits = start.axis, start.axis.soft_limits_counts
    soft = None
    if limits is not None:
        low, high = sorted(axis.to_unit(limit) + float(start.offset) for limit in limits)
        soft = low, high
    # Limits are those of the motor, which turns faster than its axis where the error falls.
    least_ratio = 1.0 if axis.correction is None else 1 - axis.correction.table.slope
    return PathAxis(
        axis=start.name,
        unit=axis.unit,
        velocity=axis.limits.velocity * least_ratio,
        acceleration=axis.limits.acceleration * least_ratio,
        jerk=find_jerk(axis) * least_ratio,
        soft_limits=soft,
    )


def _list_stretches(plan: PathPlan) -> list[PathStretch]:
    """What limits a path when, without what lasts a moment only; neighbours differ."""
    stretches: list[PathStretch] = []
    least_s = plan.duration_s / MAX_STRETCHES
    for stretch in plan.find_stretches():
        binds = ALONG[stretch.order] if stretch.axis is None else f"{ORDERS[stretch.order]} of {stretch.axis}"
        last = stretches[-1] if stretches else None
        if last is not None and (last.binds == binds or stretch.t1_s - stretch.t0_s < least_s):
            stretches[-1] = last.model_copy(update={"to_s": stretch.t1_s})
        else:
            stretches.append(PathStretch(from_s=stretch.t0_s, to_s=stretch.t1_s, binds=binds))
    return stretches


def find_unit(starts: Sequence[PathStart]) -> Unit:
    """The unit of all axes. Raises `Refusal` if they have several: a distance from the path would have none."""
    units = {start.axis.unit: start.name for start in starts}
    if len(units) > 1:
        words = ", ".join(f"{name} in {unit}" for unit, name in units.items())
        remedy = "name axes of one unit, or change the unit of one in the fleet file"
        raise Refusal("path-units", f"the axes of a path must have one unit; it has {words}", remedy)
    return next(iter(units))


def _parse_tolerance(step: FollowPath, unit: Unit) -> float:
    try:
        tolerance = float(parse_quantity(step.tolerance, unit, "the path"))
    except UnitError as error:
        raise Refusal("bad-unit", f"`tolerance`: {error}", "correct the unit") from None
    if tolerance <= 0:
        raise Refusal("path-error", f"the tolerance is {step.tolerance}; it must be above 0", "allow some micrometres")
    return tolerance


def find_start(step: FollowPath, units: Sequence[Unit], frames: Mapping[str, FrameSpec]) -> list[Fraction]:
    """Where the axes of a path stand at its start: user positions, in the units of the axes. Raises `Refusal`."""
    if step.file is not None:
        text = f"the path is in the file {step.file!r} of the client, which has to read it"
        raise Refusal("unread-path", text, "submit the job with `tutti submit`, or from Python, where the file is")
    try:
        frame = None if step.frame is None else find_frame(step, frames)
        named_units = units if frame is None else [frame.unit] * len(units)
        values = [
            parse_quantity(value, unit, name)
            for value, unit, name in zip(step.start, named_units, step.axes, strict=True)
        ]
    except UnitError as error:
        raise Refusal("bad-unit", f"`start`: {error}", "correct the unit") from None
    if frame is None:
        return values
    return [
        Fraction(value) for value in frame.find_positions([float(coordinate) for coordinate in values], list(units))
    ]


def require_start(step: FollowPath, starts: Sequence[PathStart], frames: Mapping[str, FrameSpec]) -> None:
    """Raise `Refusal` for an axis that does not stand where the path begins, to a count."""
    units = [start.axis.unit for start in starts]
    for position, start in zip(find_start(step, units, frames), starts, strict=True):
        axis = start.axis
        axis_counts = start.start_counts + start.ahead
        if abs(axis.to_counts(position - start.offset) - axis_counts) > MAX_START_COUNTS:
            more = "" if step.frame is None else f" ({_describe_place(step, starts, frames)})"
            raise Refusal(
                "other-start",
                f"axis {start.name} is at {float(start.here + start.offset):g} {axis.unit}; the path begins at "
                f"{float(position):g} {axis.unit}{more}",
                f"move it there before: a step `do: move` to {float(position):g}, or `tutti axis move`",
                controller_of(start.name),
            )


def _describe_place(step: FollowPath, starts: Sequence[PathStart], frames: Mapping[str, FrameSpec]) -> str:
    """Where the axes are, in the coordinates of the frame."""
    frame = find_frame(step, frames)
    positions = np.array([[float(start.here + start.offset) for start in starts]])
    values = frame.find_coordinates(positions, [start.axis.unit for start in starts])[0].tolist()
    words = ", ".join(f"{name} {value:.6g}" for name, value in zip(frame.coordinates, values, strict=True))
    return f"in {step.frame} the axes are at {words} {frame.unit}"


def _require_orders(starts: Iterable[PathStart]) -> None:
    """Raise `Refusal` for an axis that moves, and whose controller executes trapezoids only."""
    for start in starts:
        if start.order < 3:
            raise Refusal(
                "path-class",
                f"axis {start.name}: its controller executes moves from rest to rest only, and cannot follow a path",
                f"leave the axis out of the path, and move it before or after{describe_jerk_remedy(start.axis)}",
                controller_of(start.name),
            )


def describe_jerk_remedy(axis: Axis) -> str:
    """What may let an axis follow positions, behind another remedy; empty if its limits have a jerk already."""
    if axis.limits.jerk is not None:
        return ""
    return "; if its make can follow positions (CiA 402, SMC-4000, SMC-2000), add `jerk` to its limits"
