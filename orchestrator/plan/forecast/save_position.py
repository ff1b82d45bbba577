"""The forecast of a position that is saved: its name, and the whole range of what it may be."""

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet_names import explain_position_name
from orchestrator.model.steps.save_position import SavePosition
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.measured import check_measured
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import check_target


def forecast_save_position(state: ForecastState, at: ForecastContext, step: SavePosition) -> Span:
    """Check what a position would have; nothing moves."""
    text = explain_position_name(step.position, state.fleet.names)
    if text is not None:
        state.add_problem(at, ("position",), Refusal("bad-name", text, "choose another name"))
    check_measured(state, at, step, "axes", f"{step.position} has")
    for name, value in step.axes.items():
        axis = state.find_axis(at, name, ("axes", name))
        if axis is None:
            continue
        if value is None:
            state.require_referenced(at, name, ("axes", name), f"axis {name} is not referenced")
            continue
        field, state_before = TargetField("axes", name, axis), state.find_state(at, name)
        amount = state.parse_amount(at, value, field)
        # On an axis that wraps, a position exists once in each turn.
        if amount is not None and state_before.offset_kind == "motor" and axis.turn_length is None:
            check_target(state, at, field, amount - state_before.offset, state_before.offset)
    return Span()
