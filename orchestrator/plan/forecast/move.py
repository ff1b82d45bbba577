"""The forecast of a move."""

from orchestrator.model.names import ALL_AXES
from orchestrator.model.steps.move import Move
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.motion import check_record, check_triggers, plan_ways
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import take_target
from orchestrator.plan.forecast.ways import ForecastMotion, MoveWays


def forecast_move(state: ForecastState, at: ForecastContext, step: Move) -> Span:
    """Run a move forward."""
    check_record(state, at, step)
    unknown = state.note_unknown_positions(step)
    if unknown:
        named_axes = [
            axis for axis in unknown if axis != ALL_AXES and state.find_axis(at, axis, ("to", axis)) is not None
        ]
        state.lose_positions(at, list(state.axes) if ALL_AXES in unknown else named_axes)
        known_move = step.model_copy(update={"to": {axis: to for axis, to in step.to.items() if axis not in unknown}})
        return Span(forecast_move(state, at, known_move).least if known_move.to or known_move.by else 0.0, None)
    ways = MoveWays()
    for name, value in (step.to | step.by).items():
        key = ("by" if name in step.by else "to", name)
        axis = state.find_axis(at, name, key)
        if axis is None:
            continue
        field = TargetField(*key, axis)
        amount = state.parse_amount(at, value, field)
        if amount is not None:
            state.require_ready(at, name, key)
            take_target(state, at, ways, field, amount)
    span = plan_ways(state, at, step, ways)
    if ways.plan is not None and len(ways.exact) == len(step.to) + len(step.by):
        state.motion = ForecastMotion(ways.nearest, ways.exact, ways.plan)
    check_triggers(state, at, step)
    return span
