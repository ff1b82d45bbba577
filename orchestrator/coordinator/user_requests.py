"""Requests of users to the leader: one table of verbs, and one place where an error becomes a reply."""

from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import Any

from pydantic import ValidationError

from orchestrator.bus.answers import AnswerCache
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.service_verbs import NOT_LEADER, SERVICE_VERBS
from orchestrator.coordinator.command_log import CommandLog
from orchestrator.coordinator.fleet.manual import ManualLeases
from orchestrator.coordinator.jobs.intake.approval import JobApprovals
from orchestrator.coordinator.jobs.intake.job_intake import JobIntake
from orchestrator.coordinator.jobs.intake.path_intake import split_paths
from orchestrator.coordinator.jobs.intake.rehearsal import JobRehearsal
from orchestrator.coordinator.jobs.queue.hand_over import HandOver
from orchestrator.coordinator.jobs.queue.scheduler import Scheduler
from orchestrator.coordinator.jobs.run.outcome import JobInterrupted
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import DamagedRecord, EpochOvertaken, JournalError
from orchestrator.coordinator.maintenance.epochs import EpochRepair
from orchestrator.coordinator.maintenance.learned import LearnedTimesKeeper
from orchestrator.coordinator.maintenance.reload import FleetReload
from orchestrator.coordinator.maintenance.wiring import WiringCheck
from orchestrator.model.base import Model, UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.restart import PreviewStart, ReleaseJobs, StartPreview, StartQueue
from orchestrator.model.jobs.service import (
    DryRun,
    DryRunDone,
    FindJob,
    FleetLoaded,
    FleetNames,
    FleetReloaded,
    JobReference,
    JobReferences,
    JobsFound,
    JobShown,
    JobsPruned,
    ListJobs,
    PauseJob,
    PruneJobs,
    RecordingReference,
    RecordingReply,
    ReleaseAxes,
    ReloadFleet,
    ReorderJob,
    StopFleet,
    WiringChecked,
)
from orchestrator.model.messages import RefusalDetails, Reply, Request
from orchestrator.model.problems import describe_first_error
from orchestrator.model.report import QueueState

ANSWERED_FIRST = frozenset({"stop", "stop-queue"})  # before they are in the journal, which may be slow


Handler = Callable[[Any], Awaitable[Model]]


