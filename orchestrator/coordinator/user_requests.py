"""Requests of users to the leader: one table of verbs, and one place where an error becomes a reply."""

from collections.abc import Awaitable, Callable
from typing import Any, NamedTuple

from pydantic import ValidationError

from orchestrator.bus.answers import AnswerCache
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.keys import FleetKeys
from orchestrator.coordinator.command_log import CommandLog
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.coordinator.fleet.manual import ManualLeases
from orchestrator.coordinator.jobs.approval import JobApprovals
from orchestrator.coordinator.jobs.intake import JobIntake
from orchestrator.coordinator.jobs.job_run import JobInterrupted, JobServices
from orchestrator.coordinator.jobs.rehearsal import JobRehearsal
from orchestrator.coordinator.jobs.scheduler import Scheduler
from orchestrator.coordinator.journal.records import DamagedRecord, JournalError
from orchestrator.coordinator.maintenance.epochs import EpochRepair
from orchestrator.coordinator.maintenance.reload import FleetReload
from orchestrator.coordinator.maintenance.wiring import WiringCheck
from orchestrator.model.base import Model, UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import RefusalDetails, Reply, Request
from orchestrator.model.operation.alarms import (
    AcknowledgeAlarms,
    AlarmsAcknowledged,
    AlarmShelved,
    AlarmsListed,
    ListAlarms,
    ShelveAlarm,
)
from orchestrator.model.operation.approval import ApproveJob, JobPlanned
from orchestrator.model.operation.commands import CommandsListed, ListCommands
from orchestrator.model.operation.statistics import ReadStatistics, StatisticsRead
from orchestrator.model.positions.entries import (
    PositionRemoved,
    PositionSaved,
    PositionsListed,
    RemovePosition,
    SavePosition,
)
from orchestrator.model.report import QueueState
from orchestrator.model.service import (
    AcquireAxes,
    AxesAcquired,
    DryRun,
    DryRunDone,
    EpochRepaired,
    FindJob,
    FleetLoaded,
    FleetNames,
    FleetReloaded,
    JobReference,
    JobReferences,
    JobRetried,
    JobsFound,
    JobShown,
    JobsPruned,
    JobSubmitted,
    ListJobs,
    PauseJob,
    PointsPut,
    PointsRead,
    PruneJobs,
    PutPoints,
    ReadPoints,
    RecordingReference,
    RecordingReply,
    ReleaseAxes,
    ReloadFleet,
    ReorderJob,
    RetryJob,
    StopFleet,
    SubmitJob,
    WiringChecked,
)

ANSWERED_FIRST = frozenset({"stop", "stop-queue"})  # before they are in the journal, which may be slow


class Verb(NamedTuple):
    """One verb of `svc/{verb}`. cached: a repeated request gets the first answer, and the command is in the journal.
    Not so where a verb only reads: its answers are large, and it may be executed twice."""

    request: type[Request]
    reply: type[Model]
    handler: Callable[[Any], Awaitable[Model]]
    cached: bool = True


