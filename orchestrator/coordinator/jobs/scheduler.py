"""The scheduler of waiting and running jobs. Each change of a job's state is in the journal before it is on the bus.

`queue` decides which of the waiting jobs begin, `conditions` what they wait for outside the queue, `queue_gate` whether
any begins; `job_run` executes one.
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterable, Mapping, Sequence
from datetime import datetime, timedelta
from itertools import chain
from typing import Any, NamedTuple, ParamSpec

from pydantic import ValidationError

from orchestrator.bus.base import BusDeclaration, BusSample, Priority
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.coordinator.jobs.attendance import SessionMonitor
from orchestrator.coordinator.jobs.conditions import JobNeeds, Obstacle, WorldConditions, find_needs
from orchestrator.coordinator.jobs.job_run import JobInterrupted, JobOutcome, JobRun, JobServices
from orchestrator.coordinator.jobs.publisher import QueuePublisher, describe_stop
from orchestrator.coordinator.jobs.queue import (
    MAX_JOBS_WITHOUT_AXES,
    WITHOUT_AXES_REASON,
    Schedule,
    WaitingJob,
    choose_jobs,
    sort_waiting,
)
from orchestrator.coordinator.jobs.queue_gate import COORDINATOR, QueueGate
from orchestrator.coordinator.journal.records import DamagedRecord, JobHasEnded, JobRecord, JournalError
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import EstopMessage, StopMode
from orchestrator.model.operation.approval import JobApproval
from orchestrator.model.queue import APPROVAL, QueueTerms, parse_utc
from orchestrator.model.report import (
    FINISHED_STATES,
    JobProgress,
    JobReport,
    JobState,
    QueueEntry,
    QueueState,
    StepReport,
    make_queued_progress,
)
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.order import StepOrder

P = ParamSpec("P")

CLOCK_POLL_NS = NS_PER_S  # period of reading the wall clock, which may be set, while a job waits for a time
MISSED_AFTER = timedelta(seconds=10)  # a coordinator that is back within this time has not missed a job's start time
SCHEDULE_DELAY_PER_JOB_NS = 20 * NS_PER_US  # per job
OVERRIDE_PERCENT = 10, 120
CLOSE_S = 5.0  # for running jobs to stop, and for their ends to be recorded
RETRY_NS = 5 * NS_PER_S  # before another try on a journal that could not be written
CONDITION_POLL_NS = 100 * NS_PER_MS  # period of looking at the conditions of the jobs that wait for one
SESSION_POLL_NS = 200 * NS_PER_MS  # period of looking for sessions that are over


class JobEnd(NamedTuple):
    """How a job ends: its state, the reason, and what caused it."""

    state: JobState
    reason: str
    actor: str


class Scheduler:
    """Begins jobs as soon as the controllers that they need are free, and changes the queue on request."""

    def __init__(self, services: JobServices) -> None:
        self._services = services
        self._waiting: dict[str, WaitingJob] = {}
        self._needs: dict[str, JobNeeds] = {}
        self._running: dict[str, JobRun] = {}
        self.gate = QueueGate(services, self._count_unattended, self._queue_has_changed)
        self._conditions = WorldConditions(services.fleet)
        self._sessions = SessionMonitor(services)
        self._publisher = QueuePublisher(services, self._waiting, self._running, lambda: self.gate.stopped)
        self._trouble = False
        self._wake = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._declared: list[BusDeclaration] = []
        self._timed = asyncio.Event()
        self._arranging = asyncio.Lock()
        services.leases.add_release_listener(lambda _: self.wake_up())
        services.fleet.permits.on_change = self._queue_has_changed

    async def start(self) -> None:
        """End the jobs that an earlier leader left running, then begin with the queue. Raises `JournalError`."""
        services = self._services
        remaining_jobs: list[tuple[JobRecord, Job]] = []
        is_damaged = False
        for row in await services.execute(services.journal.list_unfinished):
            job = await self._load_job(row)
            if job is None:
                is_damaged = True
            elif row.state == "queued":
                waiting_job = self._waiting[row.id] = WaitingJob(row, job, row.after)
                if waiting_job.awaits_approval:
                    approval = await self._services.load_approval(row.id)
                    waiting_job.deviation = "" if approval is None else approval.void
            else:
                remaining_jobs.append((row, job))
        for row, job in remaining_jobs:
            reason = f"the coordinator ended while the job was {row.state}"
            await self._end_job(row, job, self._report_of(row, job), JobEnd("interrupted", reason, "coordinator"))
        for waiting_job in list(self._waiting.values()):
            await self._settle_follower(waiting_job)
        await self.gate.start(interrupted=bool(remaining_jobs) or is_damaged)
        await self._sessions.start()
        self._declared.append(await services.bus.subscribe(services.keys.estop, self._receive_estop))
        self._spawn(self._schedule_jobs)
        self._spawn(self._watch_times)
        self._spawn(self._watch_sessions)
        self.wake_up()
        self._publisher.schedule_publication()

    async def _load_job(self, row: JobRecord) -> Job | None:
        """The job of a record; None if record or job is damaged: that one has failed then, and the others are run."""
        services, damage = self._services, row.damage
        if not damage:
            try:
                return await services.execute(services.journal.load_job, row.id)
            except DamagedRecord as error:
                damage = error.text
        services.log.warning(f"job cannot be run: {damage}", job=row.id)
        transition = services.make_transition("failed", damage, COORDINATOR)
        changes = {"state": "failed", "reason": damage, "ended_utc": transition.utc, "transitions": [transition]}
        report = self._report_of(row, None).model_copy(update=changes)
        await services.execute(services.journal.fail_damaged, row, transition, report)
        return None

    async def close(self, reason: str) -> None:
        """End: running jobs are stopped and recorded as interrupted."""
        for declaration in self._declared:
            await declaration.undeclare()
        await self._sessions.close()
        self.gate.close()
        runs = list(self._running.values())
        await self.interrupt_jobs(JobInterrupted("interrupted", reason, "coordinator"))
        ends = [run.task for run in runs if run.task is not None]
        if ends:
            await asyncio.wait(ends, timeout=CLOSE_S)
            # Their ends are recorded by tasks of this scheduler.
            until_ns = self._services.clock.now_ns() + round(CLOSE_S * NS_PER_S)
            while self._running and self._services.clock.now_ns() < until_ns:
                await sleep_ns(self._services.clock, NS_PER_MS)
        self._publisher.close()
        for task in self._tasks:
            task.cancel()

    def wake_up(self) -> None:
        """Schedule again: a controller has become free, or the queue has changed."""
        self._wake.set()

    # Requests of users

    async def enter_job(self, row: JobRecord, job: Job) -> None:
        """Enter a job that was accepted."""
        waiting_job = self._waiting[row.id] = WaitingJob(row, job, row.after)
        await self._settle_follower(waiting_job)
        self._timed.set()
        self.wake_up()
        self._publisher.schedule_publication()

    async def cancel_job(self, job_id: str, actor: str) -> None:
        """Cancel a queued or running job. Raises `Refusal`, `JournalError`, as all requests here do."""
        run = self._running.get(job_id)
        if run is not None:
            await run.interrupt_job(JobInterrupted("cancelled", f"cancelled by {actor}", actor))
            return
        waiting_job = self._waiting.pop(job_id, None)
        if waiting_job is None:
            raise await self._make_refusal(job_id, "not-queued", "try again in a moment")
        await self._cancel_waiting(waiting_job, f"cancelled by {actor}", actor)
        self.wake_up()

    async def stop_jobs(self, interrupt: JobInterrupted, mode: StopMode = "decelerate") -> None:
        """Stop all running jobs and the queue: nothing begins by itself after a stop."""
        self.gate.stop_queue(interrupt.reason, interrupt.actor)
        await self.interrupt_jobs(interrupt, mode)

    async def interrupt_jobs(self, interrupt: JobInterrupted, mode: StopMode = "decelerate") -> None:
        """Stop and end all running jobs."""
        await asyncio.gather(*(run.interrupt_job(interrupt, mode) for run in self._running.values()))

    async def hold_jobs(self, job_ids: Iterable[str], actor: str) -> None:
        """Hold queued jobs until they are released."""
        for job_id in job_ids:
            if job_id not in self._waiting:
                raise await self._make_refusal(job_id, "not-queued", "pause it: `tutti job pause`")
            await self._hold_job(job_id, actor, f"held by {actor}")

    async def release_jobs(self, job_ids: Iterable[str], actor: str) -> None:
        """Release held jobs; without ids, all held jobs but those that wait for approval."""
        held_jobs = [job for job in self._waiting.values() if job.row.held_by and not job.awaits_approval]
        for job_id in list(job_ids) or [job.row.id for job in held_jobs]:
            waiting_job = await self.find_waiting(job_id, "for a paused job: `tutti job resume`")
            if waiting_job.awaits_approval:
                remedy = f"look at its plan and approve it: `tutti job approve {job_id}`"
                raise Refusal("awaits-approval", f"job {job_id} waits for the approval of its plan", remedy)
            if waiting_job.row.held_by:
                services = self._services
                change = services.make_transition("queued", f"released by {actor}", actor)
                await services.execute(services.journal.hold_jobs, [job_id], "", change)
                waiting_job.row = waiting_job.row._replace(held_by="", reason=change.reason)
                self.wake_up()

    async def find_waiting(self, job_id: str, remedy: str) -> WaitingJob:
        """A job that waits. Raises `Refusal` with this remedy for one that does not."""
        waiting_job = self._waiting.get(job_id)
        if waiting_job is None:
            raise await self._make_refusal(job_id, "not-queued", remedy)
        return waiting_job

    async def approve_job(self, waiting: WaitingJob, approval: JobApproval) -> None:
        """Record the approval of a job's plan, and release the job if it waits for that. A hold by a user stays."""
        services, job_id = self._services, waiting.row.id
        change = services.make_transition("queued", f"plan {approval.plan.hash} approved", approval.actor)
        is_stored = await services.execute(services.journal.approvals.approve_job, approval, change)
        if not is_stored or self._waiting.get(job_id) is not waiting:
            raise await self._make_refusal(job_id, "not-queued", "only a job that waits can be approved")
        held_by = "" if waiting.awaits_approval else waiting.row.held_by
        waiting.row = waiting.row._replace(held_by=held_by, reason=change.reason)
        waiting.deviation = ""
        self.wake_up()

    async def reorder_job(self, job_id: str, before: str, actor: str) -> None:
        """Move a queued job before another one, with that one's priority."""
        for waiting_id in (job_id, before):
            if waiting_id not in self._waiting:
                raise await self._make_refusal(waiting_id, "not-queued", "only queued jobs have a place in the queue")
        if job_id == before:
            raise Refusal("same-job", f"job {job_id} cannot be moved before itself", "choose another job")
        async with self._arranging:
            moved_job, other_job = self._waiting[job_id], self._waiting[before]
            order = [job for job in sort_waiting(self._waiting) if job is not moved_job]
            order.insert(order.index(other_job), moved_job)
            ranks = sorted(job.row.place for job in order)
            places = {job.row.id: rank for job, rank in zip(order, ranks, strict=True) if job.row.place != rank}
            services, priority = self._services, other_job.row.priority
            change = services.make_transition("queued", f"moved before job {before} by {actor}", actor)
            await services.execute(services.journal.reorder_jobs, job_id, priority, places, change)
            for job in order:
                job.row = job.row._replace(place=places.get(job.row.id, job.row.place))
            moved_job.row = moved_job.row._replace(priority=priority, reason=change.reason)
        self.wake_up()
        self._publisher.schedule_publication()

    async def pause_job(self, job_id: str, actor: str, *, now: bool = False) -> None:
        """Pause a running job after its current step; with `now`, inside a motion step."""
        run = self._running.get(job_id)
        if run is None:
            raise await self._make_refusal(job_id, "not-running", "to hold a queued job: `tutti job hold`")
        if now and run.is_on_path:
            raise Refusal(
                "on-path",
                f"job {job_id} is on a path, and a member that has all of it loaded would leave it",
                "pause it at the end of the path (without --now), or stop it: `tutti stop`",
            )
        if run.paused_by is None:
            self._services.log.info(f"to be paused by {actor}", job=job_id)
            run.pause(actor)
        if now:
            await run.feed_hold(actor)

    async def override_job(self, job_id: str, percent: float) -> None:
        """Play the present path of a running job at another speed. Raises `Refusal`."""
        run = self._running.get(job_id)
        if run is None:
            raise await self._make_refusal(job_id, "not-running", "an override is for the path that a job is moving on")
        low, high = OVERRIDE_PERCENT
        if not low <= percent <= high:
            text = f"{percent:g} % is not between {low} and {high} %"
            raise Refusal("override", text, "to stop on the path: `tutti job pause --now`")
        await run.override(percent / 100)

    async def resume_job(self, job_id: str, actor: str) -> None:
        """Resume a job that is paused, or about to be."""
        run = self._running.get(job_id)
        if run is None:
            remedy = "for a held job: `tutti job release`; for a finished one: `tutti job retry --from-step`"
            raise await self._make_refusal(job_id, "not-running", remedy)
        if run.paused_by is None:
            raise Refusal("not-paused", f"job {job_id} is not paused; it is {run.state}")
        run.resume(actor)

    async def _make_refusal(self, job_id: str, code: str, remedy: str) -> Refusal:
        """The refusal of a request that does not fit the state of the job."""
        row = await self._services.execute(self._services.journal.load_record, job_id)
        if row is None:
            return Refusal("unknown-job", f"no job {job_id}", "see `tutti job ls`")
        state = self._running[job_id].state if job_id in self._running else row.state
        if state in FINISHED_STATES:
            return Refusal("ended", f"job {job_id} is {state} already")
        return Refusal(code, f"job {job_id} is {state}", remedy)

    # Scheduling loop

    async def _schedule_jobs(self) -> None:
        services = self._services
        while not services.leadership.over:
            await self._wake.wait()
            self._wake.clear()
            if self._trouble:
                await sleep_ns(services.clock, RETRY_NS)
                self._trouble = False
                self._wake.set()
            # A long queue is scheduled less often: a pass takes some microseconds per job.
            await sleep_ns(services.clock, len(self._waiting) * SCHEDULE_DELAY_PER_JOB_NS)
            choice = self._make_schedule()
            if choice.waits_for_world:
                services.clock.call_at_ns(services.clock.now_ns() + CONDITION_POLL_NS, self.wake_up)
            for job in choice.ready_jobs:
                self._begin_job(job)
            await self._cancel_impatient(choice.reasons)
            self._publisher.take_schedule(sort_waiting(self._waiting), choice.reasons)
            if choice.ready_jobs:
                self._publisher.schedule_publication()

    def _make_schedule(self) -> Schedule:
        queue = ((job, self._find_needs(job).controllers) for job in sort_waiting(self._waiting))
        stop = self.gate.stopped
        reason = "" if stop is None else describe_stop(stop)
        return choose_jobs(queue, self._find_busy(), self._find_condition, reason, self._count_free_places())

    def _count_free_places(self) -> int:
        """How many more jobs without axes may run."""
        return max(0, MAX_JOBS_WITHOUT_AXES - sum(not run.needs for run in self._running.values()))

    def _find_busy(self) -> dict[str, str]:
        """The present user of each controller that is in use, in words. A lease that ends soon is waited for by the
        job itself."""
        busy = {controller: run.description for run in self._running.values() for controller in run.needs}
        for held_lease in self._services.leases.all_leases:
            if held_lease.holder not in self._running and not held_lease.brief:
                for controller in group_by_controller(held_lease.axes):
                    busy.setdefault(controller, self._services.leases.describe_use(held_lease))
        return busy

    def _find_condition(self, waiting: WaitingJob) -> str:
        obstacle = self._conditions.find_obstacle(self._find_needs(waiting))
        return "" if obstacle is None else obstacle.describe()

    def find_obstacle(self, job: Job, terms: QueueTerms) -> Obstacle | None:
        """What would keep a job from beginning at once; None: it would begin. Raises `UnknownName`,
        `Refusal`."""
        needs = self._find_needs_of(job.steps)
        stop, is_attended = self.gate.stopped, terms.session is not None
        if stop is not None and not is_attended:
            text = f"the queue is stopped since {stop.utc}: {stop.reason}"
            return Obstacle("queue-stopped", text, "start it: `tutti queue start`")
        busy = self._find_busy()
        if not needs.controllers and not self._count_free_places():
            return Obstacle("busy", WITHOUT_AXES_REASON, "wait for the end of one of them")
        in_use = min(needs.controllers & busy.keys(), default=None)
        if in_use is not None:
            return Obstacle("leased", f"{in_use} is in use: {busy[in_use]}", "wait for the end of that use")
        for waiting_job in [] if is_attended else sort_waiting(self._waiting):
            if not waiting_job.blocking_reason and needs.controllers & self._find_needs(waiting_job).controllers:
                return Obstacle(
                    "queued",
                    f"job {waiting_job.row.name!r} {waiting_job.row.id} comes first",
                    "submit it without `now`",
                )
        return self._conditions.find_obstacle(needs)

    async def _cancel_impatient(self, reasons: Mapping[str, str]) -> None:
        """End the jobs that must begin at once or never, and that would have to wait."""
        for waiting_job in [job for job in self._waiting.values() if job.row.now and job.row.id in reasons]:
            if self._waiting.pop(waiting_job.row.id, None) is not None:
                reason = f"not begun, because it must not wait: {reasons[waiting_job.row.id]}"
                await self._cancel_waiting(waiting_job, reason, "coordinator")

    def _find_needs(self, waiting: WaitingJob) -> JobNeeds:
        """Cached, because the queue may be long; names that the fleet file no longer has are refused at the start."""
        known_needs = self._needs.get(waiting.row.id)
        if known_needs is None:
            row = waiting.row
            try:
                known_needs = self._find_needs_of(waiting.job.steps, row.repeat, row.from_step)
            except (UnknownName, Refusal):
                known_needs = JobNeeds(frozenset())
            self._needs[waiting.row.id] = known_needs
        return known_needs

    def _find_needs_of(self, steps: Sequence[Step], repeat: int = 1, first: int = 0) -> JobNeeds:
        """What steps need from step number `first` on, by the named positions of this moment. Raises `UnknownName`,
        `Refusal`."""
        order = self._services.positions.make_resolver().resolve_remaining(steps, repeat, first)
        return find_needs(self._services.view.fleet, [step.step for step in order.list_remaining(first)])

    def forget_needs(self) -> None:
        """The fleet file, or a named position, has changed."""
        self._needs.clear()
        self.wake_up()

    def _begin_job(self, waiting: WaitingJob) -> None:
        row = waiting.row
        del self._waiting[row.id]
        run = self._running[row.id] = JobRun(self._services, row, waiting.job, self._report_of(row, waiting.job))
        run.needs = self._needs.pop(row.id).controllers
        run.task = asyncio.get_running_loop().create_task(run.run())
        self._spawn(self._finish_job, run, waiting)

    async def _finish_job(self, run: JobRun, waiting: WaitingJob) -> None:
        """Wait for a job's end and record it."""
        assert run.task is not None
        await asyncio.wait([run.task])
        error = None if run.task.cancelled() else run.task.exception()
        if run.task.cancelled() or error is not None:
            outcome = run.make_broken_outcome(error)
            await self._services.leases.release(run.row.id)
        else:
            outcome = run.task.result()
        if outcome.begun:
            await self._record_end(run, outcome)
            await self._protect_queue(run, outcome)
        else:
            if outcome.deviates:
                waiting.row = waiting.row._replace(held_by=APPROVAL, reason=outcome.reason)
                waiting.deviation = outcome.reason
            self._waiting[run.row.id] = waiting
            self._trouble = self._trouble or outcome.trouble
            self._services.log.warning(f"job has to wait: {outcome.reason}", job=run.row.id)
        del self._running[run.row.id]
        if not outcome.begun:
            self._publisher.take_schedule(sort_waiting(self._waiting), {run.row.id: outcome.reason})
        self.wake_up()
        self._publisher.schedule_publication()
        if outcome.deviates:
            await self._void_approval(run.row.id, outcome.reason)

    async def _void_approval(self, job_id: str, reason: str) -> None:
        """Record that a job is held again. Until that is recorded, another leader compares its plan again when it would
        begin. Raises `JournalError`."""
        change = self._services.make_transition("queued", reason, COORDINATOR)
        await self._services.execute(self._services.journal.approvals.void_approval, job_id, change)

    async def _record_end(self, run: JobRun, outcome: JobOutcome) -> None:
        """Record an end as soon as the journal can be written. Its controllers stay taken until then."""
        while True:
            try:
                await self._end_job(
                    run.row, run.job, outcome.report, JobEnd(outcome.state, outcome.reason, outcome.actor)
                )
                return
            except JobHasEnded as error:
                self._services.log.warning(str(error), job=run.row.id)
                return
            except JournalError as error:
                self._services.log.warning(f"the end of a job cannot be recorded yet: {error}", job=run.row.id)
                await sleep_ns(self._services.clock, RETRY_NS)

    async def _protect_queue(self, run: JobRun, outcome: JobOutcome) -> None:
        """Keep other jobs from the same end: a failure holds those that need its controllers, and a step that was
        stopped stops the queue."""
        if outcome.state == "aborted":
            self.gate.note_break(f"job {run.row.id} was stopped: {outcome.reason}")
        if outcome.state != "failed" or self._services.view.fleet.queue.on_failure != "hold":
            return
        affected_ids = [
            job.row.id
            for job in sort_waiting(self._waiting)
            if not job.is_attended and run.needs & self._find_needs(job).controllers
        ]
        for job_id in affected_ids:
            await self._hold_job(job_id, f"job {run.row.id}", f"held: job {run.row.id} has failed: {outcome.reason}")

    # Ends

    async def _end_job(self, row: JobRecord, job: Job, report: JobReport, end: JobEnd) -> None:
        """Record the end of a job, and publish it. Raises `JournalError`; then nothing is recorded or published."""
        services = self._services
        state, reason, actor = end
        transition = services.make_transition(state, reason, actor)
        transitions_before = await services.execute(services.journal.list_transitions, row.id)
        report = report.model_copy(
            update={
                "state": state,
                "reason": reason,
                "ended_utc": transition.utc,
                "transitions": [*transitions_before, transition],
            }
        )
        await services.execute(services.journal.record_transition, row.id, transition, report)
        services.statistics.take_job(report)
        self._needs.pop(row.id, None)
        services.log.info(f"job is {state}: {reason}" if reason else f"job is {state}", job=row.id)
        services.bus.put(services.keys.job_report(row.id), report.to_json(), Priority.EVENT)
        steps = len(StepOrder(job.steps, row.repeat))
        steps_done = sum(step.steps_done for step in report.steps)
        progress = make_queued_progress(row, state, reason, transition.utc, steps).model_copy(
            update={
                "step": min(row.from_step + steps_done, steps - 1),
                "fraction": min(1.0, (row.from_step + steps_done) / steps),
                "remaining_s": 0.0,
            }
        )
        services.bus.put(services.keys.job_state(row.id), progress.to_json(), Priority.EVENT)
        self._spawn(self._settle_followers, row.id)
        self._publisher.schedule_publication()

    async def _settle_followers(self, job_id: str) -> None:
        """Release, or end, the jobs that come after a job that has ended."""
        for waiting_job in [job for job in self._waiting.values() if job.pending == job_id]:
            while True:
                try:
                    await self._settle_follower(waiting_job)
                    break
                except JournalError as error:
                    self._services.log.warning(f"job has to wait: {error}", job=waiting_job.row.id)
                    await sleep_ns(self._services.clock, RETRY_NS)

    async def _settle_follower(self, waiting: WaitingJob) -> None:
        """Release a job from its predecessor, or end it, if the predecessor has ended."""
        services, pending_id = self._services, waiting.pending
        if pending_id is None:
            return
        row = await services.execute(services.journal.load_record, pending_id)
        if row is not None and row.state not in FINISHED_STATES:
            return
        if row is not None and row.state == "done":
            waiting.pending = None
            self.wake_up()
            return
        if self._waiting.pop(waiting.row.id, None) is None:
            return
        text = f"is {row.state}: {row.reason}" if row is not None else "is no longer in the journal"
        await self._cancel_waiting(waiting, f"job {pending_id}, which must be done before, {text}", "coordinator")

    async def _cancel_waiting(self, waiting: WaitingJob, reason: str, actor: str) -> None:
        """End a job that was taken out of the queue; it returns there if its end cannot be recorded."""
        report = self._report_of(waiting.row, waiting.job)
        try:
            await self._end_job(waiting.row, waiting.job, report, JobEnd("cancelled", reason, actor))
        except JournalError:
            self._waiting[waiting.row.id] = waiting
            raise

    def _report_of(self, row: JobRecord, job: Job | None) -> JobReport:
        """Return the report of a job that has not begun. job: None if it cannot be read."""
        return JobReport(
            job_id=row.id,
            name=row.name,
            actor=row.actor,
            state=row.state,
            reason=row.reason,
            epoch=self._services.leadership.epoch,
            submitted_utc=row.submitted_utc,
            max_start_skew_ns=job.max_start_skew if job is not None else 0,
            repeat=row.repeat,
            origin=row.origin,
            from_step=row.from_step,
            parameters_used=job.parameters_used if job is not None else {},
        )

    # Times

    async def _watch_times(self) -> None:
        """Mark jobs as due when their start time has come; missed ones are run or skipped, as their terms say. Cancel
        those that have waited for longer than their terms allow."""
        services = self._services
        while not services.leadership.over:
            utc_now = parse_utc(services.clock.utc())
            time_left = timedelta.max
            for job in list(self._waiting.values()):
                try:
                    time_left = min(time_left, await self._check_times(job, utc_now))
                except JournalError as error:
                    services.log.warning(f"job has to wait: {error}", job=job.row.id)
                    time_left = min(time_left, timedelta(seconds=RETRY_NS / NS_PER_S))
            if time_left == timedelta.max:
                await self._timed.wait()
                self._timed.clear()
            else:
                await sleep_ns(
                    services.clock, min(CLOCK_POLL_NS, round(time_left / timedelta(microseconds=1)) * NS_PER_US)
                )

    async def _check_times(self, waiting: WaitingJob, now: datetime) -> timedelta:
        """Act on the start time and the expiry of a job; return how long neither needs attention."""
        row, time_left = waiting.row, timedelta.max
        if row.expires_utc is not None:
            time_left = parse_utc(row.expires_utc) - now
            if time_left <= timedelta(0):
                reason = f"expired at {row.expires_utc}; last state: {self._publisher.make_entry(row).reason}"
                if self._waiting.pop(row.id, None) is not None:
                    await self._cancel_waiting(waiting, reason, "coordinator")
                return timedelta.max
        if row.due or row.at_utc is None:
            return time_left
        at = parse_utc(row.at_utc)
        if at > now:
            return min(time_left, at - now)
        await self._mark_due(waiting, now - at)
        return time_left

    async def _watch_sessions(self) -> None:
        """End the jobs of commands that have ended: of their processes, or the connections to them."""
        services = self._services
        while not services.leadership.over:
            await sleep_ns(services.clock, SESSION_POLL_NS)
            jobs = chain(self._running.values(), self._waiting.values())
            attended_sessions = [(job.row.session, job.row) for job in jobs if job.row.session is not None]
            absent = self._sessions.find_absent(session for session, _ in attended_sessions)
            for session, row in attended_sessions:
                if session in absent:
                    self._spawn(self._end_unattended, row)

    async def _end_unattended(self, row: JobRecord) -> None:
        reason = f"the command of {row.actor} that waited for it has ended"
        run, waiting_job = self._running.get(row.id), self._waiting.pop(row.id, None)
        if run is not None:
            await run.interrupt_job(JobInterrupted("cancelled", reason, "coordinator"))
        elif waiting_job is not None:
            await self._cancel_waiting(waiting_job, reason, "coordinator")

    async def _mark_due(self, waiting: WaitingJob, late: timedelta) -> None:
        services, row = self._services, waiting.row
        if late > MISSED_AFTER and row.missed == "skip":
            if self._waiting.pop(row.id, None) is not None:
                await self._cancel_waiting(waiting, f"missed: no leader was active at {row.at_utc}", "coordinator")
            return
        reason = (
            f"start time {row.at_utc} has come"
            if late <= MISSED_AFTER
            else f"begins late: no leader was active at {row.at_utc}"
        )
        change = services.make_transition("queued", reason, "coordinator")
        await services.execute(services.journal.mark_due, row.id, change)
        waiting.row = waiting.row._replace(due=True, reason=reason)
        self.wake_up()

    # Holding

    async def _hold_job(self, job_id: str, held_by: str, reason: str) -> None:
        """Hold a waiting job now, and record it. Raises `JournalError`. Does nothing to a held job."""
        services, waiting_job = self._services, self._waiting.get(job_id)
        if waiting_job is None or waiting_job.row.held_by:
            return
        waiting_job.row = waiting_job.row._replace(held_by=held_by)
        change = services.make_transition("queued", reason, held_by)
        await services.execute(services.journal.hold_jobs, [job_id], held_by, change)
        self.wake_up()

    def _count_unattended(self) -> int:
        """The number of waiting jobs that would begin by themselves."""
        return sum(not job.is_attended for job in self._waiting.values())

    def _queue_has_changed(self) -> None:
        self.wake_up()
        self._publisher.schedule_publication()

    def _receive_estop(self, sample: BusSample) -> None:
        """After an e-stop nothing begins by itself when it is reset: neither jobs nor steps."""
        try:
            estop = EstopMessage.read_message(sample.payload)
            actor, detail = estop.actor, f": {estop.reason}" if estop.reason else ""
        except ValidationError:
            actor, detail = "an e-stop", ""
        reason = f"e-stop by {actor}{detail}"
        for run in self._running.values():
            run.abandon(JobInterrupted("aborted", reason, actor))
        self._conditions.note_estop(reason)
        self.gate.stop_queue(reason, actor)

    def find_progress(self, job_id: str) -> JobProgress | None:
        """The progress of a job while it runs."""
        run = self._running.get(job_id)
        return None if run is None else run.make_progress()

    def find_last_motion(self, job_id: str) -> StepReport | None:
        """The last motion step of a running job that has ended."""
        run = self._running.get(job_id)
        return None if run is None else run.last_motion

    def make_queue_state(self, total: int, rows: Iterable[JobRecord]) -> QueueState:
        """Jobs as a list shows them, with the state of the queue."""
        return self._publisher.make_queue_state(total, rows)

    def make_entry(self, row: JobRecord) -> QueueEntry:
        """A job as a list shows it."""
        return self._publisher.make_entry(row)

    # Inside

    def _spawn(self, function: Callable[P, Coroutine[Any, Any, None]], *values: P.args, **names: P.kwargs) -> None:
        async def work() -> None:
            try:
                await function(*values, **names)
            except JournalError as error:
                self._services.log.warning(str(error))

        task = self._services.fleet.tasks.spawn(work(), vital=True)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
