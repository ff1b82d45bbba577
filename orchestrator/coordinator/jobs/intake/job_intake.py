"""Job intake: submission of new jobs, re-runs of finished ones, and deletion of old ones."""

from collections.abc import Callable
from datetime import timedelta

from orchestrator.coordinator.jobs.check import check_job
from orchestrator.coordinator.jobs.intake.client_keys import ClientKeys, digest_request, find_owner
from orchestrator.coordinator.jobs.intake.live_intake import LiveIntake
from orchestrator.coordinator.jobs.intake.path_intake import split_paths
from orchestrator.coordinator.jobs.intake.point_intake import PointIntake
from orchestrator.coordinator.jobs.needs import find_axes, find_needed_controllers
from orchestrator.coordinator.jobs.queue.scheduler import Scheduler
from orchestrator.coordinator.jobs.queue.times import MISSED_AFTER
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.jobs.start_places import StartPlaces
from orchestrator.coordinator.journal.facts import QueueEntryOptions, RetryOrigin
from orchestrator.coordinator.journal.records import DamagedRecord, JobRecord, UnknownResult
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.service import AxisPosition, JobRetried, JobSubmitted, PruneJobs, RetryJob, SubmitJob
from orchestrator.model.queue import MAX_FLAT_STEPS, MAX_STEPS, QueueTerms, format_utc, parse_utc
from orchestrator.model.report import FINISHED_STATES, QueueEntry
from orchestrator.model.steps.numbers import name_step, number_step
from orchestrator.model.steps.order import RemainingStep, StepOrder, count_reports
from orchestrator.model.steps.tree import iterate_steps

MAX_DESCRIBED_STEPS = 20  # remaining steps that are described in words


