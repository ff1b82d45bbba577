"""The forecast of a path."""

from collections.abc import Iterable, Mapping
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.flying.path import FlightPath, plan_flight_step
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.motion import check_record, check_triggers
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.ways import ForecastMotion
from orchestrator.plan.forecast.zones import check_path
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path_step import PathStart, PlannedPath, find_start, plan_path_step
from orchestrator.plan.probes import ContactRange
from orchestrator.plan.shape import PlanError


def forecast_path(state: ForecastState, at: ForecastContext, step: FollowPath) -> Span:
    """Run a path forward."""
    check_record(state, at, step)
    named_axes = {name: state.find_axis(at, name, ("axes", number)) for number, name in enumerate(step.axes)}
    axes = {name: axis for name, axis in named_axes.items() if axis is not None}
    for name in axes:
        state.require_ready(at, name, ("axes",))
    if len(axes) < len(named_axes):
        return Span()
    bases = _list_bases(state, at, axes)
    try:
        path, *_ = [_plan_path(state, at, step, axes, base) for base in bases]
    except (Refusal, PlanError) as error:
        code, text, remedy = ("plan", str(error), "")
        if isinstance(error, Refusal):
            code, text, remedy = error.code, error.text, error.remedy
        if isinstance(error, PathRefusal) and error.piece and step.origin is not None:
            text = f"{step.origin.describe(error.piece)}: {text}"
        state.add_problem(at, (), Refusal(code, text, remedy))
        state.lose_positions(at, axes)
        return Span()
    _note_bare_speed(state, step)
    check_path(state, at, step, path, {name: state.ranges.get(name) for name in bases[0]})
    span = take_path(state, at, step, path)
    _keep_unknown(state, bases[0])
    return span


def _list_bases(state: ForecastState, at: ForecastContext, axes: Iterable[str]) -> list[dict[str, Fraction]]:
    """Motor positions at which the axes of a path may have been whose zero was set where their position was not known:
    both ends of what is known of that, or 0 where nothing is."""
    no_range = ContactRange(Fraction(0), Fraction(0))
    ranges = {
        name: state.ranges.get(name, no_range)
        for name in axes
        if not state.find_state(at, name).known and state.axes[name].offset_kind == "start"
    }
    low, high = ({name: reach[number] for name, reach in ranges.items()} for number in (0, 1))
    return [low] if low == high else [low, high]


def _plan_path(
    state: ForecastState, at: ForecastContext, step: FollowPath, axes: Mapping[str, Axis], base: Mapping[str, Fraction]
) -> PlannedPath:
    starts = _find_starts(state, at, step, axes, base)
    if isinstance(step, FlightPath):
        return plan_flight_step(step, starts)
    return plan_path_step(step, starts, state.fleet.path_frames)


def _keep_unknown(state: ForecastState, base: Mapping[str, Fraction]) -> None:
    """Axes whose zero was set at an unknown position are a known distance from there, and no more."""
    for name, begin in base.items():
        motor, state_before = state.axes[name].motor - begin, state.axes[name]
        ends = {"lowest": min(state_before.lowest, motor), "highest": max(state_before.highest, motor)}
        state.axes[name] = state_before.model_copy(update={"motor": motor, "known": False, **ends})
        state.motion = None


def take_path(state: ForecastState, at: ForecastContext, step: FollowPath, path: PlannedPath) -> Span:
    """Move the axes of a planned path to its end."""
    for name, (end, _) in path.exact.items():
        state.axes[name] = state.find_state(at, name).model_copy(update={"motor": end, "known": True})
    state.motion = ForecastMotion(path.moves, path.exact, path.plan, path)
    check_triggers(state, at, step)
    return Span(path.plan.duration_s, path.plan.duration_s)


def _note_bare_speed(state: ForecastState, step: FollowPath) -> None:
    """In a move a bare number below 1 is a fraction of the limits; on a path it is a speed, and a slow one."""
    speeds = [
        speed for speed in (step.speed, *(piece.speed for piece in step.pieces)) if isinstance(speed, int | float)
    ]
    slowest = min(speeds, default=1.0)
    if slowest < 1:
        frame = None if step.frame is None else state.fleet.path_frames.get(step.frame)
        unit = state.fleet.axis(step.axes[0]).unit if frame is None else frame.unit
        percent = f'"{100 * slowest:g} %"'
        state.notes[
            f"speed {slowest:g} is {slowest:g} {unit}/s along the path; "
            f"if a part of what its axes allow is meant, write {percent}"
        ] = None


def _find_starts(
    state: ForecastState, at: ForecastContext, step: FollowPath, axes: Mapping[str, Axis], base: Mapping[str, Fraction]
) -> list[PathStart]:
    """Where the axes of a path are before it: an axis whose position is not known must be at its start. base: see
    `_list_bases`."""
    starts: list[PathStart] = []
    begin = find_start(step, [axis.unit for axis in axes.values()], state.fleet.path_frames)
    for value, point, (name, axis) in zip(step.start, begin, axes.items(), strict=True):
        state_before = state.find_state(at, name)
        motor_here, offset = state_before.motor, state_before.offset
        if name in base:
            motor_here, offset = motor_here + base[name], offset - base[name]
        elif not state_before.known or state_before.offset_kind != "motor":
            position_text = value if step.frame is None else f"{float(point):.6g} {axis.unit}"
            state.notes[f"{name} stands at {position_text} when the path begins"] = None
            motor_here = point - offset
        starts.append(make_path_start(state, name, motor_here, offset))
    return starts


def make_path_start(state: ForecastState, name: str, motor: Fraction, offset: Fraction) -> PathStart:
    """The start of an axis of a path at a motor position."""
    axis = state.fleet.axis(name)
    return PathStart(name, axis, motor, axis.to_counts(motor), offset, state.orders.get(controller_of(name), 3))
