"""Outputs are switched, and inputs are waited for."""

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import OutputRequest
from orchestrator.model.names import split_name
from orchestrator.model.numbers import format_ns
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.wait_armed import WaitArmed

INPUT_POLL_NS = 20 * NS_PER_MS


async def run_output(context: StepContext, step: SetOutput) -> ReportFields:
    """Switch an output; with a pulse, back after its time. Raises `Refusal`."""
    controller, output = split_name(step.output)
    request = OutputRequest(**context.request_fields, output=output, value=step.value)
    try:
        await context.request_all("output", {controller: request})
        if step.pulse is not None:
            await sleep_ns(context.fleet.clock, step.pulse)
    finally:
        # Also when the job ends meanwhile: a pulse that does not end may be a shutter that stays open.
        if step.pulse is not None:
            reset_request = OutputRequest(**context.request_fields, output=output, value=not step.value)
            await context.request_all("output", {controller: reset_request})
    return {}


async def run_wait(context: StepContext, step: WaitInput) -> ReportFields:
    """Wait for an input. Raises `Refusal`, code `wait-timeout`."""
    controller, name = split_name(step.input)
    view, clock = context.fleet.view, context.fleet.clock
    until_ns = clock.now_ns() + step.timeout
    while True:
        state = view.last_state(controller)
        if state is not None and not view.is_silent(controller) and state.inputs.get(name) == step.value:
            return {}
        if clock.now_ns() >= until_ns:
            level = "active" if step.value else "inactive"
            text = f"input {step.input} did not become {level} within {format_ns(step.timeout)}"
            raise Refusal("wait-timeout", text, "", controller)
        await sleep_ns(clock, INPUT_POLL_NS)


async def run_wait_armed(context: StepContext, step: WaitArmed) -> ReportFields:
    """Nothing: the motion behind it waits once it is loaded (`motion/armed_start.py`), and has the wait in its
    report."""
    del context, step
    return {}
