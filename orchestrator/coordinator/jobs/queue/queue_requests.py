"""Changes of the queue that users request: cancellation, holds, releases, approvals and the order."""

import asyncio
from collections.abc import Iterable, Sequence

from orchestrator.coordinator.jobs.queue.deliberate_starts import DeliberateStarts
from orchestrator.coordinator.jobs.queue.ends import JobEnds
from orchestrator.coordinator.jobs.queue.publisher import QueuePublisher
from orchestrator.coordinator.jobs.queue.queue_order import WaitingJob
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.run.outcome import JobInterrupted
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.approval import JobApproval


class QueueRequests:
    """Changes waiting jobs. All methods raise `Refusal` and `JournalError`."""

    def __init__(
        self,
        services: JobServices,
        register: JobRegister,
        publisher: QueuePublisher,
        ends: JobEnds,
        *,
        starts: DeliberateStarts,
    ) -> None:
        self._services = services
        self._register = register
        self._publisher = publisher
        self._ends = ends
        self._starts = starts
        self._arranging = asyncio.Lock()

    async def cancel_job(self, job_id: str, actor: str) -> None:
        """Cancel a queued or running job. Raises `Refusal`, `JournalError`, as all requests here do."""
        run = self._register.running.get(job_id)
        if run is not None:
            await run.interrupt_job(JobInterrupted("cancelled", f"cancelled by {actor}", actor))
            return
        waiting_job = self._register.waiting.pop(job_id, None)
        if waiting_job is None:
            raise await self._register.make_refusal(job_id, "not-queued", "try again in a moment")
        await self._ends.cancel_waiting(waiting_job, f"cancelled by {actor}", actor)
        self._register.wake_up()

    async def hold_jobs(self, job_ids: Iterable[str], actor: str) -> None:
        """Hold queued jobs until they are released."""
        for job_id in job_ids:
            if job_id not in self._register.waiting:
                raise await self._register.make_refusal(job_id, "not-queued", "pause it: `tutti job pause`")
            await self.hold_job(job_id, actor, f"held by {actor}")

    async def hold_job(self, job_id: str, held_by: str, reason: str) -> None:
        """Hold a waiting job now, and record it. Raises `JournalError`. Does nothing to a held job."""
        services, waiting_job = self._services, self._register.waiting.get(job_id)
        if waiting_job is None or (waiting_job.row.held_by and not waiting_job.awaits_word):
            return
        waiting_job.row = waiting_job.row._replace(held_by=held_by)
        change = services.make_transition("queued", reason, held_by)
        await services.execute(services.journal.hold_jobs, [job_id], held_by, change)
        self._register.wake_up()

    async def release_jobs(self, job_ids: Sequence[str], actor: str, shown: str = "") -> None:
        """Release held jobs; without ids, all held jobs but those that wait for approval, or for a word. shown: of the
        preview of these jobs, for those that had to wait for a cause."""
        register = self._register
        held_jobs = [
            job for job in register.waiting.values() if job.row.held_by and not (job.awaits_approval or job.awaits_word)
        ]
        named_jobs = [register.waiting[job_id] for job_id in job_ids if job_id in register.waiting]
        self._starts.require_release(named_jobs, shown)
        for job_id in list(job_ids) or [job.row.id for job in held_jobs]:
            waiting_job = await self._register.find_waiting(job_id, "for a paused job: `tutti job resume`")
            if waiting_job.awaits_approval:
                remedy = f"look at its plan and approve it: `tutti job approve {job_id}`"
                raise Refusal("awaits-approval", f"job {job_id} waits for the approval of its plan", remedy)
            if waiting_job.row.held_by:
                await self._register.clear_hold(waiting_job, f"released by {actor}", actor)

    async def approve_job(self, waiting: WaitingJob, approval: JobApproval) -> None:
        """Record the approval of a job's plan, and release the job if it waits for that. A hold by a user stays."""
        services, job_id = self._services, waiting.row.id
        change = services.make_transition("queued", f"plan {approval.plan.hash} approved", approval.actor)
        is_stored = await services.execute(services.journal.approvals.approve_job, approval, change)
        if not is_stored or self._register.waiting.get(job_id) is not waiting:
            raise await self._register.make_refusal(job_id, "not-queued", "only a job that waits can be approved")
        held_by = "" if waiting.awaits_approval else waiting.row.held_by
        waiting.row = waiting.row._replace(held_by=held_by, reason=change.reason)
        waiting.deviation = ""
        self._register.wake_up()

    async def reorder_job(self, job_id: str, before: str, actor: str) -> None:
        """Move a queued job before another one, with that one's priority."""
        for waiting_id in (job_id, before):
            if waiting_id not in self._register.waiting:
                raise await self._register.make_refusal(
                    waiting_id, "not-queued", "only queued jobs have a place in the queue"
                )
        if job_id == before:
            raise Refusal("same-job", f"job {job_id} cannot be moved before itself", "choose another job")
        async with self._arranging:
            moved_job, other_job = self._register.waiting[job_id], self._register.waiting[before]
            order = [job for job in self._register.list_waiting() if job is not moved_job]
            order.insert(order.index(other_job), moved_job)
            ranks = sorted(job.row.place for job in order)
            places = {job.row.id: rank for job, rank in zip(order, ranks, strict=True) if job.row.place != rank}
            services, priority = self._services, other_job.row.priority
            change = services.make_transition("queued", f"moved before job {before} by {actor}", actor)
            await services.execute(services.journal.reorder_jobs, job_id, priority, places, change)
            for job in order:
                job.row = job.row._replace(place=places.get(job.row.id, job.row.place))
            moved_job.row = moved_job.row._replace(priority=priority, reason=change.reason)
        self._register.wake_up()
        self._publisher.schedule_publication()
