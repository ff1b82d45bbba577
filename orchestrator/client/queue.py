"""Requests about the queue as a whole, about jobs that wait in it, and about one that waits armed."""

from orchestrator.client.point_follow import FollowRequests
from orchestrator.model.jobs.restart import PreviewStart, ReleaseJobs, StartPreview, StartQueue
from orchestrator.model.jobs.service import (
    GoJob,
    JobGone,
    JobReference,
    JobReferences,
    JobsPruned,
    PruneJobs,
    ReorderJob,
)
from orchestrator.model.messages import Reply, Request
from orchestrator.model.operation.approval import ApproveJob, JobPlan, JobPlanned

PRUNE_S = 60.0
GO_S = 20.0  # for the answer to `go`, which waits where the controllers are just being loaded anew


class QueueRequests(FollowRequests):
    """Start and stop the queue, and change what waits in it."""

    async def preview_start(self, *job_ids: str) -> StartPreview:
        """What would move first if these jobs were released; without any, if the queue was started. Raises `Refusal`:
        code `not-queued`."""
        request = PreviewStart(**self.request_fields(), job_ids=list(job_ids))
        return await self.request_service("preview-start", request, StartPreview)

    async def start_queue(self, preview: StartPreview | None = None) -> StartPreview:
        """Let the jobs of the queue begin again after a break or a stop, and those that had to wait for a cause which
        is gone. preview: what was shown to a person; without one, what would move at this moment. Returns it. Raises
        `Refusal`: code `not-shown` if something else would move first by now."""
        shown_preview = preview or await self.preview_start()
        request = StartQueue(**self.request_fields(), shown=shown_preview.shown)
        await self.request_service("start-queue", request, Reply)
        return shown_preview

    async def stop_queue(self) -> None:
        """Let no further job begin; running jobs continue. Raises `Refusal`."""
        await self.request_service("stop-queue", Request(**self.request_fields()), Reply)

    async def hold_jobs(self, *job_ids: str) -> None:
        """Hold queued jobs until they are released. Raises `Refusal`: code `not-queued`."""
        await self.request_service("hold", JobReferences(**self.request_fields(), job_ids=list(job_ids)), Reply)

    async def release_jobs(self, *job_ids: str, preview: StartPreview | None = None) -> None:
        """Release held jobs, and give the word for jobs that had to wait for a cause; without ids, all held jobs but
        those that wait for approval or for a word. preview: what was shown to a person; without one, what these jobs
        would move at this moment. Raises `Refusal`: codes `awaits-approval`, `cause-lasts`, `not-shown`."""
        if job_ids and preview is None:
            preview = await self.preview_start(*job_ids)
        digest = "" if preview is None else preview.shown
        request = ReleaseJobs(**self.request_fields(), job_ids=list(job_ids), shown=digest)
        await self.request_service("release", request, Reply)

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

    async def go_job(self, job_id: str, at_fleet_ns: int | None = None) -> int:
        """Start the step of a job that waits armed (`do: wait_armed`); return the instant at which all axes start,
        fleet time in ns, once it is agreed. Raises `Refusal`: codes `not-running`, `not-armed`, `begun`, `too-near`,
        `too-late`, and what has ended the wait.

        at_fleet_ns: an instant to start at instead, which is agreed shortly before it, and returned at once; without
        it, as soon as all controllers can."""
        request = GoJob(**self.request_fields(), job_id=job_id, at_fleet_ns=at_fleet_ns)
        reply = await self.request_service("go", request, JobGone, GO_S)
        assert reply.t0_fleet_ns is not None
        return reply.t0_fleet_ns
