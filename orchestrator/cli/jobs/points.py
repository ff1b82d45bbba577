"""`tutti job points`: what was recorded at the points of scans; the progress of sending points; their plot."""

import json
from collections.abc import AsyncGenerator, Generator
from contextlib import aclosing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.common import console, fleet_options, json_option, print_result, with_fleet
from orchestrator.cli.base.csv_options import csv_style_options
from orchestrator.cli.base.errors import errors
from orchestrator.cli.base.jobs import job_argument, name_jobs
from orchestrator.cli.base.steps import StepType
from orchestrator.cli.jobs.point_files import open_csv, open_hdf5, write_points
from orchestrator.monitor.export.csv_table import CsvStyle

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.client.points import OnPoints, PointProgress
    from orchestrator.model.report import PointRecord, QueueEntry

    PointBatches = AsyncGenerator[list[PointRecord]]

DEFAULT_LIMIT = 50


@click.command(
    epilog="""\b
Examples:
  tutti job points raster --csv raster.csv
  tutti job points last --follow
  tutti job points last --hdf5 raster.h5 --follow"""
)
@job_argument
@click.option("--step", type=StepType(), default=None, help="Only the scan at this step, from 1.")
@click.option("--follow", is_flag=True, help="Continue with new points until the job ends, or Ctrl-C.")
@click.option("--csv", "csv_path", type=click.Path(path_type=Path), default=None, help="Write all points to this file.")
@click.option(
    "--hdf5",
    "hdf5_path",
    type=click.Path(path_type=Path),
    default=None,
    help="Write all points to this HDF5 file, which others can read while it grows (SWMR).",
)
@click.option("--force", is_flag=True, help="Replace an HDF5 file that is there.")
@click.option("--limit", type=click.IntRange(1), help=f"Number of points in the table.  [default: {DEFAULT_LIMIT}]")
@csv_style_options
@fleet_options
@json_option
def points(
    job: str,
    step: int | None,
    csv_path: Path | None,
    hdf5_path: Path | None,
    limit: int | None,
    connect: str,
    fleet: str | None,
    *,
    follow: bool,
    force: bool,
    csv_style: CsvStyle,
    as_json: bool,
) -> None:
    """Show what was recorded at the points of the scans of JOB: targets, measured positions, verdicts.

    While it runs, the points so far; with --follow also the others, as soon as they are final. --json, --csv and --hdf5
    give all points, and count steps from 0; --json with --follow prints one object a line.
    """
    _check_options(csv_path, hdf5_path, limit, follow=follow, force=force)

    async def show_points_of_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        batches = (tutti.follow_point_batches if follow else tutti.iterate_point_batches)(entry.id, step)
        if csv_path is not None or hdf5_path is not None:
            if csv_path is not None:
                file = await open_csv(tutti, entry, csv_path, csv_style)
            else:
                assert hdf5_path is not None
                file = await open_hdf5(tutti, entry, hdf5_path, step, force=force)
            await write_points(batches, file, is_followed=follow)
            result = {"points": file.count, "file": str(file.path)}
            print_result(result, f"{file.count} points: {file.path}", as_json=as_json)
        elif as_json:
            await (_print_json_lines if follow else _print_json)(batches)
        elif follow:
            await _print_lines(batches, entry)
        else:
            await _print_table(batches, entry, limit or DEFAULT_LIMIT)

    with_fleet(connect, fleet, show_points_of_job)


def _check_options(
    csv_path: Path | None, hdf5_path: Path | None, limit: int | None, *, follow: bool, force: bool
) -> None:
    """Raise `click.UsageError` for options that do not go together."""
    if csv_path is not None and hdf5_path is not None:
        raise click.UsageError("--csv and --hdf5 cannot be given together: call the command twice")
    if force and hdf5_path is None:
        raise click.UsageError("--force is for --hdf5; --csv replaces a file that is there")
    if limit is not None and follow:
        raise click.UsageError("--limit cannot be given with --follow, which shows all points")


async def _print_json(batches: "PointBatches") -> None:
    """One array, written as it comes: a scan may have millions of points."""
    separator = "["
    async for points in batches:
        for point in points:
            click.echo(f"{separator}\n{json.dumps(point.to_plain())}", nl=False)
            separator = ","
    click.echo("[]" if separator == "[" else "\n]")


async def _print_json_lines(batches: "PointBatches") -> None:
    async with aclosing(batches):
        async for points in batches:
            click.echo("\n".join(json.dumps(point.to_plain()) for point in points))


async def _print_lines(batches: "PointBatches", entry: "QueueEntry") -> None:
    from orchestrator.monitor.point_table import PointLines

    table, count = PointLines(), 0
    async with aclosing(batches):
        async for points in batches:
            count += len(points)
            lines = [line for point in points for line in table.make_lines(point)]
            console.print("\n".join(lines), highlight=False, markup=False, soft_wrap=True)
    if not count:
        _say_no_points(entry)


async def _print_table(batches: "PointBatches", entry: "QueueEntry", limit: int) -> None:
    from orchestrator.monitor.point_table import make_point_table

    shown_points: list[PointRecord] = []
    async with aclosing(batches):
        async for points in batches:
            shown_points += points
            if len(shown_points) > limit:
                break
    if not shown_points:
        _say_no_points(entry)
        return
    console.print(make_point_table(shown_points[:limit]))
    if len(shown_points) > limit:
        console.print("more with --limit; all with --csv FILE, --hdf5 FILE or --json", highlight=False)


def _say_no_points(entry: "QueueEntry") -> None:
    console.print(f"{name_jobs(entry)} has no recorded points", highlight=False, markup=False)


@contextmanager
def show_points(*, hidden: bool) -> "Generator[OnPoints]":
    """Show on a terminal how many points of a file were read, and sent."""
    if hidden or not errors.is_terminal:
        yield lambda _: None
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TextColumn("points"))
    with Progress(*columns, console=errors, transient=True) as progress:
        tasks = {"reading": progress.add_task("reading", total=None, visible=False)}
        tasks["sending"] = progress.add_task("sending", total=None, visible=False)

        def take_progress(now: "PointProgress") -> None:
            progress.update(tasks[now.doing], completed=now.points, total=now.total, visible=True)

        yield take_progress
