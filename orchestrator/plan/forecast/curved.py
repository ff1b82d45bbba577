"""The forecast of a move of curved virtual axes that stand for several real ones."""

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.numbers import name_step
from orchestrator.plan.curved_move import CurvedMove, plan_curved_move
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.path import make_path_start, take_path
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.virtual import find_positions
from orchestrator.plan.forecast.zones import check_path
from orchestrator.plan.shape import PlanError


def forecast_curved(state: ForecastState, at: ForecastContext, step: Move, group: str) -> Span:
    """Run a move of a curved group forward."""
    curved_step = CurvedMove.make(state.fleet, step, group)
    field = ("by" if step.by else "to", next(iter(step.by or step.to)))
    for name in curved_step.axes:
        state.require_ready(at, name, field)
    positions = find_positions(state, at, curved_step.axes)
    if positions is None:
        condition = f"the way of {group} in {name_step(at.index)} depends on where {', '.join(curved_step.axes)} stand"
        state.conditions[condition] = None
        state.lose_positions(at, curved_step.axes)
        return Span(0.0, None)
    states = [state.find_state(at, name) for name in curved_step.axes]
    starts = [
        make_path_start(state, name, axis.motor, axis.offset)
        for name, axis in zip(curved_step.axes, states, strict=True)
    ]
    try:
        path = plan_curved_move(curved_step, starts, state.fleet)
    except (PlanError, Refusal) as error:
        state.add_problem(at, field, error if isinstance(error, Refusal) else Refusal("plan", str(error)))
        state.lose_positions(at, curved_step.axes)
        return Span()
    check_path(state, at, step, path, {})
    return take_path(state, at, curved_step, path)
