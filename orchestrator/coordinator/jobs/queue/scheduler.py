"""The scheduler of waiting and running jobs. Each change of a job's state is in the journal before it is on the bus,
except those inside a motion (`RunState.note_state`).

`register` keeps the jobs, `queue` decides which of the waiting ones begin, `conditions` what they wait for outside the
queue, `queue_gate` whether any begins; `job_run` executes one, and `ends` records its end. `queue_requests` and
`run_requests` are what users change, `times` and `attendance` what ends or begins jobs without a request.
"""

import asyncio
from collections.abc import Mapping

from orchestrator.bus.base import BusDeclaration, BusSample
from orchestrator.bus.latch import read_estop
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.coordinator.jobs.queue.attendance import SessionMonitor
from orchestrator.coordinator.jobs.queue.conditions import Obstacle, WorldConditions
from orchestrator.coordinator.jobs.queue.deliberate_starts import DeliberateStarts
from orchestrator.coordinator.jobs.queue.ends import RETRY_NS, JobEnd, JobEnds
from orchestrator.coordinator.jobs.queue.journal_tasks import JournalTasks
from orchestrator.coordinator.jobs.queue.publisher import QueuePublisher, describe_stop
from orchestrator.coordinator.jobs.queue.queue_gate import COORDINATOR, QueueGate
from orchestrator.coordinator.jobs.queue.queue_order import WITHOUT_AXES_REASON, Schedule, WaitingJob
from orchestrator.coordinator.jobs.queue.queue_requests import QueueRequests
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.queue.run_requests import RunRequests
from orchestrator.coordinator.jobs.queue.times import JobTimes
from orchestrator.coordinator.jobs.run.job_run import JobRun
from orchestrator.coordinator.jobs.run.outcome import JobInterrupted, JobOutcome
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobHasEnded, JobRecord, JournalError
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import StopMode
from orchestrator.model.queue import APPROVAL, QueueTerms

SCHEDULE_DELAY_PER_JOB_NS = 20 * NS_PER_US  # per job
CLOSE_S = 5.0  # for running jobs to stop, and for their ends to be recorded
CONDITION_POLL_NS = 100 * NS_PER_MS  # period of looking at the conditions of the jobs that wait for one


