"""The services that motion steps need."""

from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.clock.executor import Executor, run_inline
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.zone_reservations import ZoneReservations
from orchestrator.coordinator.fleet.zones import ZoneGuard
from orchestrator.coordinator.journal.grouped_calls import RecordLater
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.coordinator.motion.lead_time import LeadTimeEstimator
from orchestrator.coordinator.motion.publisher import StepPublisher
from orchestrator.model.report import StepRecording, StepReport
from orchestrator.plan.step import ExactTargets
from orchestrator.plan.zones.memory import ZoneMemory

MotionListener = Callable[[StepRecording, StepReport | None], None]
"""Called when a motion step is over, with what was recorded of it and its report; None: it was interrupted."""


@dataclass(frozen=True, slots=True)
class MotionServices:
    """Services and memory that the steps of one coordinator share.

    execute: calls the journal; record_later: with the next call, where nothing waits for the record. plan: plans paths,
    which may take seconds; plan_long: those with so many pieces that it takes a gigabyte. estimator: lead times of
    earlier steps. zone_memory: the rules of their zones;
    zone_reservations: where running jobs may move axes of them.
    targets: exact targets of axes. stop_times_ns: by controller, how long stopping its last step takes at most.
    listeners: called after each step.
    """

    fleet: FleetAccess
    leadership: Leadership
    journal: JournalStore
    execute: Executor
    record_later: RecordLater
    publisher: StepPublisher
    plan: Executor = run_inline
    plan_long: Executor = run_inline
    estimator: LeadTimeEstimator = field(default_factory=LeadTimeEstimator)
    zone_memory: ZoneMemory = field(default_factory=ZoneMemory)
    zone_reservations: ZoneReservations = field(default_factory=ZoneReservations)
    targets: ExactTargets = field(default_factory=ExactTargets)
    stop_times_ns: dict[str, int] = field(default_factory=dict[str, int])
    listeners: list[MotionListener] = field(default_factory=list[MotionListener])

    @property
    def zones(self) -> ZoneGuard:
        """The check against zones."""
        return ZoneGuard(self.fleet.view, self.zone_memory, self.zone_reservations, self.plan)
