"""The services that jobs need."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from orchestrator.bus.base import Bus, BusSample, RequestRefused
from orchestrator.bus.decoding import MAX_AT_ONCE, read_request, read_request_parts
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import Clock
from orchestrator.clock.collection import CollectionPause, exempt_objects
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.coordinator.fleet.positions import PositionBook
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.fleet.virtual_states import VirtualObserver
from orchestrator.coordinator.fleet.zone_states import ZoneObserver
from orchestrator.coordinator.journal.grouped_calls import RecordLater
from orchestrator.coordinator.journal.records import DamagedRecord
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.copies import CopyWatch
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.statistics.collector import StatisticsCollector
from orchestrator.model.base import Model
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import dump_long, has_long_path, join_value, split_value
from orchestrator.model.messages import Request
from orchestrator.model.operation.approval import JobApproval
from orchestrator.model.report import JobState, JobTransition


@dataclass(frozen=True, slots=True)
class JobServices:
    """The services that jobs need. execute: calls the journal. record_later: the same with the next call, where nothing
    waits for the record."""

    bus: Bus
    keys: FleetKeys
    clock: Clock
    journal: JournalStore
    execute: Executor
    record_later: RecordLater
    decode: Executor
    check: Executor
    view: FleetView
    fleet: FleetAccess
    motion: MotionServices
    leases: LeaseRegistry
    positions: PositionBook
    virtual: VirtualObserver
    zones: ZoneObserver
    alarms: AlarmRegister
    statistics: StatisticsCollector
    leadership: Leadership
    copies: CopyWatch
    log: ProcessLog

    def make_transition(self, state: JobState, reason: str, actor: str) -> JobTransition:
        """A change of a job's state, now."""
        fleet_ns = self.leadership.fleet_now_ns()
        return JobTransition(state=state, reason=reason, actor=actor, utc=self.clock.utc(), fleet_ns=fleet_ns)

    async def load_job(self, job_id: str) -> Job | None:
        """A job of the journal. A large one is read by another process. Raises `DamagedRecord`, `JournalError`."""
        body = await self.execute(self.journal.load_job_body, job_id)
        if body is None:
            return None
        try:
            if len(body) <= MAX_AT_ONCE:
                return Job.read_stored(body)
            return await join_parts(await self.decode(_read_job_parts, body))
        except (ValueError, Refusal):  # the journal says what is wrong
            return await self.execute(self.journal.load_job, job_id)

    async def dump_model(self, model: Model) -> bytes:
        """The JSON of a model that may have a long job."""
        return await self.execute(dump_long, model) if has_long_path(model) else model.to_json()

    async def read_request(self, model: type[Request], sample: BusSample, prefix: str) -> Request:
        """A request; a large one is read by another process, beside which heartbeats and stops go on. prefix: begins
        the text of a refusal. Raises `RequestRefused`."""
        if len(sample.payload) <= MAX_AT_ONCE:
            return read_request(model, sample, prefix, "")
        try:
            return await join_parts(await self.decode(read_request_parts, model, sample, prefix, ""))
        except Refusal as error:
            raise RequestRefused(f"{prefix}{error.text}; {error.remedy}") from None

    async def load_approval(self, job_id: str) -> JobApproval | None:
        """The last approval of a job, also one that is void. One that cannot be read is logged, and counts as none.
        Raises `JournalError`."""
        try:
            return await self.execute(self.journal.approvals.load_approval, job_id)
        except DamagedRecord as error:
            self.log.warning(str(error), job=job_id)
            return None


async def join_parts(parts: Sequence[bytes]) -> Any:
    """Make a value of its parts again, with a turn for all other work between two of them."""
    work = join_value(parts)
    with CollectionPause():
        while True:
            try:
                next(work)
            except StopIteration as end:
                exempt_objects()
                return end.value
            await asyncio.sleep(0)


def _read_job_parts(body: str) -> list[bytes]:
    """A job of the journal, as parts, in another process. Raises `ValueError`."""
    return split_value(Job.read_stored(body))
