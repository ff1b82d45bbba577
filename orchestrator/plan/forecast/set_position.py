"""The forecast of user positions that are set."""

from fractions import Fraction

from orchestrator.model.steps.set_position import SetPosition
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState


def forecast_set_position(state: ForecastState, at: ForecastContext, step: SetPosition) -> Span:
    """Set user positions on paper."""
    for name in step.measured:
        if state.find_axis(at, name, ("axes", name)) is not None:
            state.axes[name] = state.find_state(at, name).model_copy(update={"offset_kind": "unknown"})
    for name, value in step.axes.items():
        field = ("axes", name)
        axis = state.find_axis(at, name, field)
        if axis is None:
            continue
        amount = Fraction(0) if value is None else state.parse_amount(at, value, TargetField(*field, axis))
        if amount is None:
            continue
        state_before = state.find_state(at, name)
        update: dict[str, object] = {"offset": Fraction(0), "offset_kind": "motor"}
        if value is not None:
            update = {"offset": amount - state_before.motor, "offset_kind": "motor" if state_before.known else "start"}
        state.axes[name] = state_before.model_copy(update=update)
    return Span()
