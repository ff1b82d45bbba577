"""Motors are switched on and off, with their brakes."""

from collections.abc import Sequence

from orchestrator.coordinator.steps.context import ANSWER_S, ReportFields, StepContext
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.messages import EnableRequest
from orchestrator.model.steps.motors import Disable, Enable


async def run_motors(context: StepContext, step: Enable | Disable) -> ReportFields:
    """Switch the motors of a step. Raises `Refusal`."""
    await switch_motors(context, context.fleet.view.fleet.expand_names(step.axes), on=step.enables)
    return {}


async def switch_motors(context: StepContext, axes: Sequence[str], *, on: bool) -> None:
    """Switch the motors of `axes`, with their brakes. Raises `Refusal`."""
    requests = {
        member: EnableRequest(**context.request_fields, axes=names, on=on, holder=context.holder)
        for member, names in group_by_controller(axes).items()
    }
    brakes = [brake for axis in axes if (brake := context.fleet.view.fleet.axis(axis).brake) is not None]
    longest_s = max((brake.release_s if on else brake.engage_s for brake in brakes), default=0.0)
    await context.request_all("enable", requests, ANSWER_S + longest_s)