class UserRequests:
    """Answers `svc/*`. A handler returns its reply or raises `Refusal`, `UnknownName` or `JournalError`."""

    def __init__(
        self,
        services: JobServices,
        intake: JobIntake,
        scheduler: Scheduler,
        manual: ManualLeases,
        maintenance: tuple[FleetReload, WiringCheck, EpochRepair, LearnedTimesKeeper, HandOver],
    ) -> None:
        self._services = services
        self._intake = intake
        self._scheduler = scheduler
        self._reload, self._wiring, epochs, learned_times, hand_over = maintenance
        self._keys: FleetKeys = services.keys
        self._answers = AnswerCache()
        self._rehearsal = JobRehearsal(services)
        self._commands = CommandLog(services)
        approvals = JobApprovals(services, scheduler.register, scheduler.queue_requests)
        self._handlers: Mapping[str, Handler] = {
            "submit": intake.submit_job,
            "dry-run": self._dry_run,
            "list": self._list_jobs,
            "find": self._find_job,
            "show": self._show_job,
            "points": scheduler.run_requests.read_points,
            "put-points": intake.points.put_points,
            "recording": self._load_recording,
            "cancel": self._cancel_job,
            "retry": intake.retry_job,
            "hold": self._hold_jobs,
            "preview-start": self._preview_start,
            "release": self._release_jobs,
            "plan": approvals.plan_job,
            "approve": approvals.approve_job,
            "reorder": self._reorder_job,
            "pause": self._pause_job,
            "override": scheduler.run_requests.override_job,
            "retarget": scheduler.run_requests.retarget_job,
            "go": scheduler.run_requests.go_job,
            "resume": self._resume_job,
            **intake.live.handlers,
            "prune": self._prune_jobs,
            "stop": self._stop_fleet,
            "start-queue": self._start_queue,
            "stop-queue": self._stop_queue,
            "acquire-axes": manual.acquire,
            "release-axes": self._release_axes,
            "reload": self._reload_fleet,
            "check-wiring": self._check_wiring,
            "hand-over": hand_over.answer,
            "repair-epoch": epochs.answer,
            "forget-times": learned_times.forget_times,
            "positions": services.positions.list_positions,
            "save-position": services.positions.save_position,
            "remove-position": services.positions.remove_position,
            "alarms": services.alarms.list_alarms,
            "acknowledge": services.alarms.acknowledge_alarms,
            "shelve": services.alarms.shelve_alarm,
            "statistics": services.statistics.read_statistics,
            "commands": self._commands.list_commands,
            "names": self._list_names,
            "virtual": services.virtual.answer,
            "zones": services.zones.answer,
            "configuration": self._show_configuration,
        }

    async def answer(self, sample: BusSample) -> bytes:
        """Answer one request. Raises `RequestRefused` for one that is not valid, and when the leadership is lost."""
        name = self._keys.verb_of(sample.key)
        if (verb := SERVICE_VERBS.get(name)) is None:
            raise RequestRefused(f"unknown verb {name!r}; known verbs: {', '.join(sorted(SERVICE_VERBS))}")
        request = await self._services.read_request(verb.request, sample, f"{name}: ")
        if self._services.leadership.over:
            raise RequestRefused(NOT_LEADER)
        if verb.reads:  # its answers are large, and are not kept
            return await self._services.dump_model(await self._execute(name, request))
        # A repeated request gets the first answer.
        work = partial(self._execute_command, name, request)
        return await self._answers.answer_once(name, request, sample.payload, work)

    async def _execute_command(self, name: str, request: Request) -> bytes:
        """Execute a request that changes something, and record it, before it is answered as a rule."""
        command = self._commands.describe_command(name, request)
        reply = await self._execute(name, request)
        if command is not None:
            refused_code = reply.refused.code if isinstance(reply, Reply) and reply.refused is not None else ""
            recorded_command = self._commands.record_command(command, reply, refused_code)
            if name in ANSWERED_FIRST:
                self._services.fleet.tasks.spawn(recorded_command, vital=False)
            else:
                await recorded_command
        return reply.to_json()

    async def _execute(self, name: str, request: Request) -> Model:
        try:
            return await self._handlers[name](request)
        except Refusal as error:
            refused_details = RefusalDetails.of(error)
        except UnknownName as error:
            refused_details = RefusalDetails(code="unknown-name", text=str(error), remedy="see `tutti axis ls`")
        except EpochOvertaken as error:
            # The leader may have accepted the same request: no answer of this one may come before that.
            self._services.log.warning(str(error))
            raise RequestRefused(NOT_LEADER) from None
        except JournalError as error:
            self._services.log.warning(str(error))
            refused_details = RefusalDetails(code="journal", text=error.text, remedy=error.remedy)
        reply = SERVICE_VERBS[name].reply
        if not issubclass(reply, Reply):  # it has no field for a refusal
            raise RequestRefused(f"{refused_details.text}; {refused_details.remedy}")
        return reply(refused=refused_details)

    # Jobs

    async def _dry_run(self, request: DryRun) -> DryRunDone:
        job = await self._intake.points.resolve_points(request.job)
        job = await split_paths(self._services, job)
        return await self._rehearsal.dry_run(request.model_copy(update={"job": job}))

    async def _list_jobs(self, request: ListJobs) -> QueueState:
        services = self._services
        if request.before and await services.execute(services.journal.load_record, request.before) is None:
            text = f"there is no job {request.before}, behind which the list is to go on"
            raise Refusal("bad-request", text, "it may have been pruned: begin again without it")
        values = (request.limit, request.state, request.name, request.since or "", request.before)
        records, total = await services.execute(services.journal.find_jobs, *values)
        return self._scheduler.publisher.make_queue_state(total, records)

    async def _find_job(self, request: FindJob) -> JobsFound:
        services = self._services
        if request.reference == "last":
            records, _ = await services.execute(services.journal.find_jobs, 1)
        else:
            records = await services.execute(services.journal.find_referenced_jobs, request.reference)
        return JobsFound(jobs=[self._scheduler.publisher.make_entry(record) for record in records])

    async def _show_job(self, request: JobReference) -> JobShown:
        journal, execute = self._services.journal, self._services.execute
        record = await execute(journal.load_record, request.job_id)
        if record is None:
            raise Refusal("unknown-job", f"no job {request.job_id}", "see `tutti job ls`")
        job, report = None, await execute(journal.load_report, record.id)
        try:
            job = await self._services.load_job(record.id)
        except DamagedRecord:
            if report is None:
                raise
        return JobShown(
            entry=self._scheduler.publisher.make_entry(record),
            job=job,
            report=report,
            transitions=await execute(journal.list_transitions, record.id),
            progress=self._scheduler.run_requests.find_progress(record.id),
            last_motion=self._scheduler.run_requests.find_last_motion(record.id),
        )

    async def _load_recording(self, request: RecordingReference) -> RecordingReply:
        services = self._services
        recording = await services.execute(services.journal.load_recording, request.job_id, request.step)
        return RecordingReply(recording=recording)

    async def _cancel_job(self, request: JobReference) -> Reply:
        await self._scheduler.queue_requests.cancel_job(request.job_id, request.actor)
        return Reply()

    async def _hold_jobs(self, request: JobReferences) -> Reply:
        await self._scheduler.queue_requests.hold_jobs(request.job_ids, request.actor)
        return Reply()

    async def _preview_start(self, request: PreviewStart) -> StartPreview:
        starts, register = self._scheduler.starts, self._scheduler.register
        if not request.job_ids:
            return starts.preview_start()
        remedy = "only a job that waits can be released"
        return starts.preview_release([await register.find_waiting(job_id, remedy) for job_id in request.job_ids])

    async def _release_jobs(self, request: ReleaseJobs) -> Reply:
        await self._scheduler.queue_requests.release_jobs(request.job_ids, request.actor, request.shown)
        return Reply()

    async def _reorder_job(self, request: ReorderJob) -> Reply:
        await self._scheduler.queue_requests.reorder_job(request.job_id, request.before, request.actor)
        return Reply()

    async def _pause_job(self, request: PauseJob) -> Reply:
        await self._scheduler.run_requests.pause_job(request.job_id, request.actor, now=request.now)
        return Reply()

    async def _resume_job(self, request: JobReference) -> Reply:
        await self._scheduler.run_requests.resume_job(request.job_id, request.actor)
        return Reply()

    async def _prune_jobs(self, request: PruneJobs) -> JobsPruned:
        return JobsPruned(jobs=await self._intake.prune_jobs(request))

    async def _stop_fleet(self, request: StopFleet) -> Reply:
        interrupt = JobInterrupted("aborted", f"stopped by {request.actor}", request.actor)
        await self._scheduler.stop_jobs(interrupt, request.mode)
        return Reply()

    async def _start_queue(self, request: StartQueue) -> Reply:
        await self._scheduler.starts.start_jobs(request.actor, request.shown)
        await self._scheduler.gate.start_queue(request.actor)
        return Reply()

    async def _stop_queue(self, request: Request) -> Reply:
        self._scheduler.gate.stop_queue(f"stopped by {request.actor}", request.actor)
        return Reply()

    # Axes and fleet

    async def _release_axes(self, request: ReleaseAxes) -> Reply:
        await self._services.leases.release(request.holder)
        return Reply()

    async def _reload_fleet(self, request: ReloadFleet) -> FleetReloaded:
        try:
            fleet = Fleet.model_validate(request.configuration)
        except ValidationError as error:
            raise Refusal("bad-file", describe_first_error(error, ""), "correct the fleet file") from None
        changed_fleet = await self._reload.load_fleet(fleet, request.actor)
        self._scheduler.register.forget_needs()
        self._services.log.info(
            f"reloaded by {request.actor}: {', '.join(changed_fleet) or 'no controller has changed'}"
        )
        return FleetReloaded(changed=changed_fleet)

    async def _list_names(self, _: Request) -> FleetNames:
        fleet = self._services.view.fleet
        return FleetNames(
            controllers=list(fleet.controllers),
            axes={name: fleet.axis(name).unit for name in fleet.axis_names},
            groups=fleet.groups,
            positions={entry.name: list(entry.axes) for entry in self._services.positions.list_entries()},
            virtual={name: fleet.unit_of(name) for name in fleet.names.virtual},
            virtual_groups={name: fleet.expand_name(name) for name in fleet.virtual},
            inputs=[f"{c}.{name}" for c, controller in fleet.controllers.items() for name in controller.inputs],
            outputs=[f"{c}.{name}" for c, controller in fleet.controllers.items() for name in controller.outputs],
        )

    async def _show_configuration(self, _: Request) -> FleetLoaded:
        # What is run for alarms may contain addresses and passwords.
        fleet = self._services.view.fleet
        return FleetLoaded(configuration=fleet.model_copy(update={"notify": None}).to_plain(), digest=fleet.digest)

    async def _check_wiring(self, request: Request) -> WiringChecked:
        return WiringChecked(wires=await self._wiring.check_wires(request.actor))
