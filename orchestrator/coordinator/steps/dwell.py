"""A pause."""

from orchestrator.clock.base import sleep_ns
from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.model.steps.dwell import Dwell


async def run_dwell(context: StepContext, step: Dwell) -> ReportFields:
    """Wait for the duration of a step, or what is left of it since the job has begun."""
    clock = context.fleet.clock
    elapsed_ns = clock.now_ns() - context.begun_ns if step.since_begin else 0
    await sleep_ns(clock, max(0, step.duration - elapsed_ns))
    return {}