class UserRequests:
    """Answers `svc/*`. A handler returns its reply or raises `Refusal`, `UnknownName` or `JournalError`."""

    def __init__(
        self,
        services: JobServices,
        intake: JobIntake,
        scheduler: Scheduler,
        manual: ManualLeases,
        maintenance: tuple[FleetReload, WiringCheck, EpochRepair],
    ) -> None:
        self._services = services
        self._intake = intake
        self._scheduler = scheduler
        self._leases: LeaseRegistry = services.leases
        self._reload, self._wiring, self._epochs = maintenance
        self._keys: FleetKeys = services.keys
        self._answers = AnswerCache()
        self._rehearsal = JobRehearsal(services)
        self._commands = CommandLog(services)
        approvals = JobApprovals(services, scheduler)
        self._verbs = {
            "submit": Verb(SubmitJob, JobSubmitted, intake.submit_job),
            "dry-run": Verb(DryRun, DryRunDone, self._dry_run, cached=False),
            "list": Verb(ListJobs, QueueState, self._list_jobs, cached=False),
            "find": Verb(FindJob, JobsFound, self._find_job, cached=False),
            "show": Verb(JobReference, JobShown, self._show_job, cached=False),
            "points": Verb(ReadPoints, PointsRead, self._read_points, cached=False),
            "put-points": Verb(PutPoints, PointsPut, intake.points.put_points, cached=False),
            "recording": Verb(RecordingReference, RecordingReply, self._load_recording, cached=False),
            "cancel": Verb(JobReference, Reply, self._cancel_job),
            "retry": Verb(RetryJob, JobRetried, intake.retry_job),
            "hold": Verb(JobReferences, Reply, self._hold_jobs),
            "release": Verb(JobReferences, Reply, self._release_jobs),
            "plan": Verb(JobReference, JobPlanned, approvals.plan_job, cached=False),
            "approve": Verb(ApproveJob, Reply, approvals.approve_job),
            "reorder": Verb(ReorderJob, Reply, self._reorder_job),
            "pause": Verb(PauseJob, Reply, self._pause_job),
            "resume": Verb(JobReference, Reply, self._resume_job),
            "prune": Verb(PruneJobs, JobsPruned, self._prune_jobs),
            "stop": Verb(StopFleet, Reply, self._stop_fleet),
            "start-queue": Verb(Request, Reply, self._start_queue),
            "stop-queue": Verb(Request, Reply, self._stop_queue),
            "acquire-axes": Verb(AcquireAxes, AxesAcquired, manual.acquire),
            "release-axes": Verb(ReleaseAxes, Reply, self._release_axes),
            "reload": Verb(ReloadFleet, FleetReloaded, self._reload_fleet),
            "check-wiring": Verb(Request, WiringChecked, self._check_wiring),
            "repair-epoch": Verb(Request, EpochRepaired, self._repair_epoch),
            "positions": Verb(Request, PositionsListed, services.positions.list_positions, cached=False),
            "save-position": Verb(SavePosition, PositionSaved, services.positions.save_position),
            "remove-position": Verb(RemovePosition, PositionRemoved, services.positions.remove_position),
            "alarms": Verb(ListAlarms, AlarmsListed, services.alarms.list_alarms, cached=False),
            "acknowledge": Verb(AcknowledgeAlarms, AlarmsAcknowledged, services.alarms.acknowledge_alarms),
            "shelve": Verb(ShelveAlarm, AlarmShelved, services.alarms.shelve_alarm),
            "statistics": Verb(ReadStatistics, StatisticsRead, services.statistics.read_statistics, cached=False),
            "commands": Verb(ListCommands, CommandsListed, self._commands.list_commands, cached=False),
            "names": Verb(Request, FleetNames, self._list_names, cached=False),
            "configuration": Verb(Request, FleetLoaded, self._show_configuration, cached=False),
        }

    async def answer(self, sample: BusSample) -> bytes:
        """Answer one request. Raises `RequestRefused` for one that is not valid, and when the leadership is lost."""
        name = self._keys.verb_of(sample.key)
        verb = self._verbs.get(name)
        if verb is None:
            raise RequestRefused(f"unknown verb {name!r}; known verbs: {', '.join(sorted(self._verbs))}")
        try:
            request = verb.request.model_validate_json(sample.payload)
        except ValidationError as error:
            raise RequestRefused(f"{name}: {_first_problem(error)}") from None
        if self._services.leadership.over:
            raise RequestRefused("this coordinator is no longer the leader; send the request again")
        if not verb.cached:
            return (await self._execute(verb, request)).to_json()
        return await self._answers.answer_once(name, request.request_id, lambda: self._execute_command(name, request))

    async def _execute_command(self, name: str, request: Request) -> bytes:
        """Execute a request that changes something, and record it, before it is answered as a rule."""
        command = self._commands.describe_command(name, request)
        reply = await self._execute(self._verbs[name], request)
        if command is not None:
            refused = reply.refused.code if isinstance(reply, Reply) and reply.refused is not None else ""
            recorded = self._commands.record_command(command, reply, refused)
            if name in ANSWERED_FIRST:
                self._services.fleet.tasks.spawn(recorded, vital=False)
            else:
                await recorded
        return reply.to_json()

    async def _execute(self, verb: Verb, request: Request) -> Model:
        try:
            return await verb.handler(request)
        except Refusal as error:
            refused = RefusalDetails.of(error)
        except UnknownName as error:
            refused = RefusalDetails(code="unknown-name", text=str(error), remedy="see `tutti axis ls`")
        except JournalError as error:
            self._services.log.warning(str(error))
            refused = RefusalDetails(code="journal", text=error.text, remedy=error.remedy)
        if not issubclass(verb.reply, Reply):  # it has no field for a refusal
            raise RequestRefused(f"{refused.text}; {refused.remedy}")
        return verb.reply(refused=refused)

    # Jobs

    async def _dry_run(self, request: DryRun) -> DryRunDone:
        job = await self._intake.points.resolve_points(request.job)
        return await self._rehearsal.dry_run(request.model_copy(update={"job": job}))

    async def _read_points(self, request: ReadPoints) -> PointsRead:
        services = self._services
        after = request.after_step, request.after_point
        load = services.journal.point_rows.load_points
        return PointsRead(points=await services.execute(load, request.job_id, after, request.limit))

    async def _list_jobs(self, request: ListJobs) -> QueueState:
        services = self._services
        values = (request.limit, request.state, request.name, request.since or "")
        records, total = await services.execute(services.journal.find_jobs, *values)
        return self._scheduler.make_queue_state(total, records)

    async def _find_job(self, request: FindJob) -> JobsFound:
        services = self._services
        if request.reference == "last":
            records, _ = await services.execute(services.journal.find_jobs, 1)
        else:
            records = await services.execute(services.journal.find_referenced_jobs, request.reference)
        return JobsFound(jobs=[self._scheduler.make_entry(record) for record in records])

    async def _show_job(self, request: JobReference) -> JobShown:
        journal, execute = self._services.journal, self._services.execute
        record = await execute(journal.load_record, request.job_id)
        if record is None:
            raise Refusal("unknown-job", f"no job {request.job_id}", "see `tutti job ls`")
        job, report = None, await execute(journal.load_report, record.id)
        try:
            job = await execute(journal.load_job, record.id)
        except DamagedRecord:
            if report is None:
                raise
        return JobShown(
            entry=self._scheduler.make_entry(record),
            job=job,
            report=report,
            transitions=await execute(journal.list_transitions, record.id),
            progress=self._scheduler.find_progress(record.id),
        )

    async def _load_recording(self, request: RecordingReference) -> RecordingReply:
        services = self._services
        recording = await services.execute(services.journal.load_recording, request.job_id, request.step)
        return RecordingReply(recording=recording)

    async def _cancel_job(self, request: JobReference) -> Reply:
        await self._scheduler.cancel_job(request.job_id, request.actor)
        return Reply()

    async def _hold_jobs(self, request: JobReferences) -> Reply:
        await self._scheduler.hold_jobs(request.job_ids, request.actor)
        return Reply()

    async def _release_jobs(self, request: JobReferences) -> Reply:
        await self._scheduler.release_jobs(request.job_ids, request.actor)
        return Reply()

    async def _reorder_job(self, request: ReorderJob) -> Reply:
        await self._scheduler.reorder_job(request.job_id, request.before, request.actor)
        return Reply()

    async def _pause_job(self, request: PauseJob) -> Reply:
        await self._scheduler.pause_job(request.job_id, request.actor, now=request.now)
        return Reply()

    async def _resume_job(self, request: JobReference) -> Reply:
        await self._scheduler.resume_job(request.job_id, request.actor)
        return Reply()

    async def _prune_jobs(self, request: PruneJobs) -> JobsPruned:
        return JobsPruned(jobs=await self._intake.prune_jobs(request))

    async def _stop_fleet(self, request: StopFleet) -> Reply:
        interrupt = JobInterrupted("aborted", f"stopped by {request.actor}", request.actor)
        await self._scheduler.stop_jobs(interrupt, request.mode)
        return Reply()

    async def _start_queue(self, request: Request) -> Reply:
        await self._scheduler.gate.start_queue(request.actor)
        return Reply()

    async def _stop_queue(self, request: Request) -> Reply:
        self._scheduler.gate.stop_queue(f"stopped by {request.actor}", request.actor)
        return Reply()

    # Axes and fleet

    async def _release_axes(self, request: ReleaseAxes) -> Reply:
        await self._leases.release(request.holder)
        return Reply()

    async def _repair_epoch(self, request: Request) -> EpochRepaired:
        controllers = await self._epochs.repair_epochs(request.actor)
        if controllers:
            self._services.log.warning(f"epoch repaired by {request.actor}: {', '.join(controllers)}")
        return EpochRepaired(controllers=controllers)

    async def _reload_fleet(self, request: ReloadFleet) -> FleetReloaded:
        try:
            fleet = Fleet.model_validate(request.configuration)
        except ValidationError as error:
            raise Refusal("bad-file", _first_problem(error), "correct the fleet file") from None
        changed = await self._reload.load_fleet(fleet, request.actor)
        self._scheduler.forget_needs()
        self._services.log.info(f"reloaded by {request.actor}: {', '.join(changed) or 'no controller has changed'}")
        return FleetReloaded(changed=changed)

    async def _list_names(self, _: Request) -> FleetNames:
        fleet = self._services.view.fleet
        return FleetNames(
            controllers=list(fleet.controllers),
            axes={name: fleet.axis(name).unit for name in fleet.axis_names},
            groups=fleet.groups,
            positions={each.name: list(each.axes) for each in self._services.positions.list_entries()},
            inputs=[f"{c}.{name}" for c, each in fleet.controllers.items() for name in each.inputs],
            outputs=[f"{c}.{name}" for c, each in fleet.controllers.items() for name in each.outputs],
        )

    async def _show_configuration(self, _: Request) -> FleetLoaded:
        # What is run for alarms may contain addresses and passwords.
        return FleetLoaded(configuration=self._services.view.fleet.model_copy(update={"notify": None}).to_plain())

    async def _check_wiring(self, request: Request) -> WiringChecked:
        return WiringChecked(wires=await self._wiring.check_wires(request.actor))


def _first_problem(error: ValidationError) -> str:
    first = error.errors()[0]
    return f"{'.'.join(map(str, first['loc']))}: {first['msg']}"
