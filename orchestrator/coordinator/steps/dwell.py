"""A pause."""

from orchestrator.clock.base import sleep_ns
from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.model.steps.dwell import Dwell


async def run_dwell(context: StepContext, step: Dwell) -> ReportFields:
    """Wait for the duration of a step."""
    await sleep_ns(context.fleet.clock, step.duration)
    return {}
