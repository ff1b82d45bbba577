"""The waiting and the running jobs of the leader, and the controllers that each of them needs."""

import asyncio
from collections.abc import Sequence

from orchestrator.coordinator.jobs.queue.conditions import JobNeeds, find_needs
from orchestrator.coordinator.jobs.queue.queue_order import MAX_JOBS_WITHOUT_AXES, WaitingJob, sort_waiting
from orchestrator.coordinator.jobs.run.job_run import JobRun
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.queue import QueueStop
from orchestrator.model.report import FINISHED_STATES
from orchestrator.model.steps.base import Step


class JobRegister:
    """The jobs of the leader by id. stopped: why no waiting job begins by itself; None: the queue is not stopped.
    changed: set when a controller has become free, or the queue has changed."""

    def __init__(self, services: JobServices) -> None:
        self.waiting: dict[str, WaitingJob] = {}
        self.running: dict[str, JobRun] = {}
        self.stopped: QueueStop | None = None
        self.changed = asyncio.Event()
        self._services = services
        self._needs: dict[str, JobNeeds] = {}

    def wake_up(self) -> None:
        """Schedule again: a controller has become free, or the queue has changed."""
        self.changed.set()

    def list_waiting(self) -> list[WaitingJob]:
        """The queue, first job first."""
        return sort_waiting(self.waiting)

    def count_unattended(self) -> int:
        """The number of waiting jobs that would begin by themselves."""
        return sum(not job.is_attended for job in self.waiting.values())

    def count_free_places(self) -> int:
        """How many more jobs without axes may run."""
        return max(0, MAX_JOBS_WITHOUT_AXES - sum(not run.needs for run in self.running.values()))

    def find_busy(self) -> dict[str, str]:
        """The present user of each controller that is in use, in words. A lease that ends soon is waited for by the
        job itself."""
        busy = {controller: run.description for run in self.running.values() for controller in run.needs}
        for held_lease in self._services.leases.all_leases:
            if held_lease.holder not in self.running and not held_lease.brief:
                for controller in group_by_controller(held_lease.axes):
                    busy.setdefault(controller, self._services.leases.describe_use(held_lease))
        return busy

    def find_lent(self) -> frozenset[str]:
        """The controllers that only jobs use which wait for a person, so that commands of persons may use them."""
        lent, used = set[str](), set[str]()
        if not any(run.lends_axes for run in self.running.values()):
            return frozenset()
        for run in self.running.values():
            (lent if run.lends_axes else used).update(run.needs)
        for held_lease in self._services.leases.all_leases:
            used.update(group_by_controller(held_lease.axes))
        return frozenset(lent - used)

    def find_needs(self, waiting: WaitingJob) -> JobNeeds:
        """Cached, because the queue may be long; names that the fleet file no longer has are refused at the start."""
        known_needs = self._needs.get(waiting.row.id)
        if known_needs is None:
            row = waiting.row
            try:
                known_needs = self.find_needs_of(waiting.job.steps, row.repeat, row.from_step)
            except (UnknownName, Refusal):
                known_needs = JobNeeds(frozenset())
            self._needs[waiting.row.id] = known_needs
        return known_needs

    def find_needs_of(self, steps: Sequence[Step], repeat: int = 1, first: int = 0) -> JobNeeds:
        """What steps need from step number `first` on, by the named positions of this moment. Raises `UnknownName`,
        `Refusal`."""
        order = self._services.positions.make_resolver().resolve_remaining(steps, repeat, first)
        return find_needs(self._services.view.fleet, [step.step for step in order.list_remaining(first)])

    def forget_needs(self) -> None:
        """The fleet file, or a named position, has changed."""
        self._needs.clear()
        self.wake_up()

    def take_needs(self, job_id: str) -> JobNeeds:
        """What a job needs that begins; it is not kept."""
        return self._needs.pop(job_id)

    def drop_needs(self, job_id: str) -> None:
        """A job has ended."""
        self._needs.pop(job_id, None)

    async def find_waiting(self, job_id: str, remedy: str) -> WaitingJob:
        """A job that waits. Raises `Refusal` with this remedy for one that does not."""
        waiting_job = self.waiting.get(job_id)
        if waiting_job is None:
            raise await self.make_refusal(job_id, "not-queued", remedy)
        return waiting_job

    async def clear_hold(self, waiting: WaitingJob, reason: str, actor: str) -> None:
        """Record that a job is not held any more. Raises `JournalError`; then it is."""
        services = self._services
        change = services.make_transition("queued", reason, actor)
        await services.execute(services.journal.hold_jobs, [waiting.row.id], "", change)
        waiting.row = waiting.row._replace(held_by="", reason=change.reason)
        self.wake_up()

    async def make_refusal(self, job_id: str, code: str, remedy: str) -> Refusal:
        """The refusal of a request that does not fit the state of the job."""
        row = await self._services.execute(self._services.journal.load_record, job_id)
        if row is None:
            return Refusal("unknown-job", f"no job {job_id}", "see `tutti job ls`")
        state = self.running[job_id].state if job_id in self.running else row.state
        if state in FINISHED_STATES:
            return Refusal("ended", f"job {job_id} is {state} already")
        return Refusal(code, f"job {job_id} is {state}", remedy)
