"""What runs each kind of step that is no motion."""

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.coordinator.steps.dwell import run_dwell
from orchestrator.coordinator.steps.home import run_home
from orchestrator.coordinator.steps.io import run_output, run_wait, run_wait_armed
from orchestrator.coordinator.steps.latch import run_latch
from orchestrator.coordinator.steps.motors import run_motors
from orchestrator.coordinator.steps.probe import run_probe
from orchestrator.coordinator.steps.save_position import run_save_position
from orchestrator.coordinator.steps.set_position import run_set_position
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.latch import Latch
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.save_position import SavePosition
from orchestrator.model.steps.set_position import SetPosition
from orchestrator.model.steps.wait_armed import WaitArmed
from orchestrator.plan.pairs import require_whole_pairs
from orchestrator.plan.zones.sweeps import require_swept

RUNNERS: Mapping[type[Step], Callable[[StepContext, Any], Awaitable[ReportFields]]] = {
    Home: run_home,
    Enable: run_motors,
    Disable: run_motors,
    SetPosition: run_set_position,
    SavePosition: run_save_position,
    Dwell: run_dwell,
    SetOutput: run_output,
    WaitInput: run_wait,
    WaitArmed: run_wait_armed,
    Latch: run_latch,
    Probe: run_probe,
}
"""By kind. Motions are run by the chain of their job (`jobs/motion_chain.py`); repeats and scans consist of others."""


async def run_step(context: StepContext, step: Step) -> ReportFields:
    """Run a step to its end; return what its kind adds to the report. Raises `Refusal` if it cannot be done."""
    require_whole_pairs(context.fleet.view.fleet, step)
    require_swept(context.fleet.view.fleet, step)
    return await RUNNERS[type(step)](context, step)
