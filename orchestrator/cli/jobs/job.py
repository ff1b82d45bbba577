"""`tutti job …` and `tutti submit`."""

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

import click

from orchestrator.cli.base.codes import FAILED, INTERRUPTED
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.jobs import job_argument, load_report, name_jobs
from orchestrator.cli.base.plugin_commands import PluginGroup
from orchestrator.cli.jobs.approval import approve, plan
from orchestrator.cli.jobs.check import check
from orchestrator.cli.jobs.continuing import continue_job
from orchestrator.cli.jobs.history import list_jobs, prune
from orchestrator.cli.jobs.order import go, hold, override, pause, release, reorder, resume, retry
from orchestrator.cli.jobs.plot import plot
from orchestrator.cli.jobs.points import points, show_points
from orchestrator.cli.jobs.templates.options import read_settings, set_options
from orchestrator.cli.jobs.templates.template import parameters
from orchestrator.cli.jobs.terms import (
    TermsOptions,
    make_entry_lines,
    make_terms,
    print_accepted,
    resolve_after,
    terms_options,
)
from orchestrator.cli.jobs.timeline import timeline
from orchestrator.model.steps.numbers import number_step

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.templates.template import FilledJob

_FILE = click.argument("file", type=click.Path(path_type=Path))


class _JobGroup(PluginGroup):
    plugin_words = ("job",)


@click.group(cls=_JobGroup, epilog="Example: tutti job submit move.job.yaml --wait")
def job() -> None:
    """Submit, list, show, approve, reorder, pause, cancel, continue and retry jobs, and read their reports."""


@click.command("submit", epilog="Example: tutti job submit scan.job.yaml --repeat 3 --at 22:30")
@_FILE
@fleet_options
@json_option
@click.option("--wait", is_flag=True, help="Wait for the end and print the report; exit 1 unless the job is done.")
@click.option("--cancel-on-interrupt", is_flag=True, help="With --wait: Ctrl-C cancels the job instead of leaving it.")
@click.option(
    "--dry-run",
    is_flag=True,
    help="Only check all steps from the current positions, and show what each controller would be sent.",
)
@click.option("--key", default=None, help="Client key: repeating a key returns the same job, never a second one.")
@set_options
@terms_options
def submit(
    file: Path,
    connect: str,
    fleet: str | None,
    key: str | None,
    values: tuple[str, ...],
    values_file: Path | None,
    *,
    as_json: bool,
    wait: bool,
    cancel_on_interrupt: bool,
    dry_run: bool,
    **terms: Unpack[TermsOptions],
) -> None:
    """Submit the job in FILE. It begins when its axes are free, and no earlier job waits for them.

    --set gives values to the parameters of FILE, which `tutti job parameters FILE` lists.
    """
    from orchestrator.cli.jobs.follow import follow_job
    from orchestrator.cli.jobs.foreground import (
        controllers_of,
        count_interrupts,
        follow_unless_interrupted,
        say,
        stop_own_job,
    )
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.files import read_file
    from orchestrator.model.templates.template import Template
    from orchestrator.monitor.report_table import make_report_tables

    wanted_terms, settings = make_terms(terms), read_settings(values, values_file)

    async def submit_job(tutti: Tutti) -> None:
        filled_settings = Template(read_file(file)).fill_settings(settings)
        if dry_run:
            await _show_dry_run(tutti, filled_settings, as_json=as_json)
            return
        with show_points(hidden=as_json) as on_points:
            loaded_points = await tutti.send_points(filled_settings.job, on_points)
        entry = await tutti.enqueue_job(loaded_points, key, await resolve_after(tutti, wanted_terms))
        if not wait:
            print_json({"job_id": entry.id, "at": entry.terms.at}) if as_json else print_accepted(entry)
            return
        if entry.terms.at is not None and not as_json:
            print_accepted(entry)
        with count_interrupts() as interrupts:
            report = await follow_unless_interrupted(follow_job(tutti, entry.id, quiet=as_json), interrupts)
            if report is None and cancel_on_interrupt:
                await stop_own_job(tutti, entry.id, controllers_of(loaded_points), interrupts)
        if report is None:
            if not cancel_on_interrupt:
                say(f"job {entry.id} continues; cancel it with: tutti job cancel {entry.id}")
            raise SystemExit(INTERRUPTED)
        print_json(report.to_plain()) if as_json else console.print(make_report_tables(report))
        if report.state != "done":
            raise SystemExit(FAILED)

    with_fleet(connect, fleet, submit_job)


job.add_command(submit)
for command in (
    plot,
    timeline,
    check,
    parameters,
    list_jobs,
    points,
    prune,
    hold,
    release,
    plan,
    approve,
    reorder,
    pause,
    go,
    override,
    resume,
    retry,
    continue_job,
):
    job.add_command(command)


