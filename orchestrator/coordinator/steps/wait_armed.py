"""A wait for the start of the motion behind it, in which that is loaded."""

from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.model.steps.wait_armed import WaitArmed


async def run_wait_armed(context: StepContext, step: WaitArmed) -> ReportFields:
    """Nothing: the motion behind it waits once it is loaded (`motion/armed_start.py`), and has the wait in its
    report."""
    del context, step
    return {}
