"""Requests about the queue as a whole, and about jobs that wait in it."""

from orchestrator.client.points import PointRequests
from orchestrator.model.jobs.service import JobReference, JobReferences, JobsPruned, PruneJobs, ReorderJob
from orchestrator.model.messages import Reply, Request
from orchestrator.model.operation.approval import ApproveJob, JobPlan, JobPlanned

PRUNE_S = 60.0


class QueueRequests(PointRequests):
    """Start and stop the queue, and change what waits in it."""

    async def start_queue(self) -> None:
        """Let the jobs of the queue begin again after a break or a stop. Raises `Refusal`."""
        await self.request_service("start-queue", Request(**self.request_fields()), Reply)

    async def stop_queue(self) -> None:
        """Let no further job begin; running jobs continue. Raises `Refusal`."""
        await self.request_service("stop-queue", Request(**self.request_fields()), Reply)

    async def hold_jobs(self, *job_ids: str) -> None:
        """Hold queued jobs until they are released. Raises `Refusal`: code `not-queued`."""
        await self.request_service("hold", JobReferences(**self.request_fields(), job_ids=list(job_ids)), Reply)

    async def release_jobs(self, *job_ids: str) -> None:
        """Release held jobs; without ids, all held jobs but those that wait for approval. Raises `Refusal`: code
        `awaits-approval`."""
        await self.request_service("release", JobReferences(**self.request_fields(), job_ids=list(job_ids)), Reply)

    async def plan_job(self, job_id: str) -> JobPlanned:
        """What a waiting job would do if it began now, as a plan with a hash, and what differs from the plan that was
        approved last. Raises `Refusal`: codes `not-queued`, and `absent`, `offline`, `moving` if it is not known."""
        return await self.request_service("plan", JobReference(**self.request_fields(), job_id=job_id), JobPlanned)

    async def approve_job(self, job_id: str, plan: JobPlan | str) -> None:
        """Approve the plan of a proposed job, and release it: it begins only with this plan. plan: the one that was
        seen, or its hash. Raises `Refusal`: codes `plan-changed`, `not-proposed`, `not-queued`, `journal`."""
        plan_hash = plan.hash if isinstance(plan, JobPlan) else plan
        request = ApproveJob(**self.request_fields(), job_id=job_id, plan=plan_hash)
        await self.request_service("approve", request, Reply)

    async def reorder_job(self, job_id: str, before: str) -> None:
        """Move a queued job before another one, with that one's priority. Raises `Refusal`: code `not-queued`."""
        await self.request_service("reorder", ReorderJob(**self.request_fields(), job_id=job_id, before=before), Reply)

    async def prune_jobs(self, older_s: float, keep: int) -> int:
        """Delete finished jobs that were submitted more than `older_s` ago, except the newest `keep`; return how
        many."""
        request = PruneJobs(**self.request_fields(), older_s=older_s, keep=keep)
        return (await self.request_service("prune", request, JobsPruned, PRUNE_S)).jobs
