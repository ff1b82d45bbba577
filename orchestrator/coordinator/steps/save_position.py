"""A position is saved under a name."""

from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.model.positions.entries import SavePosition as SaveRequest
from orchestrator.model.steps.save_position import SavePosition


async def run_save_position(context: StepContext, step: SavePosition) -> ReportFields:
    """Save a position. Raises `Refusal`, `UnknownName`, `JournalError`."""
    request = SaveRequest(
        request_id=context.request_fields["request_id"],
        actor=context.actor,
        name=step.position,
        axes=[axis for axis, value in step.axes.items() if value is None],
        values={axis: value for axis, value in step.axes.items() if value is not None},
        description=step.description,
    )
    await context.positions.save_position(request)
    return {}
