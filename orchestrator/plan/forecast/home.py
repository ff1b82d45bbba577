"""The forecast of a homing."""

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.home import Home
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.zones import check_homing
from orchestrator.plan.homing_order import find_prerequisites, homing_order


def forecast_home(state: ForecastState, at: ForecastContext, step: Home) -> Span:
    """Run a homing forward."""
    names = step.axes
    if names is not None:
        state.expand_names(at, names, ("axes",))
        names = [name for name in names if state.fleet.names.explain_unknown(name, "axes") is None]
    order = homing_order(state.fleet, names)
    try:
        waits = find_prerequisites(state.fleet, order)
    except Refusal as error:
        state.add_problem(at, (), Refusal(error.code, error.text, error.remedy))
        return Span()
    check_homing(state, at, order)
    for axis, predecessors in waits.items():
        for predecessor in sorted(predecessors - waits.keys()):
            text = f"{axis} must be homed after {predecessor} (homing.after), which is not referenced"
            state.require_referenced(at, predecessor, (), text)
    for axis in waits:
        state.require_enabled(at, axis, ())
        state_before = state.find_state(at, axis)
        state.note_room(axis, state_before)
        kind = "unknown" if state_before.offset_kind == "start" else state_before.offset_kind
        state.axes[axis] = state_before.model_copy(
            update={
                "motor": state.fleet.axis(axis).to_position(0),
                "known": True,
                "referenced": True,
                "offset_kind": kind,
                "play": None,
            }
        )
    entries = [*order.entries, *([axis] for axis in order.loners)]
    most = sum(max(state.fleet.axis(axis).homing.timeout_s for axis in entry) for entry in entries)
    state.notes[f"the reference is found within {most:g} s"] = None
    return Span(0.0, most)
