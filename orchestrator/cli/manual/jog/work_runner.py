"""Runs the works of the jog panel as jobs of one step, which end with its session."""

import asyncio
import contextlib
from collections.abc import Callable, Coroutine
from typing import Any

from orchestrator.cli.manual.jog.panel import JogPanel
from orchestrator.cli.manual.jog.work import RunWork
from orchestrator.client import Tutti
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.queue import QueueTerms


class WorkRunner:
    """Runs one work at a time. start_request: starts a task that the panel waits for on exit."""

    def __init__(
        self, tutti: Tutti, panel: JogPanel, start_request: Callable[[Coroutine[Any, Any, None]], None]
    ) -> None:
        self._tutti = tutti
        self._panel = panel
        self._start_request = start_request
        self._running: asyncio.Task[None] | None = None

    def start(self, work: RunWork) -> asyncio.Event:
        """Start a work; it waits for the returned event, which is to be set once its axis is released."""
        released_event = asyncio.Event()
        self._running = asyncio.get_running_loop().create_task(self._run_job(work, released_event))
        self._start_request(self._report_end(work, self._running))
        return released_event

    def cancel(self) -> None:
        """Stop the running work, if there is one."""
        if self._running is not None:
            self._running.cancel()

    async def _run_job(self, work: RunWork, released: asyncio.Event) -> None:
        await released.wait()
        job = Job.model_validate({"schema": "tutti.job/1", "name": f"manual: {work.words}", "steps": [work.step]})
        async with self._tutti.attend() as attendance:
            # Not cancelled while it is submitted: a job whose id is unknown cannot be stopped.
            terms = QueueTerms(session=attendance.session, now=True)
            submit = asyncio.get_running_loop().create_task(self._tutti.enqueue_job(job, None, terms))
            try:
                report = await self._tutti.wait_for_job((await asyncio.shield(submit)).id)
            except asyncio.CancelledError:
                with contextlib.suppress(Refusal):
                    await self._tutti.cancel_job((await submit).id)
                raise
        if report.state != "done":
            step = report.steps[-1] if report.steps else None
            reason = (step.reason if step is not None else "") or report.reason
            remedy = step.refused.remedy if step is not None and step.refused is not None else ""
            raise Refusal(report.state, reason, remedy)

    async def _report_end(self, work: RunWork, running: "asyncio.Task[None]") -> None:
        await asyncio.wait([running])
        if running.cancelled():
            self._panel.handle_work_done(work, Refusal("stopped", f"{work.words} was stopped"))
            return
        error = running.exception()
        if error is not None and not isinstance(error, Refusal):
            raise error
        self._panel.handle_work_done(work, error)
