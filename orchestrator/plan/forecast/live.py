"""The forecast of a live step."""

from orchestrator.model.steps.live import Live
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState


def forecast_live(state: ForecastState, at: ForecastContext, step: Live) -> Span:
    """What its program will ask for is not known ahead; its names are checked."""
    state.expand_names(at, step.axes, ("axes",))
    for output in step.outputs:
        state.check_name(at, output, "output")
    state.notes["its moves are asked for while it runs"] = None
    return Span(0.0, None)
