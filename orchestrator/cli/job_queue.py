"""`tutti job hold`, `release`, `reorder`, `pause`, `resume`, `retry`: changes of jobs by users."""

import sys
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import console, exit_with_error, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.job_terms import print_accepted

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.service import JobRetried

_JOB = click.argument("job_id")
_yes = click.option("--yes", is_flag=True, help="Do not ask for confirmation after showing the positions.")


@click.command(epilog="Example: tutti job hold 3f2a91c0")
@click.argument("job_ids", nargs=-1, required=True)
@fleet_options
def hold(job_ids: tuple[str, ...], connect: str, fleet: str | None) -> None:
    """Hold queued jobs: they do not begin until they are released."""

    async def hold_jobs(tutti: "Tutti") -> None:
        await tutti.hold_jobs(*job_ids)
        console.print(f"held: {', '.join(job_ids)}", highlight=False)

    with_fleet(connect, fleet, hold_jobs)


@click.command(epilog="Example: tutti job release 3f2a91c0")
@click.argument("job_ids", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="All held jobs, as after a stop.")
@fleet_options
def release(job_ids: tuple[str, ...], connect: str, fleet: str | None, *, everything: bool) -> None:
    """Release held jobs. A stop of the fleet holds all queued jobs."""
    if everything == bool(job_ids):
        exit_with_error("name jobs, or give --all", BAD_INPUT)

    async def release_jobs(tutti: "Tutti") -> None:
        await tutti.release_jobs(*job_ids)
        console.print("released", highlight=False)

    with_fleet(connect, fleet, release_jobs)


@click.command(epilog="Example: tutti job reorder 3f2a91c0 --before 77d0aa12")
@_JOB
@click.option("--before", required=True, metavar="JOB", help="The job whose place and priority it gets.")
@fleet_options
def reorder(job_id: str, before: str, connect: str, fleet: str | None) -> None:
    """Move a queued job before another one."""

    async def reorder_job(tutti: "Tutti") -> None:
        await tutti.reorder_job(job_id, before)
        console.print(f"job {job_id} comes before job {before}", highlight=False)

    with_fleet(connect, fleet, reorder_job)


@click.command(epilog="Example: tutti job pause 3f2a91c0 --now")
@_JOB
@click.option("--now", is_flag=True, help="Brake inside a motion step; resuming continues from there.")
@fleet_options
def pause(job_id: str, connect: str, fleet: str | None, *, now: bool) -> None:
    """Pause a running job after its current step (--now: immediately). It keeps its axes; `tutti job resume`
    continues it.

    With --now all axes of a move brake together, by their planned ramps; other steps are still completed.
    """

    async def pause_job(tutti: "Tutti") -> None:
        await tutti.pause_job(job_id, now=now)
        how = "brakes and pauses" if now else "pauses at the end of its step"
        console.print(f"job {job_id} {how}; `tutti job resume {job_id}` continues it", highlight=False)

    with_fleet(connect, fleet, pause_job)


@click.command(epilog="Example: tutti job resume 3f2a91c0")
@_JOB
@fleet_options
@json_option
def resume(job_id: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Continue a paused job."""

    async def resume_job(tutti: "Tutti") -> None:
        await tutti.resume_job(job_id)
        print_json({"job_id": job_id}) if as_json else console.print(f"job {job_id} continues", highlight=False)

    with_fleet(connect, fleet, resume_job)


@click.command(epilog="Example: tutti job retry 3f2a91c0 --from-step 4")
@_JOB
@click.option(
    "--from-step",
    type=click.IntRange(0),
    default=0,
    show_default=True,
    help="First step to run; `tutti job show` numbers them, from 0.",
)
@_yes
@fleet_options
@json_option
def retry(job_id: str, from_step: int, connect: str, fleet: str | None, *, yes: bool, as_json: bool) -> None:
    """Re-run a finished job, from a step on, as a new job.

    First shows the current positions of its axes, and the remaining steps.
    """
    if not yes and not (sys.stdin.isatty() and sys.stdout.isatty() and not as_json):
        exit_with_error(
            "without a terminal for the confirmation, give --yes", BAD_INPUT, "check first: `tutti axis ls`"
        )

    async def retry_job(tutti: "Tutti") -> None:
        if not as_json:
            _show_retry(await tutti.retry_job(job_id, from_step, dry_run=True))
        if not yes and not click.confirm("run these steps from here?"):
            console.print("no job is submitted")
            return
        retried = await tutti.retry_job(job_id, from_step)
        assert retried.entry is not None
        print_json(retried.to_plain()) if as_json else print_accepted(retried.entry)

    with_fleet(connect, fleet, retry_job)


def _show_retry(found: "JobRetried") -> None:
    from orchestrator.monitor.tables import make_plain_table

    for line in found.steps:
        console.print(line, highlight=False, markup=False)
    table = make_plain_table(["axis", "position>", "unit", "axis is"])
    for each in found.axes:
        words = [] if each.enabled else ["off"]
        words += [] if each.referenced else ["unreferenced"]
        position = "unknown" if each.position is None else f"{each.position:,.4f}"
        table.add_row(each.axis, position, each.unit, ", ".join(words) or "ready")
    console.print(table)
    for warning in found.warnings:
        console.print(f"[bold yellow]note:[/] {warning}", highlight=False)
