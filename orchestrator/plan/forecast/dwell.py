"""The forecast of a pause."""

from orchestrator.model.steps.dwell import Dwell
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState


def forecast_dwell(state: ForecastState, at: ForecastContext, step: Dwell) -> Span:
    """A pause takes its duration; one that counts from the beginning of the job takes what is left of it, if any."""
    del state, at
    return Span(0.0 if step.since_begin else step.duration / 1e9, step.duration / 1e9)
