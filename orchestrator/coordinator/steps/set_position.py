"""User positions are set, axis by axis."""

from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.model.messages import SetPositionRequest
from orchestrator.model.names import split_name
from orchestrator.model.steps.set_position import SetPosition


async def run_set_position(context: StepContext, step: SetPosition) -> ReportFields:
    """Set user positions. Raises `Refusal`."""
    for axis, position in step.axes.items():
        controller, name = split_name(axis)
        context.targets.forget_target(axis)
        request = SetPositionRequest(**context.request_fields, axes=[name], holder=context.holder, position=position)
        await context.request_all("set-position", {controller: request})
    return {}
