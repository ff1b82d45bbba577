"""The parts that load, follow and withdraw the steps of one controller, and what they share."""

from dataclasses import dataclass

from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.monitoring.surveillance import Surveillance
from adapters.controller.slots.step_events import StepEvents
from adapters.controller.slots.withdrawal import StepWithdrawal
from adapters.controller.state.background import BackgroundTasks
from adapters.controller.state.loaded_steps import LoadedSteps


@dataclass(frozen=True, slots=True)
class StepParts:
    """What loading and following share."""

    steps: LoadedSteps
    withdrawal: StepWithdrawal
    settling: SettlingMonitor
    surveillance: Surveillance
    events: StepEvents
    tasks: BackgroundTasks
