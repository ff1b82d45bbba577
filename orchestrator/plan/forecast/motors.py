"""The forecast of motors that are switched on or off."""

from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState


def forecast_motors(state: ForecastState, at: ForecastContext, step: Enable | Disable) -> Span:
    """Switch motors on paper, with the delays of their brakes."""
    axes = state.expand_names(at, step.axes, ("axes",))
    for axis in axes:
        state.axes[axis] = state.find_state(at, axis).model_copy(update={"enabled": step.enables})
    brakes = [brake for axis in axes if (brake := state.fleet.axis(axis).brake) is not None]
    longest_s = max((brake.release_s if step.enables else brake.engage_s for brake in brakes), default=0.0)
    return Span(longest_s, longest_s)
