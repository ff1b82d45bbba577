"""Follow a job to its end on the screen."""

import time

from rich.live import Live

from orchestrator.cli.base.common import can_redraw, console
from orchestrator.cli.base.errors import errors
from orchestrator.client import Tutti
from orchestrator.model.report import JobProgress, JobReport
from orchestrator.monitor.fleet_view import LiveView, describe_progress, format_job_line


async def follow_job(tutti: Tutti, job_id: str, *, quiet: bool) -> JobReport:
    """Wait for a job, showing the fleet live on a terminal, lines elsewhere; if `quiet`, only the reason why it
    waits, on standard error."""
    if quiet:
        waits = ""

        def print_waiting(progress: JobProgress) -> None:
            nonlocal waits
            if progress.state == "queued" and progress.reason not in (waits, "submitted"):
                waits = progress.reason
                errors.print(waits, highlight=False, markup=False, soft_wrap=True)

        return await tutti.wait_for_job(job_id, print_waiting)
    if not can_redraw():
        last = ""

        def print_progress(progress: JobProgress) -> None:
            nonlocal last
            # Progress with the same state and step differs only in its time.
            if (words := describe_progress(progress)) != last:
                last = words
                console.print(format_job_line(progress), highlight=False, markup=False, soft_wrap=True)

        return await tutti.wait_for_job(job_id, print_progress)
    view = LiveView(tutti.keys, time.monotonic)
    async with tutti.subscribe_samples(*view.key_expressions) as samples:
        view.take_states(await tutti.status(), await tutti.list_leases())
        with Live(get_renderable=view.render_screen, console=console, refresh_per_second=10, transient=True):

            def take_progress(progress: JobProgress) -> None:
                view.store_progress(progress)
                while not samples.empty():
                    view.take_sample(samples.get_nowait())

            return await tutti.wait_for_job(job_id, take_progress, poll_s=0.25)
