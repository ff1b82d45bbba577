"""`tutti job ls` and `prune`: the jobs in the journal."""

from collections.abc import Sequence
from datetime import datetime
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.instants import InstantType
from orchestrator.cli.jobs.queue import print_queue_stop

if TYPE_CHECKING:
    from orchestrator.model.report import QueueEntry

_STATES = (
    *("queued", "planning", "arming", "armed", "committed", "running", "paused"),
    *("done", "failed", "cancelled", "aborted", "interrupted"),
)


@click.command("ls", epilog="Example: tutti job ls --state failed --since 7d --limit 5")
@fleet_options
@json_option
@click.option("--limit", default=20, show_default=True, type=click.IntRange(1, 10_000))
@click.option("--state", default=None, type=click.Choice(_STATES), help="Only jobs in this state.")
@click.option("--name", default="", help="Only jobs with this text in their name.")
@click.option(
    "--since", default=None, type=InstantType(past=True), help="Submitted at this time or later, or an age: 7d."
)
def list_jobs(
    connect: str, fleet: str | None, limit: int, state: str | None, name: str, since: datetime | None, *, as_json: bool
) -> None:
    """List the newest jobs. #: the place of a waiting job in the queue."""
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.service import ListJobs

    async def show_jobs(tutti: Tutti) -> None:
        request = ListJobs.model_validate({**tutti.request_fields(), "state": state})
        jobs = await tutti.list_jobs(limit, request.state, name, None if since is None else since.isoformat())
        if as_json:
            print_json([entry.to_plain() for entry in jobs.jobs])
            return
        print_jobs(jobs.jobs)
        print_queue_stop(jobs)
        if jobs.total > len(jobs.jobs):
            console.print(f"{len(jobs.jobs)} of {jobs.total}; more with --limit", highlight=False)

    with_fleet(connect, fleet, show_jobs)


def print_jobs(jobs: Sequence["QueueEntry"]) -> None:
    """Print the table of jobs."""
    from orchestrator.monitor.queue_words import make_job_table

    console.print(make_job_table(jobs))


@click.command(epilog="Example: tutti job prune --older 90d --keep 1000")
@click.option("--older", required=True, type=DurationType(), help="Age of the jobs to delete, e.g. 90d.")
@click.option(
    "--keep",
    default=1000,
    show_default=True,
    type=click.IntRange(0),
    help="Number of newest jobs that are kept anyway.",
)
@fleet_options
@json_option
def prune(older: float, keep: int, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Delete finished jobs, with their reports and client keys. A deleted key then gives a new job."""
    from orchestrator.client import Tutti

    async def prune_jobs(tutti: Tutti) -> None:
        count = await tutti.prune_jobs(older, keep)
        print_json({"jobs": count}) if as_json else console.print(f"{count} jobs deleted", highlight=False)

    with_fleet(connect, fleet, prune_jobs)
