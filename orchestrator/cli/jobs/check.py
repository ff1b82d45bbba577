"""`tutti job check`, and what a dry run shows."""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import console, json_option, print_json
from orchestrator.cli.base.errors import errors, escape_markup, run_main
from orchestrator.cli.jobs.templates.extremes import check_extremes, list_misfits
from orchestrator.cli.jobs.templates.options import read_settings, set_options
from orchestrator.model.steps.numbers import number_step

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from orchestrator.model.jobs.forecast import JobForecast, StepForecast
    from orchestrator.model.jobs.job import Job
    from orchestrator.model.templates.template import ParameterSetting

PROGRESS_STEPS = 200  # a job of fewer is checked before anyone could read how far it is


@click.command(epilog="Example: tutti job check scan.job.yaml --fleet lab.fleet.yaml")
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "--fleet",
    type=click.Path(path_type=Path),
    default=None,
    help="The fleet file; without it only the form is checked.",
)
@click.option("--repeat", type=click.IntRange(1, 10_000), default=1, help="Check that many runs, one after the other.")
@set_options
@json_option
def check(
    file: Path,
    fleet: Path | None,
    repeat: int,
    values: tuple[str, ...],
    values_file: Path | None,
    *,
    as_json: bool,
) -> None:
    """Check the job in FILE offline: names, units, limits and durations of all its steps. Nothing is connected.

    Targets are run forward through all steps. What only the machine decides, such as an input to wait for, is listed as
    a condition, and is no mistake. A job file with parameters is checked with the values of --set, or else the
    defaults; what fails at the ends of their ranges is noted.
    """
    run_main(_check_file(file, fleet, repeat, read_settings(values, values_file), as_json=as_json))


async def _check_file(
    file: Path, fleet_file: Path | None, repeat: int, settings: "Mapping[str, ParameterSetting]", *, as_json: bool
) -> None:
    from orchestrator.client.points import PointSummaries
    from orchestrator.model.jobs.files import FileError, read_file
    from orchestrator.model.jobs.forecast import JobForecast
    from orchestrator.model.steps.tree import find_paths
    from orchestrator.model.templates.template import Template
    from orchestrator.plan.forecast.job import forecast_job
    from orchestrator.runtime.checked import load_checked_fleet

    template = Template(read_file(file))
    filled_settings = template.fill_settings(settings)
    job, forecast, notes = filled_settings.job, JobForecast(), [str(problem) for problem in template.list_unused()]
    origins = [(path.origin.file, path.origin.notes) for path in find_paths(job.steps) if path.origin is not None]
    notes += [f"{name}: {text}" for name, texts in origins for text in texts]
    if fleet_file is None:
        notes += list_misfits(template, settings)
    else:
        fleet = load_checked_fleet(fleet_file)
        summaries = PointSummaries({name: fleet.axis(name).unit for name in fleet.axis_names})
        job = summaries.place_summaries(job)
        with show_progress(len(job.steps) * repeat, hidden=as_json) as on_steps:
            forecast = forecast_job(fleet, job.steps, repeat, on_steps)
        if forecast.problems and not as_json:
            raise FileError(filled_settings.problem(problem.place, problem.text) for problem in forecast.problems)
        notes += check_extremes(template, settings, fleet, summaries, repeat)
    if as_json:
        print_json({**make_plain(forecast), "parameters_used": job.parameters_used, "notes": notes})
    else:
        console.print(
            f"{file}: {describe_totals(job, forecast, repeat)}", highlight=False, markup=False, soft_wrap=True
        )
        if fleet_file is None:
            console.print("names, units and limits are not checked: give --fleet FILE", highlight=False)
        print_steps(forecast)
        for note in notes:
            console.print(f"[bold yellow]note:[/] {escape_markup(note)}", highlight=False, soft_wrap=True)
    if forecast.problems:
        raise SystemExit(BAD_INPUT)


def make_plain(forecast: "JobForecast") -> dict[str, object]:
    """The JSON form, with the totals."""
    return {**forecast.to_plain(), "least_s": forecast.least_s, "most_s": forecast.most_s}


def describe_totals(job: "Job", forecast: "JobForecast", repeat: int = 1) -> str:
    """The number of steps and the whole duration, in one line."""
    steps = f"{len(job.steps)} step{'' if len(job.steps) == 1 else 's'}" + (f", {repeat} times" if repeat > 1 else "")
    if not forecast.steps:
        return f"{steps}: no problem found"
    return f"{steps}, {_describe_span(forecast.least_s, forecast.most_s)}: no problem found"


def print_steps(forecast: "JobForecast", *, commands: bool = False) -> None:
    """Print every step with its duration and conditions, and the conditions of the job. commands: of each member."""
    from orchestrator.monitor.path_words import describe_bounds, describe_path

    def line(text: str) -> None:
        console.print(text, highlight=False, markup=False, soft_wrap=True)

    for step in forecast.steps:
        line(f"  {number_step(step.index)} {step.text}: {_describe_span(step.least_s, step.most_s)}")
        for condition in step.conditions:
            line(f"      if {condition}")
        for text in [step.lines] * bool(step.lines) + ([] if step.path is None else describe_path(step.path)):
            line(f"      {text}")
        for axis, group in step.followers.items():
            line(f"      {axis} moves along, by the errors of {group}")
        for text in describe_bounds(step):
            line(f"      {text}")
        if commands:
            _print_commands(step, line)
    if forecast.conditions:
        line("what only the machine decides:")
        for condition in forecast.conditions:
            line(f"  {condition}")


def _print_commands(step: "StepForecast", line: "Callable[[str], None]") -> None:
    for member, commands in step.commands.items():
        for command in commands:
            line(f"      {member}: {command}")


def _describe_span(least_s: float, most_s: float | None) -> str:
    if most_s is None:
        return f"at least {least_s:.3f} s"
    return f"{least_s:.3f} s" if abs(most_s - least_s) < 0.0005 else f"{least_s:.3f} to {most_s:.3f} s"


@contextmanager
def show_progress(total: int, *, hidden: bool) -> "Generator[Callable[[int], None]]":
    """Show how many steps of a long job are done, on a terminal."""
    if hidden or total < PROGRESS_STEPS or not errors.is_terminal:
        yield lambda _: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (TextColumn("checking"), BarColumn(), MofNCompleteColumn(), TextColumn("steps"))
    with Progress(*columns, console=errors, transient=True) as progress:
        task = progress.add_task("check", total=total)
        yield lambda count: progress.update(task, completed=count)
