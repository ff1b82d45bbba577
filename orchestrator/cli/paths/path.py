"""`tutti path …`: paths before they run."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import json_option, print_result
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.pictures import picture_option, write_picture
from orchestrator.cli.base.steps import StepType
from orchestrator.cli.manual.axis import parse_targets
from orchestrator.cli.paths.import_command import import_path
from orchestrator.model.steps.numbers import name_step, number_step

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet
    from orchestrator.model.jobs.forecast import AxisForecast
    from orchestrator.model.jobs.job import Job
    from orchestrator.model.steps.base import Step
    from orchestrator.plan.forecast.job import JobForecaster
    from orchestrator.plan.path_step import PlannedPath


@click.group(epilog="Example: tutti path plot part.job.yaml --fleet lab.fleet.yaml -o part.png")
def path() -> None:
    """Look at the paths of jobs before they run; take paths of other programs."""


path.add_command(import_path)


@path.command(epilog="Example: tutti path plot part.job.yaml --fleet lab.fleet.yaml --at gantry.x=20 -o part.png")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--fleet", type=click.Path(path_type=Path), required=True, help="The fleet file: axes and their limits.")
@click.option("--step", type=StepType(), default=None, help="The step of the job, from 1; default: its first path.")
@click.option(
    "--at",
    multiple=True,
    metavar="AXIS=VALUE",
    help="Where an axis stands before the job, if no step says so; repeat it for others.",
)
@picture_option("Output file; default: FILE with the suffix .png.")
@json_option
def plot(file: Path, fleet: Path, step: int | None, at: tuple[str, ...], out: Path | None, *, as_json: bool) -> None:
    """Plot a path of the job in FILE before it runs, or a scan that flies: its course, the speed along it, and what
    each axis uses of its limits, coloured by what limits the speed. Nothing is connected.

    The steps before it are run forward, because a path begins where its axes stand.
    """
    from orchestrator.client.points import place_flown_specs
    from orchestrator.model.templates.template import load_job
    from orchestrator.monitor.path_plot import PathAxes, plot_path
    from orchestrator.monitor.path_words import describe_path
    from orchestrator.plan.forecast.job import JobForecaster
    from orchestrator.runtime.checked import load_checked_fleet

    loaded_fleet, job = load_checked_fleet(fleet), place_flown_specs(load_job(file))
    index, path = _find_path(job, step)
    forecaster = JobForecaster(loaded_fleet, _place_axes(loaded_fleet, parse_targets(at, "--at")))
    path_plan = _run_forward(forecaster, loaded_fleet, job, index)
    axes = {name: loaded_fleet.axis(name) for name in path_plan.counts_per_unit}
    offsets = {name: float(forecaster.axes[name].offset) for name in axes}
    lines = describe_path(path_plan.report)
    target = out or file.with_suffix(".png")
    title = f"{job.name!r}, {name_step(index)}: {lines[0].partition(';')[0]}"
    frame_name = next(iter(path.frames), None)
    frame = None if frame_name is None else loaded_fleet.path_frames[frame_name]
    write_picture(plot_path(path_plan, PathAxes(axes, offsets, frame), title), target)
    print_result({"file": str(target), "path": path_plan.report.to_plain()}, f"{lines[0]}\n{target}", as_json=as_json)


def _find_path(job: "Job", step: int | None) -> "tuple[int, Step]":
    from orchestrator.model.steps.scan import Scan

    paths: dict[int, Step] = {
        index: path
        for index, path in enumerate(job.steps)
        if path.follows_path or (isinstance(path, Scan) and path.fly is not None)
    }
    if not paths:
        text = f"job {job.name!r} has no step `do: path`, and no scan with `fly`"
        exit_with_error(text, BAD_INPUT, "steps inside repeats are not plotted")
    index = next(iter(paths)) if step is None else step
    if index not in paths:
        number_list = ", ".join(str(number_step(known_index)) for known_index in paths)
        exit_with_error(
            f"{name_step(index)} of job {job.name!r} is no path, and no scan that flies",
            BAD_INPUT,
            f"its paths, and scans that fly, are the steps {number_list}",
        )
    return index, paths[index]


def _place_axes(fleet: "Fleet", values: Mapping[str, str | float]) -> "dict[str, AxisForecast]":
    """The states of the axes whose positions are given."""
    from orchestrator.model.jobs.forecast import AxisForecast
    from orchestrator.model.units import parse_quantity

    placed_forecasts: dict[str, AxisForecast] = {}
    for name, value in values.items():
        unknown = fleet.names.explain_unknown(name, "axis")
        if unknown is not None:
            exit_with_error(unknown, BAD_INPUT, "correct --at")
        placed_forecasts[name] = AxisForecast(motor=parse_quantity(value, fleet.axis(name).unit), known=True)
    return placed_forecasts


def _run_forward(forecaster: "JobForecaster", fleet: "Fleet", job: "Job", last: int) -> "PlannedPath":
    """Run the steps forward to the path, and plan it. last: the index of the path."""
    from orchestrator.model.positions.resolve import PositionResolver, list_file_positions

    resolver = PositionResolver(fleet, list_file_positions(fleet), keep_unknown=True)
    forecast = None
    for index, step in enumerate(job.steps[: last + 1]):
        forecast = forecaster.take(index, resolver.resolve_step(step))
    if forecaster.problems:
        problem = forecaster.problems[0]
        exit_with_error(f"{name_step(int(problem.place[1]))}: {problem.text}", BAD_INPUT, problem.remedy)
    planned_path = None if forecaster.motion is None else forecaster.motion.path
    if planned_path is None:
        reason = "; ".join(forecast.conditions if forecast is not None else ())
        exit_with_error(f"{name_step(last)}: {reason}", BAD_INPUT, "say where they are with --at AXIS=VALUE")
    return planned_path
