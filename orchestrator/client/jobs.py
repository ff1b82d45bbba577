"""Requests about jobs, and a submitted job that can be followed."""

import asyncio
from collections.abc import AsyncGenerator, Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Self

from orchestrator.bus.base import BusSample
from orchestrator.client.attendance import Attendance
from orchestrator.client.connection import ANSWER_S
from orchestrator.client.progress import show_bar
from orchestrator.client.ready import ReadyCallback, ReadyToBegin, ask_callback
from orchestrator.client.results import JobQueue, JobResult, shorten_repr
from orchestrator.client.retargets import RetargetRequests
from orchestrator.client.tracebacks import end_tracebacks
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.forecast import AxisForecast, JobForecast, StepForecast, StepProblem
from orchestrator.model.jobs.job import UNKNOWN_ACTOR, Job
from orchestrator.model.jobs.parts import dump_long
from orchestrator.model.jobs.restart import StartPreview
from orchestrator.model.jobs.service import (
    DryRun,
    DryRunDone,
    FindJob,
    JobReference,
    JobRetargeted,
    JobRetried,
    JobsFound,
    JobShown,
    JobSubmitted,
    ListJobs,
    OverrideJob,
    PauseJob,
    RecordingReference,
    RecordingReply,
    RetryJob,
    SubmitJob,
)
from orchestrator.model.messages import Reply
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import (
    FINISHED_STATES,
    JobProgress,
    JobReport,
    JobState,
    JobTransition,
    PointRecord,
    QueueEntry,
    StepRecording,
    make_queued_progress,
)
from orchestrator.model.steps.kinds import MOTION_STEPS
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.tree import iterate_steps
from orchestrator.model.templates.template import Template, load_job

POLL_S = 1.0  # period of reading the journal while the bus is silent
DRY_RUN_STEPS = 50  # in one request, so that other requests get their turn
DRY_RUN_S = 30.0  # for such a part
SUBMIT_STEP_S = 0.01
MAX_RECORDINGS = 100
MAX_RESULT_POINTS = 10_000


