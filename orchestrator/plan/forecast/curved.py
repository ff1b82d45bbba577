"""The forecast of a move of curved virtual axes that stand for several real ones."""

from orchestrator.model.errors import Refusal
from orchestrator.model.names import controller_of
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.numbers import name_step
from orchestrator.plan.curved_move import CurvedMove, plan_curved_move
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.motion import check_triggers
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.virtual import find_positions
from orchestrator.plan.forecast.ways import ForecastMotion
from orchestrator.plan.path_step import PathStart
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
    try:
        path = plan_curved_move(curved_step, _find_starts(state, at, curved_step), state.fleet)
    except PlanError as error:
        state.add_problem(at, field, Refusal("plan", str(error)))
        state.lose_positions(at, curved_step.axes)
        return Span()
    except Refusal as error:
        state.add_problem(at, field, Refusal(error.code, error.text, error.remedy, error.controller))
        state.lose_positions(at, curved_step.axes)
        return Span()
    for name, (end, _) in path.exact.items():
        state.axes[name] = state.find_state(at, name).model_copy(update={"motor": end, "known": True})
    state.motion = ForecastMotion(path.moves, path.exact, path.plan, path)
    check_triggers(state, at, curved_step)
    return Span(path.plan.duration_s, path.plan.duration_s)


def _find_starts(state: ForecastState, at: ForecastContext, step: CurvedMove) -> list[PathStart]:
    """Where its real axes are before it, which is known."""
    starts: list[PathStart] = []
    for name in step.axes:
        axis, state_before = state.fleet.axis(name), state.find_state(at, name)
        motor_counts = axis.to_counts(state_before.motor)
        order = state.orders.get(controller_of(name), 3)
        starts.append(PathStart(name, axis, state_before.motor, motor_counts, state_before.offset, order))
    return starts
