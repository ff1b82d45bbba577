"""Requests about the move that a job executes now."""

from collections.abc import Mapping

from orchestrator.client.queue import QueueRequests
from orchestrator.model.jobs.service import JobRetargeted, RetargetJob


class RetargetRequests(QueueRequests):
    """Send moving axes to other targets."""

    async def retarget_job(
        self, job_id: str, to: Mapping[str, float | str] | None = None, *, by: Mapping[str, float | str] | None = None
    ) -> JobRetargeted:
        """Send the axes of the move that a job executes now to other targets: all of its axes, each by `to` (user
        position) or by `by` (distance from the target that it has). Returns as soon as the new targets count. Raises
        `Refusal`: codes `not-running`, `not-moving`, `not-a-move`, `other-axes`, `soft-limit`, `paused`, `permit`."""
        fields = {"job_id": job_id, "to": dict(to or {}), "by": dict(by or {})}
        request = RetargetJob.model_validate({**self.request_fields(), **fields})
        return await self.request_service("retarget", request, JobRetargeted)