class JobRequests(RetargetRequests):
    """Submit jobs, follow them, and end them."""

    async def submit(
        self,
        job: Job | Template | Path | str,
        client_key: str | None = None,
        terms: QueueTerms | None = None,
        *,
        parameters: Mapping[str, object] | None = None,
    ) -> "SubmittedJob":
        """Submit a job; it is in the journal when this returns. Raises `Refusal`, and `FileError` for a file or a
        template. What it returns prints with what the job waits for, such as a stopped queue.

        job: a job, a template, or the path of a job file; without an actor it gets the actor of this connection.
        client_key: the same key is the same job, however often it is submitted. terms: priority, repeats, predecessor
        and start time. parameters: values for those of the template or file, `{"width": "20 mm"}`.
        """
        entry = await self.enqueue_job(_fill_job(job, parameters), client_key, terms)
        return SubmittedJob(entry.id, self, entry)

    def attend(self) -> Attendance:
        """A session for jobs that a person waits for: they end when its context does, or its process."""
        return Attendance(self)

    async def find_job(self, reference: str, *, newest: bool = False) -> QueueEntry:
        """The job that a user means: by the beginning of its id, its name, or `last`, the newest.

        newest: take the newest of that name. Raises `Refusal`: codes `unknown-job`, and `ambiguous`, with what fits.
        """
        request = FindJob(**self.request_fields(), reference=reference)
        jobs = (await self.request_service("find", request, JobsFound)).jobs
        if len(jobs) == 1 or (newest and jobs and all(entry.name == reference for entry in jobs)):
            return jobs[0]
        if jobs:
            fitting = ", ".join(f"{entry.id} {entry.name!r}" for entry in jobs)
            raise Refusal("ambiguous", f"several jobs fit {reference!r}: {fitting}", "write more of the id")
        text = "there is no job" if reference == "last" else f"no job {reference}"
        raise Refusal("unknown-job", text, "see `tutti job ls`")

    def job(self, job_id: str) -> "SubmittedJob":
        """A job by its id, to follow it."""
        return SubmittedJob(job_id, self)

    async def enqueue_job(
        self,
        job: Job,
        client_key: str | None = None,
        terms: QueueTerms | None = None,
    ) -> QueueEntry:
        """Submit a job and return its place in the queue. Raises `Refusal`, and `FileError` for a file of points."""
        job = await self.send_points(job)
        if job.actor == UNKNOWN_ACTOR:
            job = job.model_copy(update={"actor": self.actor})
        request = SubmitJob(
            **self.request_fields(), job=job, client_key=client_key or self.new_id(), terms=terms or QueueTerms()
        )
        # Every step is planned before the job is accepted.
        step_count = sum(1 for _ in iterate_steps(job.steps))
        timeout_s = ANSWER_S + SUBMIT_STEP_S * step_count * request.terms.repeat
        entry = (await self.request_service("submit", request, JobSubmitted, timeout_s)).entry
        assert entry is not None
        return entry

    async def dry_run(self, job: Job, on_steps: Callable[[int], None] | None = None) -> JobForecast:
        """Run a job forward from the present positions, each step from where the one before it leaves its axes, and
        ask every controller what it would be sent. Nothing moves. Raises `Refusal`.

        on_steps: called with the number of steps that are done. The work ends with this call: the job is sent in parts.
        """
        job = await self.send_points(job)
        steps: list[StepForecast] = []
        problems: list[StepProblem] = []
        conditions: dict[str, None] = {}
        axes: dict[str, AxisForecast] | None = None
        for first in range(0, len(job.steps), DRY_RUN_STEPS):
            part = job.model_copy(update={"steps": job.steps[first : first + DRY_RUN_STEPS]})
            request = DryRun(**self.request_fields(), job=part, first=first, begin=axes)
            reply = await self.request_service("dry-run", dump_long(request), DryRunDone, DRY_RUN_S)
            axes = reply.end
            steps += reply.forecast.steps
            problems += reply.forecast.problems
            conditions |= dict.fromkeys(reply.forecast.conditions)
            if on_steps is not None:
                on_steps(len(steps))
        return JobForecast(steps=steps, problems=problems, conditions=list(conditions))

    async def list_jobs(
        self, limit: int = 50, state: JobState | None = None, name: str = "", since: str | None = None
    ) -> JobQueue:
        """The newest jobs, newest first; `total` is the number of all that match. Raises `Refusal`.

        state: only jobs in it. name: only jobs with this text in their name. since: only jobs submitted at this RFC
        3339 time or later.
        """
        request = ListJobs(**self.request_fields(), limit=limit, state=state, name=name, since=since)
        return await self.request_service("list", request, JobQueue)

    async def load_recording(self, job_id: str, step: int) -> StepRecording | None:
        """The plan and the polled samples of a motion step; None if there is no recording."""
        request = RecordingReference(**self.request_fields(), job_id=job_id, step=step)
        return (await self.request_service("recording", request, RecordingReply)).recording

    async def load_result(self, report: JobReport) -> JobResult:
        """A report with the recordings of its first `MAX_RECORDINGS` motion steps, and the first `MAX_RESULT_POINTS`
        points of its scans."""
        moves = [step.index for step in report.steps if step.do in MOTION_STEPS][:MAX_RECORDINGS]
        recordings = [await self.load_recording(report.job_id, index) for index in moves]
        points: list[PointRecord] = []
        if any(step.scan is not None for step in report.steps):
            async for point in self.iterate_points(report.job_id):
                points.append(point)
                if len(points) == MAX_RESULT_POINTS:
                    break
        return JobResult.of(report, [recording for recording in recordings if recording is not None], points)

    async def cancel_job(self, job_id: str) -> None:
        """Cancel a queued or running job. Raises `Refusal`."""
        await self.request_service("cancel", JobReference(**self.request_fields(), job_id=job_id), Reply)

    async def pause_job(self, job_id: str, *, now: bool = False) -> None:
        """Pause a running job after its current step; it keeps its axes. Raises `Refusal`: code `not-running`.

        now: pause inside a motion step by a feed hold; the axes brake together, and `resume_job` continues from there.
        """
        await self.request_service("pause", PauseJob(**self.request_fields(), job_id=job_id, now=now), Reply)

    async def override_job(self, job_id: str, percent: float) -> None:
        """Play the path that a job moves on at `percent` (10 to 120) of its planned speed, from as soon as all members
        can; where it is on none, plan its next moves for `percent` (10 to 100) of theirs. Raises `Refusal`: codes
        `not-running`, `not-on-path`, `override`, `path-ramp`, `late`."""
        await self.request_service(
            "override", OverrideJob(**self.request_fields(), job_id=job_id, percent=percent), Reply
        )

    async def resume_job(self, job_id: str) -> None:
        """Resume a paused job. Raises `Refusal`: codes `not-running`, `not-paused`."""
        await self.request_service("resume", JobReference(**self.request_fields(), job_id=job_id), Reply)

    async def retry_job(
        self,
        job_id: str,
        from_step: int | tuple[int, int] = 0,
        *,
        dry_run: bool = False,
        terms: QueueTerms | None = None,
        client_key: str | None = None,
    ) -> JobRetried:
        """Re-run a finished job from a step on, as a new job. Raises `Refusal`: codes `not-ended`, `no-step`.

        from_step: its index, counted from 0, or that of a scan and the number of a point of it, from 1: `(2, 17)`.
        dry_run: only report the remaining steps and the present positions of their axes.
        """
        step, point = from_step if isinstance(from_step, tuple) else (from_step, None)
        request = RetryJob(
            **self.request_fields(),
            job_id=job_id,
            from_step=step,
            from_point=point,
            dry_run=dry_run,
            terms=terms,
            client_key=client_key or self.new_id(),
        )
        return await self.request_service("retry", request, JobRetried)

    async def wait_for_job(
        self,
        job_id: str,
        on_progress: Callable[[JobProgress], None] | None = None,
        poll_s: float = 1.0,
        on_ready: ReadyCallback | None = None,
    ) -> JobReport:
        """Wait for a job's end and return its report, as the journal has it. on_progress: called with progress from
        the bus, and at once with what a queued job waits for; what it raises is raised here. on_ready: called with what
        would move first when the job is ready to begin after a cause; if it returns true the job begins. Without it,
        the word is given elsewhere.

        Raises `Refusal` for a job that does not exist, and `ReadyToBegin` if `on_ready` does not return true. Waits on
        while the coordinator is away.
        """
        changed_event = asyncio.Event()
        failures: list[Exception] = []

        def receive_progress(sample: BusSample) -> None:
            try:
                progress = JobProgress.read_message(sample.payload)
            except ValueError:
                return  # not of the coordinator
            if on_progress is not None:
                try:
                    on_progress(progress)
                except Exception as error:
                    failures.append(error)  # raised where the caller waits
                    changed_event.set()
            if progress.state in FINISHED_STATES or progress.ready:
                changed_event.set()

        subscription = await self.bus.subscribe(self.keys.job_state(job_id), receive_progress)
        try:
            while True:
                shown_job = await self.show_job_when_available(job_id, poll_s)
                if shown_job.report is not None:
                    return shown_job.report
                entry, job = shown_job.entry, shown_job.job
                if on_progress is not None and entry is not None and job is not None and entry.state == "queued":
                    steps = len(StepOrder(job.steps, entry.terms.repeat))
                    on_progress(make_queued_progress(entry, "queued", entry.reason, entry.submitted_utc, steps))
                if on_ready is not None and entry is not None and entry.ready:
                    await self._begin_ready(job_id, on_ready)
                changed_event.clear()
                try:
                    async with asyncio.timeout(poll_s):
                        await changed_event.wait()
                except TimeoutError:
                    continue
                if failures:
                    raise failures[0]
        finally:
            await subscription.undeclare()

    async def _begin_ready(self, job_id: str, on_ready: ReadyCallback) -> None:
        """Give the word for a job that is ready, if `on_ready` does. Raises `ReadyToBegin`."""
        try:
            preview = await self.preview_start(job_id)
            if not preview.motions:
                return  # a cause is back
            if not await ask_callback(on_ready, preview):
                raise ReadyToBegin(preview)
            await self.release_jobs(job_id, preview=preview)
        except Refusal as error:
            # It has changed meanwhile: what it waits for now is read again.
            if error.code not in ("not-queued", "cause-lasts", "not-shown", "ended"):
                raise


