"""Changes of running jobs that users request: pauses, overrides, resumption."""

from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import (
    GoJob,
    JobGone,
    JobRetargeted,
    OverrideJob,
    PointsRead,
    ReadPoints,
    RetargetJob,
)
from orchestrator.model.messages import Reply
from orchestrator.model.report import JobProgress, StepReport
from orchestrator.plan.path_clock import MOST_RATE

OVERRIDE_PERCENT = 10, round(100 * MOST_RATE)


class RunRequests:
    """Changes running jobs, and reports how far they are. The changes raise `Refusal` and `JournalError`."""

    def __init__(self, services: JobServices, register: JobRegister) -> None:
        self._services = services
        self._register = register

    async def pause_job(self, job_id: str, actor: str, *, now: bool = False) -> None:
        """Pause a running job after its current step; with `now`, inside a motion step."""
        run = self._register.running.get(job_id)
        if run is None:
            raise await self._register.make_refusal(job_id, "not-running", "to hold a queued job: `tutti job hold`")
        if now and run.control.is_on_path:
            raise Refusal(
                "on-path",
                f"job {job_id} is on a path, and a member that has all of it loaded would leave it",
                "pause it at the end of the path (without --now), or stop it: `tutti stop`",
            )
        if run.control.paused_by is None:
            self._services.log.info(f"to be paused by {actor}", job=job_id)
            run.control.pause(actor)
        if now:
            await run.control.feed_hold(actor)

    async def override_job(self, request: OverrideJob) -> Reply:
        """Play the path of a running job at another speed, or plan its next moves for it. Raises `Refusal`."""
        job_id, percent = request.job_id, request.percent
        run = self._register.running.get(job_id)
        if run is None:
            raise await self._register.make_refusal(request.job_id, "not-running", "an override is for a job that runs")
        low, high = OVERRIDE_PERCENT
        if not low <= percent <= high:
            text = f"{percent:g} % is not between {low} and {high} %"
            raise Refusal("override", text, "to stop on the path: `tutti job pause --now`")
        await run.control.override(percent / 100)
        return Reply()

    async def retarget_job(self, request: RetargetJob) -> JobRetargeted:
        """Send the axes of the present move of a running job to other targets."""
        run = self._register.running.get(request.job_id)
        if run is None:
            raise await self._register.make_refusal(request.job_id, "not-running", "a retarget is for a job that runs")
        return await run.control.retarget(request)

    async def go_job(self, request: GoJob) -> JobGone:
        """Start the step of a running job that waits armed."""
        run = self._register.running.get(request.job_id)
        if run is None:
            raise await self._register.make_refusal(request.job_id, "not-running", "`go` is for a job that is armed")
        return JobGone(t0_fleet_ns=await run.control.go(request.at_fleet_ns))

    async def resume_job(self, job_id: str, actor: str) -> None:
        """Resume a job that is paused, or about to be."""
        run = self._register.running.get(job_id)
        if run is None:
            remedy = "for a held job: `tutti job release`; for a finished one: `tutti job retry --step`"
            raise await self._register.make_refusal(job_id, "not-running", remedy)
        if run.control.paused_by is None:
            raise Refusal("not-paused", f"job {job_id} is not paused; it is {run.state}")
        run.control.resume(actor)

    def find_progress(self, job_id: str) -> JobProgress | None:
        """The progress of a job while it runs."""
        run = self._register.running.get(job_id)
        return None if run is None else run.make_progress()

    async def read_points(self, request: ReadPoints) -> PointsRead:
        """What was recorded at points of a job, of one that runs also what is not in the journal yet. Raises
        `JournalError`."""
        journal, cursor = self._services.journal, (request.after_step, request.after_point)
        # Taken before: a row that is written meanwhile is found in one of the two.
        run = self._register.running.get(request.job_id)
        unwritten_points = [] if run is None else run.unwritten_points
        load = journal.point_rows.load_points
        points = await self._services.execute(load, request.job_id, cursor, request.limit)
        last = (points[-1].step, points[-1].point) if points else cursor
        points += [point for point in unwritten_points if (point.step, point.point) > last]
        return PointsRead(points=points[: request.limit])

    def find_last_motion(self, job_id: str) -> StepReport | None:
        """The last motion step of a running job that has ended."""
        run = self._register.running.get(job_id)
        return None if run is None else run.last_motion
