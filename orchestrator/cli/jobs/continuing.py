"""`tutti job continue`: a job that has ended on its way goes on from the place where it stood."""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, with_fleet
from orchestrator.cli.base.errors import errors, exit_with_error
from orchestrator.cli.base.jobs import job_argument
from orchestrator.cli.base.terminal import confirm_shown
from orchestrator.cli.jobs.terms import print_accepted

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.rest import JobRest


@click.command(
    "continue",
    epilog="""\b
Examples:
  tutti job continue last
  tutti job continue 3f2a91c0 part.ngc
  tutti job continue 3f2a91c0 --dry-run""",
)
@job_argument
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--dry-run", is_flag=True, help="Only show where it stood, the way back, and what is left.")
@click.option("--yes-move", is_flag=True, help="Do not ask before the move back to where it stood.")
@click.option("--yes-start", is_flag=True, help="Do not ask before outputs are switched and the rest is submitted.")
@fleet_options
@json_option
def continue_job(
    job: str,
    file: Path | None,
    connect: str,
    fleet: str | None,
    *,
    dry_run: bool,
    yes_move: bool,
    yes_start: bool,
    as_json: bool,
) -> None:
    """Go on with a JOB that an e-stop, a stop, a cancel or a failed step has ended, from the place where it stood.

    A path goes on on its way, a scan with its point, a program with its line; FILE is what the job was made of, and has
    to be as it was. First shows the way back there, which the axes go straight and together; then what is switched and
    left. Each is asked for. The rest is a new job.
    """
    if not (dry_run or (yes_move and yes_start) or (is_terminal() and not as_json)):
        text = "without a terminal for the confirmations, give --yes-move and --yes-start"
        exit_with_error(text, BAD_INPUT, "look first: `tutti job continue JOB --dry-run`")

    async def continue_found(tutti: "Tutti") -> None:
        job_rest = await tutti.find_rest((await tutti.find_job(job)).id, file)
        if dry_run and as_json:
            print_json(job_rest.to_plain())
            return
        if not as_json:
            _show_place(job_rest)
        if dry_run:
            _show_start(job_rest)
            return
        if job_rest.move is not None and not await _go_back(tutti, job_rest, asked=yes_move, quiet=as_json):
            return
        if not as_json:
            _show_start(job_rest)
        if not yes_start and not confirm_shown(_ask_for_start(job_rest)):
            console.print("no job is submitted")
            return
        submitted_job = await tutti.continue_job(job_rest)
        entry = (await submitted_job.show()).entry
        assert entry is not None
        print_json(entry.to_plain()) if as_json else print_accepted(entry)

    with_fleet(connect, fleet, continue_found)


def is_terminal() -> bool:
    """Whether a person can be asked."""
    return sys.stdin.isatty() and sys.stdout.isatty()


async def _go_back(tutti: "Tutti", job_rest: "JobRest", *, asked: bool, quiet: bool) -> bool:
    """Take the axes back. False: that was not wanted. Ends the process if they do not arrive."""
    from orchestrator.cli.jobs.foreground import run_attended

    if not asked and not confirm_shown("is the way free? move there?"):
        console.print("nothing moves")
        return False
    assert job_rest.move is not None
    report = await run_attended(tutti, job_rest.move, wait=False, quiet=quiet)
    if report.state != "done":
        errors.print(f"the way back is {report.state}: {report.reason}", highlight=False, markup=False)
        raise SystemExit(FAILED)
    return True


def _ask_for_start(job_rest: "JobRest") -> str:
    return "switch these outputs, and go on from there?" if job_rest.outputs else "go on from there?"


def _show_place(job_rest: "JobRest") -> None:
    from orchestrator.monitor.tables import make_plain_table

    console.print(f"{job_rest.name!r} stood at {job_rest.place}", highlight=False, markup=False)
    if not job_rest.way:
        return
    console.print("the axes go back, straight and together:", highlight=False, markup=False)
    table = make_plain_table(["axis", "from>", "to>", "unit"])
    for way in job_rest.way:
        table.add_row(way.axis, f"{way.here:,.4f}", f"{way.to:,.4f}", way.unit)
    console.print(table)


def _show_start(job_rest: "JobRest") -> None:
    lines = [f"{output} is switched {'on' if level else 'off'}" for output, level in job_rest.outputs.items()]
    for line in (*job_rest.confirm, *lines, "left:", *(f"  {step}" for step in job_rest.steps)):
        console.print(line, highlight=False, markup=False)
