"""`tutti job hold`, `release`, `move`, `pause`, `resume`, `retry`: what people change about jobs."""

import sys
from typing import TYPE_CHECKING

import click

from orchestrator.cli.codes import BAD_INPUT
from orchestrator.cli.common import console, fail, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.job_terms import tell_accepted

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.service import AgainReply

_JOB = click.argument("job_id")
_yes = click.option("--yes", is_flag=True, help="Do not ask, having shown where the axes stand.")


@click.command(epilog="Example: tutti job hold 3f2a91c0")
@click.argument("job_ids", nargs=-1, required=True)
@fleet_options
def hold(job_ids: tuple[str, ...], connect: str, fleet: str | None) -> None:
    """Keep queued jobs from beginning until they are released."""

    async def act(tutti: "Tutti") -> None:
        await tutti.hold(*job_ids)
        console.print(f"held: {', '.join(job_ids)}", highlight=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti job release 3f2a91c0")
@click.argument("job_ids", nargs=-1)
@click.option("--all", "everything", is_flag=True, help="All that are held, as after a stop.")
@fleet_options
def release(job_ids: tuple[str, ...], everything: bool, connect: str, fleet: str | None) -> None:
    """Let held jobs begin when it is their turn. A stop of the fleet holds all that is queued."""
    if everything == bool(job_ids):
        fail("name jobs, or say --all", BAD_INPUT)

    async def act(tutti: "Tutti") -> None:
        await tutti.release(*job_ids)
        console.print("released", highlight=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti job move 3f2a91c0 --before 77d0aa12")
@_JOB
@click.option("--before", required=True, metavar="JOB", help="Whose place, and priority, it takes.")
@fleet_options
def move(job_id: str, before: str, connect: str, fleet: str | None) -> None:
    """Put a queued job before another one."""

    async def act(tutti: "Tutti") -> None:
        await tutti.move(job_id, before)
        console.print(f"job {job_id} comes before job {before}", highlight=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti job pause 3f2a91c0 --now")
@_JOB
@click.option("--now", is_flag=True, help="Brake inside a motion step; it goes on from where it stands.")
@fleet_options
def pause(job_id: str, now: bool, connect: str, fleet: str | None) -> None:
    """Hold a running job when its present step has ended, or --now. It keeps its axes; `tutti job resume` goes on.

    With --now all axes of a move brake together, by their planned ramps; other steps still come to their end.
    """

    async def act(tutti: "Tutti") -> None:
        await tutti.pause(job_id, now)
        how = "brakes and holds" if now else "pauses at the end of its step"
        console.print(f"job {job_id} {how}; `tutti job resume {job_id}` goes on", highlight=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti job resume 3f2a91c0 --from-step 4")
@_JOB
@click.option(
    "--from-step",
    type=click.IntRange(0),
    default=None,
    help="Of an ended job: do it again from here on; `tutti job show` numbers them, from 0.",
)
@_yes
@fleet_options
@json_option
def resume(job_id: str, from_step: int | None, yes: bool, connect: str, fleet: str | None, as_json: bool) -> None:
    """Go on with a paused job; or with an ended one, from a step on, as a new job.

    Of an ended one it shows first where each axis stands now, and what remains to be done.
    """
    if from_step is not None:
        _again(job_id, from_step, yes, connect, fleet, as_json)
        return

    async def act(tutti: "Tutti") -> None:
        await tutti.resume(job_id)
        print_json({"job_id": job_id}) if as_json else console.print(f"job {job_id} goes on", highlight=False)

    with_fleet(connect, fleet, act)


@click.command(epilog="Example: tutti job retry 3f2a91c0")
@_JOB
@_yes
@fleet_options
@json_option
def retry(job_id: str, yes: bool, connect: str, fleet: str | None, as_json: bool) -> None:
    """Do an ended job again from its beginning, as a new job, having shown where each axis stands now."""
    _again(job_id, 0, yes, connect, fleet, as_json)


def _again(job_id: str, from_step: int, yes: bool, connect: str, fleet: str | None, as_json: bool) -> None:
    if not yes and not (sys.stdin.isatty() and sys.stdout.isatty() and not as_json):
        fail("without a terminal to ask on, say --yes", BAD_INPUT, "look first: `tutti axis ls`")

    async def act(tutti: "Tutti") -> None:
        if not as_json:
            _show(await tutti.again(job_id, from_step, dry_run=True))
        if not yes and not click.confirm("run these steps from here?"):
            console.print("nothing is submitted")
            return
        taken = await tutti.again(job_id, from_step)
        assert taken.entry is not None
        print_json(taken.to_plain()) if as_json else tell_accepted(taken.entry)

    with_fleet(connect, fleet, act)


def _show(found: "AgainReply") -> None:
    from orchestrator.monitor.tables import plain_table

    for line in found.steps:
        console.print(line, highlight=False, markup=False)
    table = plain_table(["axis", "stands at>", "unit", "axis is"])
    for each in found.axes:
        words = [] if each.enabled else ["off"]
        words += [] if each.referenced else ["unreferenced"]
        position = "unknown" if each.position is None else f"{each.position:,.4f}"
        table.add_row(each.axis, position, each.unit, ", ".join(words) or "ready")
    console.print(table)
    for warning in found.warnings:
        console.print(f"[bold yellow]note:[/] {warning}", highlight=False)
