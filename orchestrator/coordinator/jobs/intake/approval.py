"""Requests of users about the plans of jobs: to see one, and to approve it."""

from collections import OrderedDict

from orchestrator.coordinator.jobs.job_plan import make_plan, resolve_job
from orchestrator.coordinator.jobs.queue.queue_order import WaitingJob
from orchestrator.coordinator.jobs.queue.queue_requests import QueueRequests
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply
from orchestrator.model.operation.approval import (
    ApproveJob,
    JobApproval,
    JobPlan,
    JobPlanned,
    join_changes,
    list_changes,
)

MAX_SHOWN = 50  # plans that are kept, to say what has changed since a user has seen one


class JobApprovals:
    """Makes plans of waiting jobs, and approves them."""

    def __init__(self, services: JobServices, register: JobRegister, requests: QueueRequests) -> None:
        self._services = services
        self._register = register
        self._requests = requests
        self._shown: OrderedDict[tuple[str, str], JobPlan] = OrderedDict()

    async def plan_job(self, request: JobReference) -> JobPlanned:
        """The plan of a waiting job, and what differs from the one that was approved. Raises `Refusal`,
        `UnknownName`, `JournalError`."""
        waiting_job = await self._register.find_waiting(request.job_id, "only jobs that wait have a plan")
        plan = await self._make_plan(waiting_job)
        self._shown[request.job_id, plan.hash] = plan
        self._shown.move_to_end((request.job_id, plan.hash))
        while len(self._shown) > MAX_SHOWN:
            self._shown.popitem(last=False)
        plan_before = await self._load_approved(request.job_id)
        return JobPlanned(plan=plan, changed=list_changes(plan_before, plan) if plan_before is not None else [])

    async def approve_job(self, request: ApproveJob) -> Reply:
        """Approve the plan that a user has seen, if it is still that, and release the job. Raises `Refusal`: codes
        `plan-changed`, `not-proposed`, `not-queued`; `UnknownName`, `JournalError`."""
        job_id, services = request.job_id, self._services
        waiting_job = await self._register.find_waiting(job_id, "only a job that waits can be approved")
        if not waiting_job.row.proposed:
            remedy = f"a held job is released by `tutti job release {job_id}`"
            raise Refusal("not-proposed", f"job {job_id} needs no approval: it was not proposed", remedy)
        plan = await self._make_plan(waiting_job)
        if plan.hash != request.plan:
            text = f"the plan of job {job_id} has changed: {await self._explain_change(request, plan)}"
            raise Refusal("plan-changed", text, f"look at it again: `tutti job plan {job_id}`")
        approval = JobApproval(job_id=job_id, plan=plan, actor=request.actor, utc=services.clock.utc())
        await self._requests.approve_job(waiting_job, approval)
        services.log.info(f"plan {plan.hash} approved by {request.actor}", job=job_id)
        return Reply()

    async def _make_plan(self, waiting: WaitingJob) -> JobPlan:
        services, row = self._services, waiting.row
        planned_job = await resolve_job(waiting.job, row.repeat, row.from_step, services.positions.make_resolver())
        return await make_plan(services.view, planned_job)

    async def _load_approved(self, job_id: str) -> JobPlan | None:
        """The plan of the job that was approved last, also if the approval is void."""
        approval = await self._services.load_approval(job_id)
        return None if approval is None else approval.plan

    async def _explain_change(self, request: ApproveJob, plan: JobPlan) -> str:
        """What differs from the plan that the user has seen: one that this coordinator has shown, or the one that was
        approved before."""
        shown_plan = self._shown.get((request.job_id, request.plan)) or await self._load_approved(request.job_id)
        if shown_plan is None or shown_plan.hash != request.plan:
            return "this coordinator has not shown the one that was seen"
        return join_changes(list_changes(shown_plan, plan))
