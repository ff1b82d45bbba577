"""The forecast of a position that an input captures."""

from orchestrator.model.errors import Refusal
from orchestrator.model.numbers import format_ns
from orchestrator.model.steps.latch import Latch
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.play import require_no_play


def forecast_latch(state: ForecastState, at: ForecastContext, step: Latch) -> Span:
    """An input captures a position within its timeout."""
    axis = state.find_axis(at, step.axis, ("axis",))
    try:
        if axis is not None:
            require_no_play(step.axis, axis, "latch")
    except Refusal as error:
        state.add_problem(at, ("axis",), error)
    state.check_name(at, step.input, "input")
    state.notes[f"input {step.input} latches {step.axis} within {format_ns(step.timeout)}"] = None
    return Span(0.0, step.timeout / 1e9)
