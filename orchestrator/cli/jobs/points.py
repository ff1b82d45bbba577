"""`tutti job points`: what was recorded at the points of scans; the progress of sending points; their plot."""

import json
from collections.abc import AsyncIterator, Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, fleet_options, json_option, print_result, with_fleet
from orchestrator.cli.base.csv_options import csv_style_options
from orchestrator.cli.base.errors import errors, exit_with_error
from orchestrator.cli.base.jobs import job_argument, name_jobs
from orchestrator.cli.base.steps import StepType
from orchestrator.model.steps.numbers import name_step
from orchestrator.monitor.export.csv_table import CsvStyle, CsvTable

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.client.points import OnPoints, PointProgress
    from orchestrator.model.report import PointRecord, QueueEntry


_WINDOW_COLUMNS = [
    "good",
    *(f"window_{part}_{bound}_ns" for part in ("lower", "middle", "upper") for bound in ("earliest", "latest")),
]


@click.command(epilog="Example: tutti job points raster --csv raster.csv")
@job_argument
@click.option("--step", type=StepType(), default=None, help="Only the scan at this step, from 1.")
@click.option("--csv", "out", type=click.Path(path_type=Path), default=None, help="Write all points to this file.")
@click.option("--limit", default=50, show_default=True, type=click.IntRange(1), help="Number of points in the table.")
@csv_style_options
@fleet_options
@json_option
def points(
    job: str,
    step: int | None,
    out: Path | None,
    limit: int,
    connect: str,
    fleet: str | None,
    *,
    csv_style: CsvStyle,
    as_json: bool,
) -> None:
    """Show what was recorded at the points of the scans of JOB: targets, measured positions, verdicts.

    While it runs, the points so far; they are written once a second. --json and --csv give all points, and count steps
    from 0.
    """

    async def show_points_of_job(tutti: "Tutti") -> None:
        entry = await tutti.find_job(job)
        records = tutti.iterate_points(entry.id, step)
        if out is not None:
            number = await _write_csv(records, out, csv_style, await _find_live_axes(tutti, entry.id))
            print_result({"points": number, "file": str(out)}, f"{number} points: {out}", as_json=as_json)
        elif as_json:
            await _print_json(records)
        else:
            await _print_table(records, entry, limit)

    with_fleet(connect, fleet, show_points_of_job)


async def _find_live_axes(tutti: "Tutti", job_id: str) -> list[str]:
    """The axes of a live job, which may move others from point to point; none of any other job."""
    from orchestrator.model.steps.tree import as_live

    shown_job = (await tutti.show_job(job_id)).job
    live = None if shown_job is None else as_live(shown_job.steps[0])
    if live is None:
        return []
    names = await tutti.list_names()
    return list(dict.fromkeys(axis for name in live.axes for axis in names.expand_name(name)))


async def _print_json(records: "AsyncIterator[PointRecord]") -> None:
    """One array, written as it comes: a scan may have millions of points."""
    separator = "["
    async for record in records:
        click.echo(f"{separator}\n{json.dumps(record.to_plain())}", nl=False)
        separator = ","
    click.echo("[]" if separator == "[" else "\n]")


async def _print_table(records: "AsyncIterator[PointRecord]", entry: "QueueEntry", limit: int) -> None:
    from orchestrator.monitor.scan_points import make_point_table

    shown_records: list[PointRecord] = []
    more = False
    async for record in records:
        if len(shown_records) == limit:
            more = True
            break
        shown_records.append(record)
    if not shown_records:
        console.print(f"{name_jobs(entry)} has no recorded points", highlight=False, markup=False)
        return
    console.print(make_point_table(shown_records))
    if more:
        console.print("more with --limit; all with --csv FILE or --json", highlight=False)


def _list_window(record: "PointRecord") -> "Sequence[int | None]":
    """The values of a point for the columns of windows; empty of a point at which the axes stop."""
    window = record.window
    if window is None:
        return [record.good] + [None] * 6
    ends = (window.lower, window.middle, window.upper)
    return [record.good, *(value for end in ends for value in (end.earliest_ns, end.latest_ns))]


async def _write_csv(records: "AsyncIterator[PointRecord]", path: Path, style: CsvStyle, live_axes: list[str]) -> int:
    """Write a row a point; return how many. live_axes: of a live job; none: those of the first point are those of
    all."""
    number, axes = 0, live_axes
    try:
        with path.open("w", encoding="utf-8", newline="") as file:
            table = CsvTable(file, style)
            async for record in records:
                if not number:
                    axes = live_axes or list(record.target)
                    names = [*(f"{axis} target" for axis in axes), *(f"{axis} measured" for axis in axes)]
                    skews = ["start_skew_least_ns", "start_skew_most_ns"]
                    head = ["step", "point", *names, "state", "verdict", *skews, "t0_fleet_ns", "took_s"]
                    table.write_row([*head, *_WINDOW_COLUMNS])
                if not live_axes and list(record.target) != axes:
                    text = f"the scan at {name_step(record.step)} has other axes than the one before"
                    exit_with_error(text, BAD_INPUT, "choose one scan: --step")
                skew = record.start_skew
                table.write_row(
                    [
                        record.step,
                        record.point,
                        *(record.target.get(axis) for axis in axes),
                        *(record.measured.get(axis) for axis in axes),
                        record.state,
                        record.verdict,
                        *((None, None) if skew is None else (skew.at_least_ns, skew.at_most_ns)),
                        record.t0_fleet_ns,
                        record.took_s,
                        *_list_window(record),
                    ]
                )
                number += 1
    except OSError as error:
        exit_with_error(f"{path} cannot be written: {error.strerror}", FAILED)
    return number


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
