"""The services that jobs need."""

from dataclasses import dataclass

from orchestrator.bus.base import Bus
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import Clock
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.coordinator.fleet.positions import PositionBook
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.journal.records import DamagedRecord
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.statistics.collector import StatisticsCollector
from orchestrator.model.operation.approval import JobApproval
from orchestrator.model.report import JobState, JobTransition


@dataclass(frozen=True, slots=True)
class JobServices:
    """The services that jobs need."""

    bus: Bus
    keys: FleetKeys
    clock: Clock
    journal: JournalStore
    execute: Executor
    view: FleetView
    fleet: FleetAccess
    motion: MotionServices
    leases: LeaseRegistry
    positions: PositionBook
    alarms: AlarmRegister
    statistics: StatisticsCollector
    leadership: Leadership
    log: ProcessLog

    def make_transition(self, state: JobState, reason: str, actor: str) -> JobTransition:
        """A change of a job's state, now."""
        fleet_ns = self.leadership.fleet_now_ns()
        return JobTransition(state=state, reason=reason, actor=actor, utc=self.clock.utc(), fleet_ns=fleet_ns)

    async def load_approval(self, job_id: str) -> JobApproval | None:
        """The last approval of a job, also one that is void. One that cannot be read is logged, and counts as none.
        Raises `JournalError`."""
        try:
            return await self.execute(self.journal.approvals.load_approval, job_id)
        except DamagedRecord as error:
            self.log.warning(str(error), job=job_id)
            return None