class JobIntake:
    """Accepts jobs for the scheduler."""

    def __init__(self, services: JobServices, scheduler: Scheduler, new_id: Callable[[], str]) -> None:
        self._services = services
        self._scheduler = scheduler
        self._new_id = new_id
        self.points = PointIntake(services)
        self.live = LiveIntake(services, scheduler.register)
        self._keys = ClientKeys(services)
        self._outside: set[str] = set()
        """Jobs that may be in the journal, and are not in the queue: the journal did not answer after that."""

    async def submit_job(self, request: SubmitJob) -> JobSubmitted:
        """Accept a job: it is in the journal when this returns. Raises `Refusal`."""
        first_job = await self._keys.find_job(request)
        if first_job is not None:
            return await self._describe_job(first_job.job_id)
        _require_program(request.job, request.terms)
        job = await split_paths(self._services, await self.points.resolve_points(request.job))
        _order_steps(job, request.terms)
        order = self._services.positions.make_resolver().resolve_remaining(job.steps, request.terms.repeat)
        await self._check_steps(order.list_remaining(), request.terms)
        await self._check_terms(request.terms)
        if request.terms.now:
            self._require_free_way(request)
        return await self._accept_job(request, job, QueueEntryOptions(request.terms))

    async def retry_job(self, request: RetryJob) -> JobRetried:
        """Re-run a finished job from a step on; or report what that would do. Raises `Refusal`, `UnknownName`."""
        services = self._services
        record = await services.execute(services.journal.load_record, request.job_id)
        job = await services.load_job(request.job_id)
        if record is None or job is None:
            raise Refusal("unknown-job", f"no job {request.job_id}", "see `tutti job ls`")
        if record.state not in FINISHED_STATES:
            text = f"job {record.id} is {record.state}; only a finished job can be re-run"
            raise Refusal("not-ended", text, "wait for its end, or cancel it")
        if job.is_open:
            text = f"job {record.id} was a live job: its moves came from a program, and are not kept"
            raise Refusal("live", text, "run that program again")
        terms = await self._keep_proposal(record, request.terms or QueueTerms(repeat=record.repeat))
        order = _order_steps(job, terms)
        from_step = _find_first_step(record.id, order, request)
        resolver = services.positions.make_resolver()
        remaining = resolver.resolve_remaining(job.steps, terms.repeat, from_step).list_remaining(from_step)
        first_job = None if request.dry_run else await self._keys.find_job(request)
        if first_job is None:
            await self._check_steps(remaining, terms)
            await self._check_terms(terms)
        axes = find_axes(services.view.fleet, [step.step for step in remaining])
        described_steps = order.list_remaining(from_step)[:MAX_DESCRIBED_STEPS]
        reply = JobRetried(
            steps=[f"{number_step(step.first)} {step.step.describe()}" for step in described_steps],
            axes=[self._axis_position(axis) for axis in axes],
            warnings=_find_warnings(services.view.fleet, remaining),
        )
        if request.dry_run:
            return reply
        fresh = job.model_copy(update={"actor": request.actor})
        if first_job is not None:
            taken_job = await self._describe_job(first_job.job_id)
        else:
            options = QueueEntryOptions(terms, RetryOrigin(record.id, from_step))
            taken_job = await self._accept_job(request, fresh, options)
        return reply.model_copy(update={"job_id": taken_job.job_id, "entry": taken_job.entry})

    async def prune_jobs(self, request: PruneJobs) -> int:
        """Delete old jobs; return how many."""
        services = self._services
        utc_before = parse_utc(services.clock.utc()) - timedelta(seconds=request.older_s)
        count = await services.execute(services.journal.prune_jobs, format_utc(utc_before), request.keep)
        named_points = await services.execute(services.journal.list_named_points)
        await services.execute(services.journal.points.delete_unused, named_points, services.clock.utc())
        services.log.info(f"{count} jobs submitted before {format_utc(utc_before)} deleted by {request.actor}")
        return count

    # Inside

    async def _check_steps(self, steps: list[RemainingStep], terms: QueueTerms) -> None:
        """Raises `Refusal` for steps that cannot work, and for those that would outlive a certificate."""
        services, fleet = self._services, self._services.view.fleet
        least_s = await check_job(fleet, steps, services.motion.plan, services.check)
        members = find_needed_controllers(fleet, [step.step for step in steps])
        services.fleet.certificates.require_until(members, least_s, terms.at)

    async def _accept_job(self, request: SubmitJob | RetryJob, job: Job, options: QueueEntryOptions) -> JobSubmitted:
        services = self._services
        digest = await services.execute(digest_request, request)
        new_id = self._new_id()[:8]
        try:
            job_id, fresh = await services.execute(
                services.journal.accept_job,
                new_id,
                request.client_key,
                job,
                services.clock.utc(),
                options._replace(key_owner=find_owner(request.actor), digest=digest),
            )
        except UnknownResult:
            self._outside.add(new_id)
            raise
        if fresh:
            self._outside.add(job_id)
        else:  # another request came with the key at the same time
            await self._keys.find_job(request)
        return await self._describe_job(job_id, job)

    async def _enter_job(self, row: JobRecord, job: Job) -> JobSubmitted:
        """Put a job that is in the journal into the queue."""
        self._outside.remove(row.id)
        self._services.log.info(f"accepted {job.name!r} from {job.actor}", job=row.id)
        await self._scheduler.enter_job(row, job)
        entry = self._scheduler.publisher.make_entry(row)
        cause = self._scheduler.starts.describe_cause(row.id)
        return self._make_reply(entry.model_copy(update={"reason": cause or entry.reason}))

    async def _keep_proposal(self, record: JobRecord, terms: QueueTerms) -> QueueTerms:
        """The terms of a re-run: of a job that was proposed and whose plan was never approved it is one again."""
        if not record.proposed or terms.proposed:
            return terms
        services = self._services
        try:
            approval = await services.execute(services.journal.approvals.load_approval, record.id)
        except DamagedRecord:  # which counts as none
            approval = None
        is_approved = approval is not None and not approval.void
        return terms if is_approved else terms.model_copy(update={"proposed": True})

    async def _describe_job(self, job_id: str, job: Job | None = None) -> JobSubmitted:
        """The answer to a request, also to one that is repeated: the job of the first one, as it is now. One that is in
        the journal and not in the queue comes into it. job: if it is known."""
        services = self._services
        row = await services.execute(services.journal.load_record, job_id)
        if row is not None and job_id in self._outside:
            job = await services.load_job(job_id) if job is None else job
            if job is not None and job_id in self._outside:
                return await self._enter_job(row, job)
        if row is None:
            return JobSubmitted(job_id=job_id)
        return self._make_reply(self._scheduler.publisher.make_entry(row))

    def _make_reply(self, entry: QueueEntry) -> JobSubmitted:
        return JobSubmitted(job_id=entry.id, entry=entry.model_copy(update={"note": self._services.copies.note}))

    def _require_free_way(self, request: SubmitJob) -> None:
        """Raise `Refusal` for a job that must begin at once, and would have to wait."""
        obstacle = self._scheduler.find_obstacle(request.job, request.terms)
        if obstacle is not None:
            raise Refusal(obstacle.code, obstacle.text, obstacle.remedy)

    async def _check_terms(self, terms: QueueTerms) -> None:
        """Raises `Refusal` for a proposed job that must not wait, for a start time in the past, and for a predecessor
        that cannot become done any more."""
        services = self._services
        if terms.proposed and (terms.now or terms.session is not None):
            text = "a proposed job waits for its approval: it cannot begin at once, or belong to a waiting command"
            raise Refusal("bad-terms", text, "propose it without `now` and `session`")
        utc_now = parse_utc(services.clock.utc())
        if terms.at is not None and terms.missed == "skip" and parse_utc(terms.at) < utc_now - MISSED_AFTER:
            raise Refusal(
                "past",
                f"start time {terms.at} is in the past; it is now {format_utc(utc_now)}",
                "give a later time, or set `missed: run`",
            )
        if terms.expires is not None and parse_utc(terms.expires) <= utc_now:
            text = f"it expires at {terms.expires}, which is in the past; it is now {format_utc(utc_now)}"
            raise Refusal("past", text, "give a later time")
        await self._check_predecessors(terms)

    async def _check_predecessors(self, terms: QueueTerms) -> None:
        """Raises `Refusal` for a job to go on with that has not ended, and one to wait for that will not be done."""
        services = self._services
        if terms.continues is not None:
            row = await services.execute(services.journal.load_record, terms.continues)
            if row is None or row.state not in FINISHED_STATES:
                text = f"job {terms.continues} has not ended, or does not exist: it cannot be continued"
                raise Refusal("not-ended", text, "see `tutti job ls`")
        if terms.after is not None:
            row = await services.execute(services.journal.load_record, terms.after)
            if row is None:
                raise Refusal("unknown-job", f"there is no job {terms.after} to wait for", "see `tutti job ls`")
            if row.state in FINISHED_STATES and row.state != "done":
                raise Refusal(
                    "not-done",
                    f"job {row.id} is {row.state} and will not become done",
                    "choose another job for `after`",
                )

    def _axis_position(self, axis: str) -> AxisPosition:
        axis_now = self._services.view.axis_now(axis)
        if axis_now is None:
            return AxisPosition(axis=axis, unit=self._services.view.fleet.axis(axis).unit, position=None)
        return AxisPosition(
            axis=axis,
            unit=axis_now.unit,
            position=axis_now.position,
            enabled=axis_now.enabled,
            referenced=axis_now.referenced,
        )


