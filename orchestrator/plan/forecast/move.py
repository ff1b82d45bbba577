"""The forecast of a move."""

from orchestrator.model.errors import Refusal
from orchestrator.model.names import ALL_AXES
from orchestrator.model.steps.move import Move
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.curved import forecast_curved
from orchestrator.plan.forecast.measured import take_measured
from orchestrator.plan.forecast.motion import check_record, check_triggers, plan_ways
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import take_target
from orchestrator.plan.forecast.virtual import take_virtual_targets
from orchestrator.plan.forecast.ways import ForecastMotion, MoveWays
from orchestrator.plan.forecast.zones import check_move
from orchestrator.plan.play import require_play
from orchestrator.plan.virtual_moves import find_curved_group, find_virtual_names, go_straight


def forecast_move(state: ForecastState, at: ForecastContext, step: Move) -> Span:
    """Run a move forward."""
    check_record(state, at, step)
    if step.measured:
        take_measured(state, at, step, "to")
        return _forecast_rest(state, at, step.with_measured({}))
    unknown = state.note_unknown_positions(step)
    if unknown:
        named_axes = state.find_named(at, [axis for axis in unknown if axis != ALL_AXES], "to")
        state.lose_positions(at, list(state.axes) if ALL_AXES in unknown else named_axes)
        known_targets = {axis: to for axis, to in step.to.items() if axis not in unknown}
        return _forecast_rest(state, at, step.model_copy(update={"to": known_targets}))
    try:
        require_play(state.fleet, step)
    except Refusal as error:
        state.add_problem(at, ("approach",), error)
    group = find_curved_group(state.fleet, step)
    if group is not None:
        return forecast_curved(state, at, step, group)
    ways = MoveWays(step.approach)
    if not take_virtual_targets(state, at, ways, step):
        return Span()
    _take_real_targets(state, at, ways, step)
    span = plan_ways(state, at, go_straight(state.fleet, step), ways)
    check_move(state, at, step, ways)
    if ways.plan is not None and len(ways.exact) == len(step.find_axes(state.fleet)):
        state.motion = ForecastMotion(ways.nearest, ways.exact, ways.plan)
    check_triggers(state, at, step)
    return span


def _forecast_rest(state: ForecastState, at: ForecastContext, step: Move) -> Span:
    """Run a move forward that is left without targets that are not known: it takes at least as long."""
    with state.without_zones():  # the axes that were left out move, too
        least_s = forecast_move(state, at, step).least if step.to or step.by else 0.0
    state.zones_checked = False
    return Span(least_s, None)


def _take_real_targets(state: ForecastState, at: ForecastContext, ways: MoveWays, step: Move) -> None:
    """Move the axes that the step names, but for virtual ones, and add their ways."""
    virtual_names = find_virtual_names(state.fleet, step)
    for name, value in (step.to | step.by).items():
        if name in virtual_names:
            continue
        key = ("by" if name in step.by else "to", name)
        axis = state.find_axis(at, name, key, "target")
        if axis is None:
            continue
        field = TargetField(*key, axis)
        amount = state.parse_amount(at, value, field)
        if amount is not None:
            state.require_ready(at, name, key)
            take_target(state, at, ways, field, amount)
