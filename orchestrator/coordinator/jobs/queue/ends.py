"""Ends of jobs: recorded, published, and passed on to the jobs that come after them."""

from typing import NamedTuple

from orchestrator.bus.base import Priority
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.jobs.queue.journal_tasks import JournalTasks
from orchestrator.coordinator.jobs.queue.publisher import QueuePublisher
from orchestrator.coordinator.jobs.queue.queue_gate import COORDINATOR
from orchestrator.coordinator.jobs.queue.queue_order import WaitingJob
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import DamagedRecord, JobRecord, JournalError
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import AdoptedReply
from orchestrator.model.report import FINISHED_STATES, JobReport, JobState, make_queued_progress
from orchestrator.model.steps.order import StepOrder

RETRY_NS = 5 * NS_PER_S  # before another try on a journal that could not be written


class JobEnd(NamedTuple):
    """How a job ends: its state, the reason, and what caused it."""

    state: JobState
    reason: str
    actor: str


class JobEnds:
    """Records and publishes the ends of jobs."""

    def __init__(
        self, services: JobServices, register: JobRegister, publisher: QueuePublisher, tasks: JournalTasks
    ) -> None:
        self._services = services
        self._register = register
        self._publisher = publisher
        self._tasks = tasks

    async def load_job(self, row: JobRecord) -> Job | None:
        """The job of a record; None if record or job is damaged: that one has failed then, and the others are run."""
        services, damage = self._services, row.damage
        if not damage:
            try:
                return await services.load_job(row.id)
            except DamagedRecord as error:
                damage = error.text
        services.log.warning(f"job cannot be run: {damage}", job=row.id)
        transition = services.make_transition("failed", damage, COORDINATOR)
        changes = {"state": "failed", "reason": damage, "ended_utc": transition.utc, "transitions": [transition]}
        report = self.make_report(row, None).model_copy(update=changes)
        await services.execute(services.journal.fail_damaged, row, transition, report)
        return None

    async def end_job(self, row: JobRecord, job: Job, report: JobReport, end: JobEnd) -> None:
        """Record the end of a job, and publish it. Raises `JournalError`; then nothing is recorded or published."""
        services = self._services
        state, reason, actor = end
        transition = services.make_transition(state, reason, actor)
        update = {"state": state, "reason": reason, "ended_utc": transition.utc}
        report = report.model_copy(update=update).judge()
        report = await services.execute(services.journal.record_end, row.id, transition, report)
        services.statistics.take_job(report)
        self._register.drop_needs(row.id)
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
        self._tasks.spawn(self.settle_followers, row.id)
        self._publisher.schedule_publication()

    async def settle_followers(self, job_id: str) -> None:
        """Release, or end, the jobs that come after a job that has ended."""
        for waiting_job in [job for job in self._register.waiting.values() if job.pending == job_id]:
            while True:
                try:
                    await self.settle_follower(waiting_job)
                    break
                except JournalError as error:
                    self._services.log.warning(f"job has to wait: {error}", job=waiting_job.row.id)
                    await sleep_ns(self._services.clock, RETRY_NS)

    async def settle_follower(self, waiting: WaitingJob) -> None:
        """Release a job from its predecessor, or end it, if the predecessor has ended."""
        services, pending_id = self._services, waiting.pending
        if pending_id is None:
            return
        row = await services.execute(services.journal.load_record, pending_id)
        if row is not None and row.state not in FINISHED_STATES:
            return
        if row is not None and row.state == "done":
            waiting.pending = None
            self._register.wake_up()
            return
        if self._register.waiting.pop(waiting.row.id, None) is None:
            return
        text = f"is {row.state}: {row.reason}" if row is not None else "is no longer in the journal"
        await self.cancel_waiting(waiting, f"job {pending_id}, which must be done before, {text}", COORDINATOR)

    async def cancel_waiting(self, waiting: WaitingJob, reason: str, actor: str) -> None:
        """End a job that was taken out of the queue; it returns there if its end cannot be recorded."""
        await self._end_waiting(waiting, JobEnd("cancelled", reason, actor))

    async def end_unknown_work(self, controller: str, reply: AdoptedReply) -> None:
        """End a waiting job for which a controller has worked: the journal does not know of it, because it is a copy
        that was promoted while it lacked the last records. It must not begin anew; it is tried until it is recorded."""
        while (waiting_job := self._register.waiting.pop(reply.last_job, None)) is not None:
            step = "" if reply.last_step is None else f" step {reply.last_step + 1} of"
            reason = f"{controller} has begun{step} this job, which the journal does not know: it has lost records"
            try:
                await self._end_waiting(waiting_job, JobEnd("interrupted", reason, COORDINATOR))
            except JournalError as error:
                self._services.log.warning(f"the end of a job cannot be recorded yet: {error}", job=reply.last_job)
                await sleep_ns(self._services.clock, RETRY_NS)

    async def _end_waiting(self, waiting: WaitingJob, end: JobEnd) -> None:
        report = self.make_report(waiting.row, waiting.job)
        try:
            await self.end_job(waiting.row, waiting.job, report, end)
        except JournalError:
            self._register.waiting[waiting.row.id] = waiting
            raise

    def make_report(self, row: JobRecord, job: Job | None) -> JobReport:
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
