"""Verbs of a script: each runs a job that belongs to the program, and returns when its axes are there.

await tutti.home()
await tutti.move({"gantry.x": 120, "stage.u": "6 mm"})

What a program has begun ends with it: a cancelled task, Ctrl-C, or the end of the process stops the axes, and the
interruption says so on standard error.
"""

import asyncio
import sys
from collections.abc import Mapping, Sequence
from contextlib import suppress
from functools import partial
from typing import Literal

from orchestrator.client.jobs import JobRequests
from orchestrator.client.progress import show_bar
from orchestrator.client.ready import ReadyCallback, ReadyToBegin, ask_callback
from orchestrator.client.results import JobResult
from orchestrator.model.errors import Refusal, TuttiError
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.service import FleetNames
from orchestrator.model.messages import Request
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import QueueEntry
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.set_position import SetPosition

STOP_S = 5.0  # for an interrupted job to come to rest


class JobFailed(TuttiError):
    """A job, or a verb, that was not done. report: the record of what happened."""

    def __init__(self, report: JobResult) -> None:
        reason = f": {report.reason}" if report.reason else ""
        super().__init__(f"{report.name} is {report.state}{reason}")
        self.report = report


class StepRequests(JobRequests):
    """Run jobs and single steps that end with this program."""

    async def run(
        self,
        job: Job | Step | Sequence[Step],
        *,
        wait: bool = False,
        on_ready: ReadyCallback | None = None,
        progress: bool = False,
    ) -> JobResult:
        """Run a job, or steps, and return its report when it is done; it ends with this program.

        wait: let it wait for axes that are in use, for a permit, an e-stop; otherwise that is refused. on_ready: called
        with what would move first once a cause is gone that it had to wait for; it begins if that returns true.
        progress: show a bar, on a terminal or in a notebook. Raises `Refusal` if it does not begin (`ReadyToBegin`
        after a cause, without `on_ready`), and `JobFailed` if it is not done. Unlike a job that is submitted, it begins
        also while the queue is stopped, and does not survive an interruption.
        """

        async with self.attend() as attendance:
            terms = QueueTerms(session=attendance.session, now=not wait)
            submitting = asyncio.ensure_future(self.enqueue_job(_make_job(job), None, terms))
            try:
                # Not cancelled: a job whose id is unknown cannot be stopped.
                entry = await asyncio.shield(submitting)
                with show_bar(wanted=progress) as on_progress:
                    job_report = await self.wait_for_job(
                        entry.id, on_progress, on_ready=partial(ask_callback, on_ready)
                    )
                report = await self.load_result(job_report)
            except ReadyToBegin:
                await self.cancel_job((await submitting).id)
                raise
            except asyncio.CancelledError:
                await self._stop_interrupted(submitting)
                raise
        if report.state != "done":
            raise JobFailed(report)
        return report

    async def move(
        self,
        to: Mapping[str, int | float | str] | str | None = None,
        by: Mapping[str, int | float | str] | None = None,
        *,
        speed: float | str | Mapping[str, float | str] = "manual",
        sync: Literal["time", "phase", "none"] = "time",
        wait: bool = False,
    ) -> JobResult:
        """Move axes together: to positions, or by distances, in their units or with one (`"6 mm"`).

        to: by axis, a quantity or the name of a position; or one name, for all its axes.
        speed: as in a job: a fraction of the limits, `"5 mm/s"`, or one by axis; without it `manual_speed` of each
        axis, 20 % unless the fleet file says otherwise. sync, wait: as in a job, and in `run`. Raises `Refusal`,
        `JobFailed`.
        """
        return await self.run(make_move(to, by, speed, sync), wait=wait)

    async def home(self, *axes: str, wait: bool = False) -> JobResult:
        """Find the reference of axes (groups, controllers); without any, of the whole fleet in its home_order.

        Raises `Refusal`, `JobFailed`."""
        return await self.run(Home(axes=list(axes) or None), wait=wait)

    async def enable(self, *axes: str, wait: bool = False) -> JobResult:
        """Switch the motors of axes (groups, controllers) on; without any, of the whole fleet. Raises `Refusal`,
        `JobFailed`."""
        if not axes:
            names = await self.request_service("names", Request(**self.request_fields()), FleetNames)
            axes = tuple(names.controllers)
        return await self.run(Enable(axes=list(axes)), wait=wait)

    async def disable(self, *axes: str, wait: bool = False) -> JobResult:
        """Switch the motors of axes (groups, controllers) off. Raises `Refusal`, `JobFailed`."""
        return await self.run(Disable(axes=list(axes)), wait=wait)

    async def set_position(self, axes: Mapping[str, int | float | str | None], *, wait: bool = False) -> JobResult:
        """Set the present positions of axes; None removes an axis's offset. Nothing moves. Raises `Refusal`,
        `JobFailed`."""
        return await self.run(SetPosition(axes=dict(axes)), wait=wait)

    async def set_output(self, output: str, *, on: bool = True, wait: bool = False) -> JobResult:
        """Switch the output `controller.output`. Raises `Refusal`, `JobFailed`."""
        return await self.run(SetOutput(output=output, value=on), wait=wait)

    async def wait_input(self, name: str, *, on: bool = True, timeout_s: float = 10.0) -> JobResult:
        """Wait until the input `controller.input` is active (`on=False`: passive). Raises `Refusal`, and `JobFailed`
        after `timeout_s`."""
        return await self.run(WaitInput(input=name, value=on, timeout=f"{timeout_s:.9f} s"))

    async def dwell(self, seconds: float) -> JobResult:
        """Wait, as a step of the fleet's own. Raises `Refusal`, `JobFailed`."""
        return await self.run(Dwell(duration=f"{seconds:.9f} s"))

    async def _stop_interrupted(self, submitting: "asyncio.Future[QueueEntry]") -> None:
        """Stop the job of an interrupted call, and say so. Its session ends anyhow, which stops it within a second."""
        try:
            async with asyncio.timeout(STOP_S):
                entry = await submitting
                with suppress(Refusal):
                    await self.cancel_job(entry.id)
                report = await self.wait_for_job(entry.id)
            text = f"{report.name} is {report.state}"
        except Refusal as error:
            text = f"nothing has begun ({error.text})"
        except TimeoutError:
            text = "the end of the job is not confirmed; if axes still move: `tutti stop`"
        sys.stderr.write(f"tutti: interrupted: {text}\n")


def make_move(
    to: Mapping[str, int | float | str] | str | None,
    by: Mapping[str, int | float | str] | None,
    speed: float | str | Mapping[str, float | str],
    sync: Literal["time", "phase", "none"],
) -> Move:
    """A move of what a program writes for it. Raises `WrongValue`."""
    return Move(to=to if isinstance(to, str) else dict(to or {}), by=dict(by or {}), speed=speed, sync=sync)


def _make_job(job: Job | Step | Sequence[Step]) -> Job:
    if isinstance(job, Job):
        return job
    steps = list(job) if isinstance(job, Sequence) else [job]
    return Job("+".join(dict.fromkeys(step.kind for step in steps))[:120] or "nothing", steps)
