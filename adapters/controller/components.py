"""The components of one controller's supervisor, with what each is built from."""

from dataclasses import dataclass

from adapters.controller.manual.jogging import JogControl
from adapters.controller.manual.motors import MotorControl
from adapters.controller.manual.probing import AxisProbing
from adapters.controller.manual.referencing import AxisReferencing
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.monitoring.surveillance import Surveillance
from adapters.controller.pending_stop import PendingStop
from adapters.controller.publishing.publisher import StatePublisher, StateSources
from adapters.controller.slots.participant import StepParticipant
from adapters.controller.slots.parts import StepParts
from adapters.controller.slots.path_chunks import PathChunks
from adapters.controller.slots.present_motion import PresentMotion
from adapters.controller.slots.retargets import MoveRetargets
from adapters.controller.slots.sampling import SampleCollection
from adapters.controller.slots.step_checks import StepChecks
from adapters.controller.slots.step_events import StepEvents
from adapters.controller.slots.triggers import TriggerCollection
from adapters.controller.slots.withdrawal import StepWithdrawal
from adapters.controller.state.background import BackgroundTasks
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.defects import DefectRecord
from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.leases import MotionLeases
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.poll_timer import PollTimer
from adapters.controller.state.status import ControllerStatus
from adapters.controller.state.store import PersistentMemory


@dataclass(frozen=True, slots=True)
class Components:
    """The components of one controller. remembered: its e-stop latch, epoch and offsets."""

    remembered: PersistentMemory
    fence: EpochFence
    status: ControllerStatus
    leases: MotionLeases
    timer: PollTimer
    defects: DefectRecord
    tasks: BackgroundTasks
    publisher: StatePublisher
    polling: StatePolling
    pending_stop: PendingStop
    steps: LoadedSteps
    participant: StepParticipant
    withdrawal: StepWithdrawal
    settling: SettlingMonitor
    chunks: PathChunks
    retargets: MoveRetargets
    samples: SampleCollection
    triggers: TriggerCollection
    surveillance: Surveillance
    jogging: JogControl
    motors: MotorControl
    referencing: AxisReferencing
    probing: AxisProbing


def build_components(context: ControllerContext, remembered: PersistentMemory) -> Components:
    """Build the components of a controller, each from those before it."""
    driver, clock = context.driver, context.clock
    fence, status, steps = EpochFence(remembered), ControllerStatus(context.config), LoadedSteps(driver)
    leases, timer = MotionLeases(context), PollTimer(clock, context.poll_grid_ns)
    defects = DefectRecord(context.log, context.controller)
    tasks = BackgroundTasks(context, defects, timer)
    publisher = StatePublisher(context, StateSources(fence, remembered, status, steps, leases))
    polling = StatePolling(context, status, steps, publisher, timer)
    settling = SettlingMonitor(clock, status, polling)
    surveillance = Surveillance(context, status, steps, publisher)
    events = StepEvents(publisher, timer)
    withdrawal = StepWithdrawal(context, steps, settling, events)
    step_parts = StepParts(
        steps=steps, withdrawal=withdrawal, settling=settling, surveillance=surveillance, events=events, tasks=tasks
    )
    present = PresentMotion(context, steps, fence, leases, status)
    jogging = JogControl(driver, clock, status, tasks, timer)
    jogging.find_reach, jogging.find_room = leases.find_reach, leases.find_room
    leases.is_jogging = status.jogging.__contains__
    return Components(
        remembered=remembered,
        fence=fence,
        status=status,
        leases=leases,
        timer=timer,
        defects=defects,
        tasks=tasks,
        publisher=publisher,
        polling=polling,
        pending_stop=PendingStop(context, steps),
        steps=steps,
        participant=StepParticipant(context, step_parts, StepChecks(context.config, fence, status, leases)),
        withdrawal=withdrawal,
        settling=settling,
        chunks=PathChunks(present),
        retargets=MoveRetargets(present),
        samples=SampleCollection(context, status, steps),
        triggers=TriggerCollection(context, status, steps),
        surveillance=surveillance,
        jogging=jogging,
        motors=MotorControl(context, status, settling, polling),
        referencing=AxisReferencing(driver, settling, status, publisher, polling),
        probing=AxisProbing(context, status, polling, settling),
    )