class Scheduler:
    """Begins jobs as soon as the controllers that they need are free, and records how they end."""

    def __init__(self, services: JobServices) -> None:
        self._services = services
        self._tasks = JournalTasks(services)
        self.register = register = JobRegister(services)
        self.publisher = publisher = QueuePublisher(services, register)
        self.gate = QueueGate(services, register, publisher)
        self.ends = ends = JobEnds(services, register, publisher, self._tasks)
        self._conditions = WorldConditions(services.fleet, services.copies)
        self.starts = DeliberateStarts(services, register, self._conditions)
        self.queue_requests = QueueRequests(services, register, publisher, ends, starts=self.starts)
        self.run_requests = RunRequests(services, register)
        self._times = JobTimes(services, register, publisher, ends)
        self._sessions = SessionMonitor(services, register, ends, self._tasks)
        self._trouble = False
        self._declared: list[BusDeclaration] = []
        self.is_leaving = False
        """No job begins any more: another coordinator is about to lead."""
        services.leases.add_release_listener(lambda _: register.wake_up())
        services.fleet.permits.on_change = publisher.note_change
        services.copies.on_change = publisher.note_change

    async def start(self) -> None:
        """End the jobs that an earlier leader left running, then begin with the queue. Raises `JournalError`."""
        services = self._services
        remaining_jobs: list[tuple[JobRecord, Job]] = []
        is_damaged = False
        for row in await services.execute(services.journal.list_unfinished):
            job = await self.ends.load_job(row)
            if job is None:
                is_damaged = True
            elif row.state == "queued":
                waiting_job = self.register.waiting[row.id] = WaitingJob(row, job, row.after)
                if waiting_job.awaits_approval:
                    approval = await self._services.load_approval(row.id)
                    waiting_job.deviation = "" if approval is None else approval.void
            else:
                remaining_jobs.append((row, job))
        for row, job in remaining_jobs:
            reason = f"the coordinator ended while the job was {row.state}"
            await self.ends.end_job(
                row, job, self.ends.make_report(row, job), JobEnd("interrupted", reason, COORDINATOR)
            )
        for waiting_job in list(self.register.waiting.values()):
            await self.ends.settle_follower(waiting_job)
        await self.gate.start(interrupted=bool(remaining_jobs) or is_damaged)
        await self._sessions.start()
        self._declared.append(await services.bus.subscribe(services.keys.estop, self._receive_estop))
        self._tasks.spawn(self._schedule_jobs)
        self._tasks.spawn(self._times.watch_times)
        self._tasks.spawn(self._sessions.watch_sessions)
        self.register.wake_up()
        self.publisher.schedule_publication()

    async def close(self, reason: str) -> None:
        """End: running jobs are stopped and recorded as interrupted."""
        for declaration in self._declared:
            await declaration.undeclare()
        await self._sessions.close()
        self.gate.close()
        runs = list(self.register.running.values())
        await self.interrupt_jobs(JobInterrupted("interrupted", reason, COORDINATOR))
        ends = [run.task for run in runs if run.task is not None]
        if ends:
            await asyncio.wait(ends, timeout=CLOSE_S)
            # Their ends are recorded by tasks of this scheduler.
            until_ns = self._services.clock.now_ns() + round(CLOSE_S * NS_PER_S)
            while self.register.running and self._services.clock.now_ns() < until_ns:
                await sleep_ns(self._services.clock, NS_PER_MS)
        self.publisher.close()
        self._tasks.cancel_all()

    async def enter_job(self, row: JobRecord, job: Job) -> None:
        """Enter a job that was accepted."""
        waiting_job = self.register.waiting[row.id] = WaitingJob(row, job, row.after)
        await self.ends.settle_follower(waiting_job)
        self._times.note_entry()
        self.register.wake_up()
        self.publisher.schedule_publication()

    async def stop_jobs(self, interrupt: JobInterrupted, mode: StopMode = "decelerate") -> None:
        """Stop all running jobs and the queue: nothing begins by itself after a stop."""
        self.gate.stop_queue(interrupt.reason, interrupt.actor)
        await self.interrupt_jobs(interrupt, mode)

    async def interrupt_jobs(self, interrupt: JobInterrupted, mode: StopMode = "decelerate") -> None:
        """Stop and end all running jobs."""
        await asyncio.gather(*(run.interrupt_job(interrupt, mode) for run in self.register.running.values()))

    # Scheduling loop

    async def _schedule_jobs(self) -> None:
        services = self._services
        while not services.leadership.over:
            await self.register.changed.wait()
            self.register.changed.clear()
            if self._trouble:
                await sleep_ns(services.clock, RETRY_NS)
                self._trouble = False
                self.register.wake_up()
            # A long queue is scheduled less often: a pass takes some microseconds per job.
            await sleep_ns(services.clock, len(self.register.waiting) * SCHEDULE_DELAY_PER_JOB_NS)
            if self.is_leaving:
                continue
            choice = self._make_schedule()
            if choice.waits_for_world:
                services.clock.call_at_ns(services.clock.now_ns() + CONDITION_POLL_NS, self.register.wake_up)
            for job in choice.begin:
                self._begin_job(job)
            await self._cancel_impatient(choice.reasons)
            if choice.causes:
                self._tasks.spawn(self.starts.mark_jobs, choice.causes)
            self.publisher.take_schedule(self.register.list_waiting(), choice.reasons, choice.ready)
            if choice.begin:
                self.publisher.schedule_publication()

    def _make_schedule(self) -> Schedule:
        stop = self.register.stopped
        return self.starts.choose("" if stop is None else describe_stop(stop))

    def find_obstacle(self, job: Job, terms: QueueTerms) -> Obstacle | None:
        """What would keep a job from beginning at once; None: it would begin. Raises `UnknownName`,
        `Refusal`."""
        register = self.register
        needs = register.find_needs_of(job.steps)
        stop, is_attended = register.stopped, terms.session is not None
        if stop is not None and not is_attended:
            text = f"the queue is stopped since {stop.utc}: {stop.reason}"
            return Obstacle("queue-stopped", text, "start it: `tutti queue start`")
        busy = register.find_busy()
        if not needs.controllers and not register.count_free_places():
            return Obstacle("busy", WITHOUT_AXES_REASON, "wait for the end of one of them")
        lent = register.find_lent() if is_attended else frozenset[str]()
        in_use = min(needs.controllers & busy.keys() - lent, default=None)
        if in_use is not None:
            return Obstacle("leased", f"{in_use} is in use: {busy[in_use]}", "wait for the end of that use")
        for waiting_job in [] if is_attended else self.register.list_waiting():
            if (
                not waiting_job.blocking_reason
                and needs.controllers & self.register.find_needs(waiting_job).controllers
            ):
                return Obstacle(
                    "queued",
                    f"job {waiting_job.row.name!r} {waiting_job.row.id} comes first",
                    "submit it without `now`",
                )
        return self._conditions.find_obstacle(needs)

    async def _cancel_impatient(self, reasons: Mapping[str, str]) -> None:
        """End the jobs that must begin at once or never, and that would have to wait."""
        for waiting_job in [job for job in self.register.waiting.values() if job.row.now and job.row.id in reasons]:
            if self.register.waiting.pop(waiting_job.row.id, None) is not None:
                reason = f"not begun, because it must not wait: {reasons[waiting_job.row.id]}"
                try:
                    await self.ends.cancel_waiting(waiting_job, reason, COORDINATOR)
                except JournalError as error:
                    # It is in the queue again, and this is tried again.
                    self._services.log.warning(str(error), job=waiting_job.row.id)
                    self._trouble = True
                    self.register.wake_up()

    def _begin_job(self, waiting: WaitingJob) -> None:
        row = waiting.row
        del self.register.waiting[row.id]
        needs = self.register.take_needs(row.id).controllers
        run = JobRun(self._services, row, waiting.job, self.ends.make_report(row, waiting.job), needs)
        self.register.running[row.id] = run
        run.task = asyncio.get_running_loop().create_task(run.run())
        self._tasks.spawn(self._finish_job, run, waiting)

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
            self.register.waiting[run.row.id] = waiting
            self._trouble = self._trouble or outcome.trouble
            self._services.log.warning(f"job has to wait: {outcome.reason}", job=run.row.id)
        del self.register.running[run.row.id]
        if not outcome.begun:
            self.publisher.take_schedule(self.register.list_waiting(), {run.row.id: outcome.reason})
        self.register.wake_up()
        self.publisher.schedule_publication()
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
                await self.ends.end_job(
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
            for job in self.register.list_waiting()
            if not job.is_attended and run.needs & self.register.find_needs(job).controllers
        ]
        for job_id in affected_ids:
            await self.queue_requests.hold_job(
                job_id, f"job {run.row.id}", f"held: job {run.row.id} has failed: {outcome.reason}"
            )

    def _receive_estop(self, sample: BusSample) -> None:
        """After an e-stop nothing begins by itself when it is reset: neither jobs nor steps."""
        estop = read_estop(sample.payload, self._services.clock.utc())
        reason = estop.describe()
        for run in self.register.running.values():
            run.abandon(JobInterrupted("aborted", reason, estop.actor))
        self._conditions.note_estop(estop)
        self.gate.stop_queue(reason, estop.actor)
