"""Publication of the queue: lists of jobs, and what each one waits for."""

import asyncio
from collections.abc import Iterable, Mapping, Sequence, Set

from orchestrator.bus.base import Priority
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.coordinator.jobs.queue.queue_order import WaitingJob
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.model.queue import QueueStop
from orchestrator.model.report import FINISHED_STATES, QueueEntry, QueueState, make_queued_progress
from orchestrator.model.steps.order import StepOrder

MAX_PUBLISHED_JOBS = 200  # entries of the queue on the bus; those after them wait long anyway
FIRST_DELAY_NS = NS_PER_MS  # a job that has just been accepted is scheduled first
MIN_INTERVAL_NS = 50 * NS_PER_MS  # minimum time between two publications of the queue


class QueuePublisher:
    """Publishes the waiting and the running jobs."""

    def __init__(self, services: JobServices, register: JobRegister) -> None:
        self._services = services
        self._register = register
        self._places: Mapping[str, int] = {}
        self._reasons: Mapping[str, str] = {}
        self._ready: Set[str] = frozenset()
        self._told: dict[str, str] = {}
        self._changed = False
        self._announcing: asyncio.Task[None] | None = None

    def close(self) -> None:
        if self._announcing is not None:
            self._announcing.cancel()

    def make_queue_state(self, total: int, rows: Iterable[JobRecord]) -> QueueState:
        """A list of jobs with the state of the queue."""
        return QueueState(
            total=total,
            jobs=self.make_entries(rows),
            stopped=self._register.stopped,
            waiting=len(self._register.waiting),
            missing_permits=self._services.fleet.permits.list_missing(),
            journal=self._services.copies.mode,
        )

    def make_entries(self, rows: Iterable[JobRecord]) -> list[QueueEntry]:
        """List entries of jobs, with the reasons for waiting that only the current leader has."""
        return [self.make_entry(row) for row in rows]

    def make_entry(self, row: JobRecord) -> QueueEntry:
        """The list entry of a job. It has its place as soon as the scheduler has decided that it waits."""
        register = self._register
        run, waiting_job, stop = register.running.get(row.id), register.waiting.get(row.id), register.stopped
        usual = row.reason
        if waiting_job is not None:
            row = waiting_job.row
            # A job that has just been accepted has not been scheduled yet.
            usual = describe_stop(stop) if stop is not None and not waiting_job.is_attended else row.reason
        return QueueEntry(
            id=row.id,
            name=row.name,
            actor=row.actor,
            state=run.state if run is not None and row.state not in FINISHED_STATES else row.state,
            reason=row.reason if waiting_job is None else self._reasons.get(row.id, usual),
            submitted_utc=row.submitted_utc,
            place=None if waiting_job is None else self._places.get(row.id),
            terms=row.terms,
            held_by=row.held_by,
            origin=row.origin,
            from_step=row.from_step,
            proposed=bool(row.proposed),
            ready=row.id in self._ready,
        )

    def note_change(self) -> None:
        """The queue has changed: schedule its jobs again, and publish it."""
        self._register.wake_up()
        self.schedule_publication()

    def schedule_publication(self) -> None:
        """Publish the queue: soon after a quiet time, else when one has passed."""
        self._changed = True
        if self._announcing is None or self._announcing.done():
            self._announcing = self._services.fleet.tasks.spawn(self._publish_queue(), vital=True)

    async def _publish_queue(self) -> None:
        await sleep_ns(self._services.clock, FIRST_DELAY_NS)
        while self._changed:
            self._changed = False
            rows = [run.row for run in self._register.running.values()]
            rows += [job.row for job in self._register.list_waiting()[:MAX_PUBLISHED_JOBS]]
            total = len(self._register.running) + len(self._register.waiting)
            state = self.make_queue_state(total, rows[:MAX_PUBLISHED_JOBS])
            self._services.bus.put(self._services.keys.queue, state.to_json(), Priority.EVENT)
            await sleep_ns(self._services.clock, MIN_INTERVAL_NS)

    def take_schedule(
        self, order: Sequence[WaitingJob], reasons: Mapping[str, str], ready: Set[str] = frozenset()
    ) -> None:
        """Take over what each job waits for, in the queue's order; publish changes of the jobs that are shown. ready:
        those whose start has to be asked for."""
        is_changed = ready != self._ready
        self._ready = ready
        self._places = {job.row.id: rank for rank, job in enumerate(order, 1)}
        self._reasons = reasons
        published_reasons: dict[str, str] = {}
        for job in order[:MAX_PUBLISHED_JOBS]:
            row = job.row
            reason = published_reasons[row.id] = reasons.get(row.id, row.reason)
            if self._told.get(row.id) != reason:
                steps = len(StepOrder(job.job.steps, row.repeat))
                progress = make_queued_progress(row, "queued", reason, self._services.clock.utc(), steps)
                progress = progress.model_copy(update={"ready": row.id in ready})
                self._services.bus.put(self._services.keys.job_state(row.id), progress.to_json(), Priority.STATE)
        self._told = published_reasons
        if is_changed:
            self.schedule_publication()


def describe_stop(stop: QueueStop) -> str:
    """Why no job of the queue begins, for a job that waits."""
    return f"the queue is stopped ({stop.reason}): `tutti queue start`"
