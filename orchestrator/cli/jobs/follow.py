"""Follow a job to its end on the screen."""

import sys
import time

from rich.live import Live

from orchestrator.cli.base.common import can_redraw, console
from orchestrator.cli.base.errors import errors
from orchestrator.cli.base.terminal import forget_typed_ahead, wait_for_line
from orchestrator.client import Tutti
from orchestrator.client.ready import ReadyToBegin
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.restart import StartPreview
from orchestrator.model.report import JobProgress, JobReport
from orchestrator.monitor.fleet_view import LiveView, describe_progress, format_job_line
from orchestrator.monitor.queue_words import describe_start


async def follow_job(tutti: Tutti, job_id: str, *, quiet: bool) -> JobReport:
    """Wait for a job, showing the fleet live on a terminal, lines elsewhere; if `quiet`, only the reason why it
    waits, on standard error. Once a cause is gone that it had to wait for, a terminal shows what moves first and asks.

    Raises `ReadyToBegin` then without a terminal, or if the answer is no.
    """
    can_ask = sys.stdin.isatty() and not quiet
    while True:
        try:
            return await _follow_until_ready(tutti, job_id, quiet=quiet)
        except ReadyToBegin as ready:
            if not can_ask or not await _ask_to_begin(ready.preview):
                raise
            try:
                await tutti.release_jobs(job_id, preview=ready.preview)
            except Refusal as error:
                errors.print(error.text, highlight=False, markup=False, soft_wrap=True)


async def _ask_to_begin(preview: StartPreview) -> bool:
    """Show what would move first, and wait for Enter. What was typed before it was shown counts for nothing."""
    for line in describe_start(preview):
        errors.print(line, highlight=False, markup=False, soft_wrap=True)
    errors.print("what it waited for is gone: Enter begins, Ctrl-C leaves", highlight=False, markup=False)
    forget_typed_ahead()
    return await wait_for_line()


async def _follow_until_ready(tutti: Tutti, job_id: str, *, quiet: bool) -> JobReport:
    if quiet:
        waits = ""

        def print_waiting(progress: JobProgress) -> None:
            nonlocal waits
            if progress.state == "queued" and progress.reason not in (waits, "submitted"):
                waits = progress.reason
                errors.print(waits, highlight=False, markup=False, soft_wrap=True)

        return await tutti.wait_for_job(job_id, print_waiting, on_ready=lambda _: False)
    if not can_redraw():
        last = ""

        def print_progress(progress: JobProgress) -> None:
            nonlocal last
            # Progress with the same state and step differs only in its time.
            if (words := describe_progress(progress)) != last:
                last = words
                console.print(format_job_line(progress), highlight=False, markup=False, soft_wrap=True)

        return await tutti.wait_for_job(job_id, print_progress, on_ready=lambda _: False)
    view = LiveView(tutti.keys, time.monotonic)
    async with tutti.follow_all(*view.key_expressions) as stream:
        samples, stream.on_confirmed = stream.queue, view.note_confirmed
        view.take_states(await tutti.status(), await tutti.list_leases())
        with Live(get_renderable=view.render_screen, console=console, refresh_per_second=10, transient=True):

            def take_progress(progress: JobProgress) -> None:
                view.store_progress(progress)
                while not samples.empty():
                    view.take_sample(samples.get_nowait())

            return await tutti.wait_for_job(job_id, take_progress, poll_s=0.25, on_ready=lambda _: False)