def _require_program(job: Job, terms: QueueTerms) -> None:
    """Raise `Refusal` for a live job without a program that it ends with."""
    if not job.is_open:
        return
    if terms.session is None:
        text = "a live job runs what a program asks for, and ends with that program: it cannot be submitted as a file"
        raise Refusal("live", text, "begin it from a program, as with `tutti.live(...)`")
    if terms.repeat > 1:
        raise Refusal("live", "a live job cannot be repeated", "ask for its moves again")


def _order_steps(job: Job, terms: QueueTerms) -> StepOrder:
    """The steps of a job in their order, as they are written. Raises `Refusal` for a job that is too long."""
    steps, order = count_reports(job.steps), StepOrder(job.steps, terms.repeat)
    if steps * terms.repeat > MAX_STEPS:
        raise Refusal(
            "too-long",
            f"{steps} steps, {terms.repeat} times, are {steps * terms.repeat}; the maximum is {MAX_STEPS}",
            "repeat it less often, or submit several jobs",
        )
    if len(order) > MAX_FLAT_STEPS:
        text = f"all points, with the steps at them, are {len(order)} steps; the maximum is {MAX_FLAT_STEPS}"
        raise Refusal("too-long", text, "submit several jobs")
    return order


def _find_first_step(job_id: str, order: StepOrder, request: RetryJob) -> int:
    """The number of the step that a re-run begins with. Raises `Refusal`, code `no-step`."""
    first = request.from_step
    if first >= len(order):
        text = f"job {job_id} has the steps 1 to {len(order)}"
        raise Refusal("no-step", text, "choose one of them with --step; `from_step` counts them from 0")
    if request.from_point is None:
        return first
    location = order.locate(first)
    scan = location.scan
    if scan is None:
        text = (
            f"{name_step(first)} of job {job_id} is no scan ({location.kind}), so it has no point {request.from_point}"
        )
        raise Refusal("no-step", text, "choose the step of a scan with --step; `tutti job show` numbers them")
    if request.from_point > scan.point_count:
        text = f"the scan of {name_step(location.first)} of job {job_id} has the points 1 to {scan.point_count}"
        raise Refusal("no-step", text, "choose one of them with --from-point")
    return location.first + (request.from_point - 1) // scan.points_together * scan.points_steps


def _find_warnings(fleet: Fleet, remaining: list[RemainingStep]) -> list[str]:
    """Warnings for steps whose result depends on where the axes are now."""
    places = StartPlaces(fleet)
    for index, _, written_step in remaining:
        for step in iterate_steps([written_step]):
            axes = ", ".join(places.take_step(step))
            if axes:
                return [step.describe_relative(number_step(index), axes)]
    return []
