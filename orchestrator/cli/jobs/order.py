"""`tutti job hold`, `release`, `reorder`, `pause`, `resume`, `retry`: changes of jobs by users."""

import sys
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.jobs import JobReferenceType, job_argument, jobs_argument, name_jobs
from orchestrator.cli.base.steps import StepType
from orchestrator.cli.base.terminal import confirm_shown
from orchestrator.cli.jobs.terms import print_accepted
from orchestrator.model.steps.numbers import number_step

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.service import JobRetried

_yes = click.option("--yes", is_flag=True, help="Do not ask for confirmation after showing the positions.")


@click.command(epilog="Example: tutti job hold 3f2a91c0")
@jobs_argument(required=True)
@fleet_options
@json_option
def hold(jobs: tuple[str, ...], connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Hold queued JOBS: they do not begin until they are released."""

    async def hold_jobs(tutti: "Tutti") -> None:
        entries = [await tutti.find_job(job) for job in jobs]
        await tutti.hold_jobs(*(entry.id for entry in entries))
        print_result({"held": [entry.id for entry in entries]}, f"held: {name_jobs(*entries)}", as_json=as_json)

    with_fleet(connect, fleet, hold_jobs)


@click.command(epilog="Example: tutti job release 3f2a91c0")
@jobs_argument(required=False)
@click.option("--all", "everything", is_flag=True, help="All jobs that were held by hand or after a failure.")
@fleet_options
@json_option
def release(jobs: tuple[str, ...], connect: str, fleet: str | None, *, everything: bool, as_json: bool) -> None:
    """Release held JOBS, also those that had to wait for a cause which is gone: what they move first is printed."""
    if everything == bool(jobs):
        exit_with_error("name jobs, or give --all", BAD_INPUT)

    from orchestrator.model.jobs.restart import RESTART
    from orchestrator.monitor.queue_words import describe_start

    async def release_jobs(tutti: "Tutti") -> None:
        entries = [await tutti.find_job(job) for job in jobs]
        job_ids = [entry.id for entry in entries]
        preview = await tutti.preview_start(*job_ids) if any(entry.held_by == RESTART for entry in entries) else None
        for line in [] if preview is None or as_json else describe_start(preview):
            console.print(line, highlight=False, markup=False, soft_wrap=True)
        await tutti.release_jobs(*job_ids, preview=preview)
        value: dict[str, Any] = {"released": [entry.id for entry in entries], "all": everything}
        print_result(value, f"released: {name_jobs(*entries) or 'all held jobs'}", as_json=as_json)

    with_fleet(connect, fleet, release_jobs)


@click.command(epilog="Example: tutti job reorder 3f2a91c0 --before 77d0aa12")
@job_argument
@click.option(
    "--before", required=True, metavar="JOB", type=JobReferenceType(), help="The job whose place and priority it gets."
)
@fleet_options
@json_option
def reorder(job: str, before: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Move a queued JOB before another one."""

    async def reorder_job(tutti: "Tutti") -> None:
        moved_entry, other_entry = await tutti.find_job(job), await tutti.find_job(before)
        await tutti.reorder_job(moved_entry.id, other_entry.id)
        words = f"{name_jobs(moved_entry)} comes before {name_jobs(other_entry)}"
        print_result({"job_id": moved_entry.id, "before": other_entry.id}, words, as_json=as_json)

    with_fleet(connect, fleet, reorder_job)


@click.command(epilog="Example: tutti job pause 3f2a91c0 --now")
@job_argument
@click.option("--now", is_flag=True, help="Brake inside a motion step; resuming continues from there.")
@fleet_options
@json_option
def pause(job: str, connect: str, fleet: str | None, *, now: bool, as_json: bool) -> None:
    """Pause a running JOB after its current step (--now: immediately). It keeps its axes; `tutti job resume`
    continues it.

    With --now all axes of a move brake together, by their planned ramps, and on a path along it; other steps are still
    completed.
    """

    async def pause_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        await tutti.pause_job(entry.id, now=now)
        manner = "brakes and pauses" if now else "pauses at the end of its step"
        words = f"{name_jobs(entry)} {manner}; `tutti job resume {entry.id}` continues it"
        print_result({"job_id": entry.id}, words, as_json=as_json)

    with_fleet(connect, fleet, pause_job)


@click.command(epilog="Example: tutti job override 3f2a91c0 50")
@job_argument
@click.argument("percent", type=float)
@fleet_options
@json_option
def override(job: str, percent: float, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Play the path of a running JOB at PERCENT of its planned speed, or plan its next moves so.

    From 10 to 120 %; 100 as planned. All axes change their speed together, on the path, within a second or two: for as
    long as controllers need to load what they play next. More than 100 % is possible where only the path's own `speed`
    limits it, not the axes. In moves and scans the present move goes on as it was planned; those after it are planned
    with 10 to 100 % of their speed.
    """

    async def override_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        await tutti.override_job(entry.id, percent)
        words = f"{name_jobs(entry)} moves at {percent:g} % of its planned speed"
        print_result({"job_id": entry.id, "percent": percent}, words, as_json=as_json)

    with_fleet(connect, fleet, override_job)


@click.command(epilog="Example: tutti job go 3f2a91c0")
@job_argument
@click.option("--at", "at_fleet_ns", type=int, metavar="NS", help="Start at this instant, fleet time in ns.")
@fleet_options
@json_option
def go(job: str, at_fleet_ns: int | None, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Start the step of a running JOB that waits armed (`do: wait_armed`).

    All its axes start together as soon as all controllers can, or at the instant that is named.
    """

    async def start_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        t0_ns = await tutti.go_job(entry.id, at_fleet_ns)
        words = f"{name_jobs(entry)} starts at {t0_ns} ns of fleet time"
        print_result({"job_id": entry.id, "t0_fleet_ns": t0_ns}, words, as_json=as_json)

    with_fleet(connect, fleet, start_job)


@click.command(epilog="Example: tutti job resume 3f2a91c0")
@job_argument
@fleet_options
@json_option
def resume(job: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Continue a paused JOB."""

    async def resume_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        await tutti.resume_job(entry.id)
        print_result({"job_id": entry.id}, f"{name_jobs(entry)} continues", as_json=as_json)

    with_fleet(connect, fleet, resume_job)


def _refuse_from_step(ctx: click.Context, param: click.Parameter, value: str | None) -> None:
    """Refuse the option of version 0.4 in 0.5: it counted from 0, so the same number would mean another step."""
    del ctx, param
    if value is not None:
        exit_with_error(
            "--from-step is called --step now, and counts from 1",
            BAD_INPUT,
            f"what was --from-step {value} is --step {number_step(int(value))}" if value.isdecimal() else "give --step",
        )


@click.command(epilog="Example: tutti job retry 3f2a91c0 --step 4")
@job_argument
@click.option(
    "--step",
    type=StepType(),
    default=1,
    show_default=True,
    help="First step to run; `tutti job show` numbers them, from 1.",
)
@click.option(
    "--from-point", type=click.IntRange(1), default=None, help="First point to run of the scan at --step, from 1."
)
@click.option("--from-step", default=None, hidden=True, expose_value=False, callback=_refuse_from_step)
@_yes
@fleet_options
@json_option
def retry(
    job: str, step: int, from_point: int | None, connect: str, fleet: str | None, *, yes: bool, as_json: bool
) -> None:
    """Re-run a finished JOB, from a step, or a point of a scan, on, as a new job.

    First shows the current positions of its axes, and the remaining steps.
    """
    if not yes and not (sys.stdin.isatty() and sys.stdout.isatty() and not as_json):
        exit_with_error(
            "without a terminal for the confirmation, give --yes", BAD_INPUT, "check first: `tutti axis ls`"
        )

    async def retry_job(tutti: "Tutti") -> None:
        job_id = (await tutti.find_job(job)).id
        first = step if from_point is None else (step, from_point)
        if not as_json:
            _show_retry(await tutti.retry_job(job_id, first, dry_run=True))
        if not yes and not confirm_shown("run these steps from here?"):
            console.print("no job is submitted")
            return
        retried_job = await tutti.retry_job(job_id, first)
        assert retried_job.entry is not None
        print_json(retried_job.to_plain()) if as_json else print_accepted(retried_job.entry)

    with_fleet(connect, fleet, retry_job)


def _show_retry(found: "JobRetried") -> None:
    from orchestrator.monitor.tables import make_plain_table

    for line in found.steps:
        console.print(line, highlight=False, markup=False)
    table = make_plain_table(["axis", "position>", "unit", "axis is"])
    for axis in found.axes:
        words = [] if axis.enabled else ["off"]
        words += [] if axis.referenced else ["unreferenced"]
        position = "unknown" if axis.position is None else f"{axis.position:,.4f}"
        table.add_row(axis.axis, position, axis.unit, ", ".join(words) or "ready")
    console.print(table)
    for warning in found.warnings:
        console.print(f"[bold yellow]note:[/] {warning}", highlight=False)
