"""The forecasts of outputs that are switched, and inputs that are waited for."""

from orchestrator.model.errors import Refusal
from orchestrator.model.numbers import format_ns
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.wait_armed import WaitArmed
from orchestrator.plan.forecast.context import ForecastContext
from orchestrator.plan.forecast.span import Span
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.triggers import find_brake_outputs


def forecast_output(state: ForecastState, at: ForecastContext, step: SetOutput) -> Span:
    """Switch an output on paper."""
    exists = state.check_name(at, step.output, "output")
    reserved_outputs = find_brake_outputs(state.fleet)
    if exists and step.output in reserved_outputs:
        purpose = reserved_outputs[step.output]
        text = f"output {step.output} is {purpose}, which switches it by itself"
        remedy = "use another output, or remove that use from the fleet file"
        state.add_problem(at, ("output",), Refusal("output-in-use", text, remedy))
    elif exists and state.outputs.get(step.output) == step.value:
        state.notes[f"{step.output} is {'active' if step.value else 'inactive'} already"] = None
    wired_inputs = [end for wire in state.fleet.wiring if wire.from_ == step.output for end in wire.to]
    if step.value and wired_inputs:
        state.notes[f"no controller waits for {', '.join(wired_inputs)}, which the output is wired to"] = None
    state.outputs[step.output] = step.value if step.pulse is None else not step.value
    pulse_s = (step.pulse or 0) / 1e9
    return Span(pulse_s, pulse_s)


def forecast_wait(state: ForecastState, at: ForecastContext, step: WaitInput) -> Span:
    """An input changes within its timeout, which only the machine knows."""
    state.check_name(at, step.input, "input")
    level = "active" if step.value else "inactive"
    state.notes[f"input {step.input} becomes {level} within {format_ns(step.timeout)}"] = None
    return Span(0.0, step.timeout / 1e9)


def forecast_wait_armed(state: ForecastState, at: ForecastContext, step: WaitArmed) -> Span:
    """The motion behind it starts on a request, or by an input, within its timeout."""
    occasion = "a request to start comes"
    if step.input is not None and state.check_name(at, step.input, "input"):
        occasion = f"input {step.input} becomes {'active' if step.value else 'inactive'}, or {occasion}"
    state.notes[f"{occasion} within {format_ns(step.timeout)}"] = None
    return Span(0.0, step.timeout / 1e9)
