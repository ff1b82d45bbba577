"""A bar that shows how far a job is, for a script that waits for it."""

from collections.abc import Callable, Generator
from contextlib import contextmanager

from orchestrator.model.report import JobProgress


@contextmanager
def show_bar(*, wanted: bool) -> Generator[Callable[[JobProgress], None] | None]:
    """A receiver of progress, which a bar shows while the context lasts. None if no bar is asked for, and where nothing
    can be drawn over: a pipe, a file, the log of a service."""
    if not wanted:
        yield None
        return
    from rich.console import Console
    from rich.live import Live

    from orchestrator.monitor.fleet_view import make_job_bar

    console = Console(stderr=True)
    if not (console.is_terminal or console.is_jupyter):
        yield None
        return
    with Live(console=console, refresh_per_second=10, transient=True) as live:
        yield lambda progress: live.update(make_job_bar(progress))