@job.command(epilog="Example: tutti job show 3f2a91c0")
@job_argument
@fleet_options
@json_option
def show(job: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show JOB: its steps and the history of its state. JOB: the beginning of its id, its name, or `last`."""
    from orchestrator.client import Tutti
    from orchestrator.model.steps.order import StepOrder
    from orchestrator.monitor.fleet_view import format_line, format_step
    from orchestrator.monitor.report_table import describe_gap, describe_used
    from orchestrator.monitor.times import format_time, localize_times

    async def show_job(tutti: Tutti) -> None:
        shown_job = await tutti.show_job((await tutti.find_job(job)).id)
        if as_json:
            print_json(shown_job.to_plain())
            return
        assert shown_job.entry is not None
        head = f"{name_jobs(shown_job.entry)} of {shown_job.entry.actor}: {shown_job.entry.state}"
        console.print(head, highlight=False, markup=False)
        parameters = shown_job.job.parameters_used if shown_job.job else {}
        positions = shown_job.report.positions_used if shown_job.report else {}
        for line in [*make_entry_lines(shown_job.entry), *describe_used(parameters, positions)]:
            console.print(line, highlight=False, markup=False)
        went = {step.index: step for step in shown_job.report.steps} if shown_job.report else {}
        for index, step in StepOrder(shown_job.job.steps).iterate_written() if shown_job.job else ():
            line = f"  {number_step(index)} {step.describe()}"
            if (over := went.get(index)) is not None:
                line += f": {over.state}" + (f" ({over.reason})" if over.reason else "")
                line += f", {gap_text}" if (gap_text := describe_gap(over)) else ""
            console.print(line, highlight=False, markup=False, soft_wrap=True)
            for inner in () if step.is_single else step.iterate_written():
                console.print(f"      {inner.describe()}", highlight=False, markup=False, soft_wrap=True)
        if shown_job.progress is not None:
            console.print(
                f"now: {format_step(shown_job.progress)}{format_line(shown_job.progress)}",
                highlight=False,
                markup=False,
            )
        for change in shown_job.transitions:
            reason = f" {localize_times(change.reason)}" if change.reason else ""
            line = f"{format_time(change.utc, precise=True)} {change.state}{reason} ({change.actor})"
            console.print(line, highlight=False, markup=False)

    with_fleet(connect, fleet, show_job)


@job.command(epilog="Example: tutti job cancel 3f2a91c0")
@job_argument
@fleet_options
@json_option
def cancel(job: str, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Cancel a JOB: a queued one never runs, a running one is stopped."""
    from orchestrator.client import Tutti

    async def cancel_job(tutti: Tutti) -> None:
        entry = await tutti.find_job(job)
        await tutti.cancel_job(entry.id)
        print_result({"job_id": entry.id}, f"{name_jobs(entry)} is cancelled", as_json=as_json)

    with_fleet(connect, fleet, cancel_job)


@job.command(epilog="Example: tutti job report 3f2a91c0 --json")
@job_argument
@click.option("-v", "--verbose", is_flag=True, help="All steps, with members, budgets and measurements.")
@fleet_options
@json_option
def report(job: str, connect: str, fleet: str | None, *, verbose: bool, as_json: bool) -> None:
    """Print the report of a finished JOB: verdict, steps and durations; with -v also members and budgets."""
    from orchestrator.client import Tutti
    from orchestrator.monitor.report_table import make_report_tables

    async def show_report(tutti: Tutti) -> None:
        found_report = await load_report(tutti, job)
        print_json(found_report.to_plain()) if as_json else console.print(
            make_report_tables(found_report, detailed=verbose)
        )

    with_fleet(connect, fleet, show_report)


async def _show_dry_run(tutti: "Tutti", filled: "FilledJob", *, as_json: bool) -> None:
    """Run a job forward from the present positions and print what every controller would be sent."""
    from orchestrator.cli.jobs.check import describe_totals, make_plain, print_steps, show_progress
    from orchestrator.model.jobs.files import FileError

    with show_points(hidden=as_json) as on_points:
        loaded_points = await tutti.send_points(filled.job, on_points)
    with show_progress(len(loaded_points.steps), hidden=as_json) as on_steps:
        forecast = await tutti.dry_run(loaded_points, on_steps)
    if as_json:
        print_json(make_plain(forecast))
    elif forecast.problems:
        raise FileError(filled.problem(problem.place, problem.text) for problem in forecast.problems)
    else:
        totals = describe_totals(loaded_points, forecast)
        console.print(f"{filled.file.name}: {totals}", highlight=False, markup=False, soft_wrap=True)
        print_steps(forecast, commands=True)
    if forecast.problems:
        raise SystemExit(FAILED)