@end_tracebacks
class SubmittedJob(str):
    """The id of a job, with methods to follow it. As text it can be stored and passed to other processes, which get
    the same object from `tutti.job(id)`."""

    _requests: JobRequests
    _entry: QueueEntry | None

    def __new__(cls, job_id: str, requests: JobRequests, entry: QueueEntry | None = None) -> Self:
        """entry: its place in the queue when it was submitted."""
        job = super().__new__(cls, job_id)
        job._requests = requests
        job._entry = entry
        return job

    def __repr__(self) -> str:
        words = self.id if self._entry is None else f"{self._entry.name!r} {self.id} {self._entry.state}"
        return shorten_repr("SubmittedJob", f"{words}: {self.waits_for}" if self.waits_for else words)

    @property
    def waits_for(self) -> str:
        """What the job waited for when it was submitted, such as a stopped queue or a controller; empty: nothing."""
        entry = self._entry
        return "" if entry is None or entry.reason in ("", "submitted") else entry.reason

    @property
    def id(self) -> str:
        """The id as plain text."""
        return str(self)

    async def events(self) -> AsyncGenerator[JobTransition | JobProgress]:
        """All transitions from the beginning on, each once, from the journal, and progress in between from the bus.

        Ends with the job. Raises `Refusal` for a job that does not exist. Waits on while the coordinator is away.
        """
        count = 0
        samples: asyncio.Queue[BusSample] = asyncio.Queue()
        requests = self._requests
        subscription = await requests.bus.subscribe(requests.keys.job_state(self), samples.put_nowait)
        try:
            progress: JobProgress | None = None
            while True:
                transitions = (await requests.show_job_when_available(self)).transitions
                for transition in transitions[count:]:
                    yield transition
                    if transition.state in FINISHED_STATES:
                        return
                count = len(transitions)
                if progress is not None and progress.state not in FINISHED_STATES:
                    yield progress
                progress = await _next_progress(samples)
        finally:
            await subscription.undeclare()

    def follow_points(self, step: int | None = None) -> AsyncGenerator[PointRecord]:
        """What is recorded at the points of its scans, each once and in order, as soon as it is final: first those so
        far. Ends with the job. step: only of the scan that begins with this step; ends with it.

        Raises `Refusal` for a job that does not exist. Waits on while the coordinator is away.
        """
        return self._requests.follow_points(self, step)

    async def result(self, *, progress: bool = False) -> JobResult:
        """Wait for the job's end and return its report. progress: show a bar, on a terminal or in a notebook. Raises
        `Refusal` for a job that does not exist."""
        with show_bar(wanted=progress) as on_progress:
            report = await self._requests.wait_for_job(self, on_progress)
        return await self._requests.load_result(report)

    async def wait(self, on_ready: ReadyCallback | None = None, *, progress: bool = False) -> JobResult | StartPreview:
        """Wait for the job's end and return its report; or, as soon as it is ready to begin after a cause, what would
        move first. on_ready: called with that; if it returns true the job begins, and the wait goes on. progress: show
        a bar, on a terminal or in a notebook. Raises `Refusal` for a job that does not exist."""
        try:
            with show_bar(wanted=progress) as on_progress:
                report = await self._requests.wait_for_job(self, on_progress, on_ready=partial(ask_callback, on_ready))
        except ReadyToBegin as ready:
            return ready.preview
        return await self._requests.load_result(report)

    async def show(self) -> JobShown:
        """All that the journal has of the job. Raises `Refusal`."""
        return await self._requests.show_job(self)

    async def cancel(self) -> None:
        """Cancel the job, queued or running. Raises `Refusal`."""
        await self._requests.cancel_job(self)

    async def hold(self) -> None:
        """Hold the queued job until it is released. Raises `Refusal`: code `not-queued`."""
        await self._requests.hold_jobs(self)

    async def release(self) -> None:
        """Release the held job, or give the word for one that had to wait for a cause. Raises `Refusal`."""
        await self._requests.release_jobs(self)

    async def pause(self, *, now: bool = False) -> None:
        """Pause the job after its current step, or `now` inside a motion step; it keeps its axes. Raises `Refusal`:
        code `not-running`."""
        await self._requests.pause_job(self, now=now)

    async def override(self, percent: float) -> None:
        """Play the path that the job moves on at `percent` (10 to 120) of its planned speed; where it is on none, plan
        its next moves so (10 to 100). Raises `Refusal`: codes `not-running`, `not-on-path`, `override`."""
        await self._requests.override_job(self, percent)

    async def retarget(
        self, to: Mapping[str, float | str] | None = None, *, by: Mapping[str, float | str] | None = None
    ) -> JobRetargeted:
        """Send the axes of the move that the job executes now to other targets, by `to` (user positions) or `by`
        (distances from the targets that they have). Raises `Refusal`: codes `not-running`, `not-moving`, `not-a-move`,
        `other-axes`, `soft-limit`, `paused`, `permit`."""
        return await self._requests.retarget_job(self, to, by=by)

    async def go(self, at_fleet_ns: int | None = None) -> int:
        """Start the step of the job that waits armed, at that instant (fleet time, ns) or as soon as all controllers
        can; return T0. Raises `Refusal`: codes `not-running`, `not-armed`, `begun`, `too-near`, `too-late`."""
        return await self._requests.go_job(self, at_fleet_ns)

    async def resume(self) -> None:
        """Resume the paused job. Raises `Refusal`: codes `not-running`, `not-paused`."""
        await self._requests.resume_job(self)


def _fill_job(job: Job | Template | Path | str, parameters: Mapping[str, object] | None) -> Job:
    """The job to submit. Raises `FileError`, and `Refusal` for parameters that nothing declares."""
    if isinstance(job, Template):
        return job.fill(parameters)
    if not isinstance(job, Job):
        return load_job(job, parameters)
    if parameters:
        text = f"a job has no parameters, but {', '.join(parameters)} is given"
        raise Refusal("no-template", text, "submit the job file or its `Template`, or leave the parameters out")
    return job


async def _next_progress(samples: "asyncio.Queue[BusSample]") -> JobProgress | None:
    """The newest progress on the bus; None after a while without."""
    try:
        async with asyncio.timeout(POLL_S):
            sample = await samples.get()
    except TimeoutError:
        return None
    while not samples.empty():
        sample = samples.get_nowait()
    return JobProgress.read_message(sample.payload)
