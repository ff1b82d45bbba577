"""The forecast of a scan, without the steps at its points."""

from collections.abc import Mapping, Sequence
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of, is_position_name
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import UnitError
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.line import forecast_lines, take_lines
from orchestrator.plan.forecast.motion import plan_ways
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import take_target
from orchestrator.plan.forecast.virtual_scan import forecast_virtual_scan
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.forecast.zones import ZoneArea, check_area, find_area, widen_area
from orchestrator.plan.scan_ways import ScanCorner, ScanWays, find_corners, iterate_ways
from orchestrator.plan.targets import make_axis_move
from orchestrator.plan.virtual_moves import find_virtual_names


def forecast_scan(state: ForecastState, at: ForecastContext, step: Scan) -> Span:
    """Run a scan forward."""
    forecast = forecast_virtual_scan if find_virtual_names(state.fleet, step) else _forecast_real_scan
    return forecast(state, at, step)


def _forecast_real_scan(state: ForecastState, at: ForecastContext, step: Scan) -> Span:
    """Run the ways between the points of a scan forward, by their kinds; of one that flies between the ends of its
    lines, and its first line."""
    axes = _find_axes(state, at, step)
    if axes is None:
        return Span()
    units, unknown, lines = [axis.unit for axis in axes.values()], state.note_unknown_positions(step), None
    if unknown:
        step = step.replace_targets(lambda _, target: 0 if is_position_name(target) else target)
    elif step.fly is not None:
        lines = take_lines(state, at, step)
        if lines is None:
            return Span()
        step = lines.make_ends_scan()
    try:
        corners, kinds = find_corners(step, units, unknown), list(iterate_ways(step, units))
    except UnitError as error:
        state.add_problem(at, (), Refusal("bad-unit", str(error), "correct the unit"))
        return Span()
    area = find_area(state, axes)
    first, sure = MoveWays(), {name: axis for name, axis in axes.items() if name not in unknown}
    for name, axis in sure.items():
        field = TargetField("axes", name, axis)
        state.require_ready(at, name, field.place)
        _take_corners(state, at, first, field, _describe_corners(corners[name], step.point_count))
        widen_area(state, area, name, [corner.position for corner in corners[name]])
    span = plan_ways(state, at, step, first)
    if lines is not None:
        kinds.pop()  # the innermost axis moves
    between_span = Span()
    for kind in kinds:
        between_span = between_span.followed_by(_plan_kind(state, at, step, sure, kind), kind.often)
    span = span.followed_by(_forecast_between(state, at, lines, between_span, area))
    state.lose_positions(at, unknown)
    return Span(span.least, None) if unknown else span


def _forecast_between(
    state: ForecastState, at: ForecastContext, lines: FlownLines | None, between: Span, area: ZoneArea
) -> Span:
    """What follows the way to the first point: the moves between points, or the lines that are flown. area: in which
    the axes are."""
    if lines is not None:
        return forecast_lines(state, at, lines, between, area)
    check_area(state, area, "ways between points")
    return between


def _find_axes(state: ForecastState, at: ForecastContext, step: Scan) -> dict[str, Axis] | None:
    """The axes of a scan; None, and problems, if one does not exist, or its points are in another unit."""
    named_axes = {name: state.find_axis(at, name, ("axes", name)) for name in step.axis_names}
    axes = {name: axis for name, axis in named_axes.items() if axis is not None}
    if len(axes) < len(named_axes):
        return None
    for column in step.points.columns if step.points is not None else ():
        if column.unit != axes[column.axis].unit:
            text = f"the points of {column.axis} are in {column.unit}, and the axis is in {axes[column.axis].unit}"
            problem = Refusal("bad-unit", text, "submit the job again", controller_of(column.axis))
            state.add_problem(at, ("points",), problem)
            return None
    return axes


def _describe_corners(corners: Sequence[ScanCorner], points: int) -> list[tuple[Fraction, str]]:
    """The position of each corner, and which point it is in words."""
    named_corners = [
        (corner, ", ".join(f"{axis} {value:g}" for axis, value in corner.positions.items())) for corner in corners
    ]
    return [(corner.position, f", at point {corner.point} of {points} ({words})") for corner, words in named_corners]


def _take_corners(
    state: ForecastState,
    at: ForecastContext,
    first: MoveWays,
    field: TargetField,
    corners: Sequence[tuple[Fraction, str]],
) -> None:
    """Move one axis of a scan to its extremes. first: gets the way to the first point. corners: with their words."""
    ways, visited_positions = first, set[Fraction]()
    for number, (position, corner_text) in enumerate(corners):
        last = number == len(corners) - 1
        if position in visited_positions and not last:
            continue
        problems = () if position not in visited_positions else tuple(state.problems)
        visited_positions.add(position)
        take_target(state, at.at_time(corner_text + at.when), ways, field, position)
        if problems:
            state.problems = list(problems)  # the corner was reported before
        ways = MoveWays()


def _plan_kind(state: ForecastState, at: ForecastContext, step: Scan, axes: Mapping[str, Axis], kind: ScanWays) -> Span:
    """The duration of one kind of way between points."""
    ways = MoveWays()
    for name, axis in axes.items():
        for ends, moves in ((kind.nearest, ways.nearest), (kind.farthest, ways.farthest)):
            if name in ends:
                start, target = (axis.to_target_counts(end) for end in ends[name])
                moves.append(make_axis_move(name, axis, start, target, state.order_of(name, axis)))
    return plan_ways(state, at, step, ways)
