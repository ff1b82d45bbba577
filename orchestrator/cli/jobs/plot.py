"""`tutti job plot`: what the axes of a job did."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.common import fleet_options, json_option, print_result, with_fleet
from orchestrator.cli.base.errors import errors, exit_with_error
from orchestrator.cli.base.jobs import job_argument, name_jobs
from orchestrator.cli.base.pictures import picture_option, write_picture
from orchestrator.cli.base.steps import StepType
from orchestrator.model.steps.numbers import name_step, number_step

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from orchestrator.client import Tutti
    from orchestrator.model.jobs.service import JobShown
    from orchestrator.model.report import PointRecord, QueueEntry, StepRecording

MAX_PLOTTED_STEPS = 200  # of a job
MAX_PLOTTED_POINTS = 100_000  # of a scan
WHOLE_JOB = "job"  # beside the indices of steps


@click.command(epilog="Examples: tutti job plot last; tutti job plot 3f2a91c0 --step 2 -o move.svg")
@job_argument
@click.option("--step", type=StepType(), default=None, help="One motion step, or one scan, only; from 1.")
@picture_option("Output file; default: JOB_ID.png, with the step number before the suffix for a part of the job.")
@fleet_options
@json_option
def plot(job: str, step: int | None, out: Path | None, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Plot the motion steps of JOB in one picture: planned and polled positions, their difference, starts and ends as
    intervals. A scan gets a picture of its own, of planned and measured points.

    Recordings are kept for the newest jobs only. With --out and several pictures, the number of its first step is
    inserted before the suffix for a scan. The fields of --json count steps from 0.
    """

    async def plot_job(tutti: "Tutti") -> None:
        shown_job = await tutti.show_job((await tutti.find_job(job)).id)
        assert shown_job.entry is not None
        figures = await _draw_figures(tutti, shown_job, shown_job.entry, step)
        if not figures:
            text = f"{name_jobs(shown_job.entry)} has no recording" + ("" if step is None else f" of {name_step(step)}")
            exit_with_error(text, FAILED, "recordings are kept for the newest jobs only")
        files: dict[str, str] = {}
        for part, figure in figures.items():
            path = out or Path(f"{shown_job.entry.id}.png")
            if part != WHOLE_JOB and (out is None or len(figures) > 1):
                path = path.with_stem(f"{path.stem}-{_name_part(part)}")
            write_picture(figure, path)
            files[part] = str(path)
        words = "\n".join(
            f"{'' if part == WHOLE_JOB else 'step '}{_name_part(part)}: {path}" for part, path in files.items()
        )
        print_result(files, words, as_json=as_json)

    with_fleet(connect, fleet, plot_job)


async def _draw_figures(
    tutti: "Tutti", shown: "JobShown", entry: "QueueEntry", step: int | None
) -> "dict[str, Figure]":
    """The pictures by what they show: the index of a step or scan, or the whole job."""
    from orchestrator.monitor.job_plot import plot_recordings
    from orchestrator.monitor.scan_points import plot_points

    title = f"job {entry.id} {entry.name!r}"
    scans = await _load_scans(tutti, entry, step)
    # The first step of a scan is its first point too; the scan is meant.
    wanted_steps = [number for number in ([step] if step is not None else _list_moves(shown)) if number not in scans]
    recordings = await _load_recordings(tutti, entry.id, wanted_steps)
    figures: dict[str, Figure] = {}
    if recordings:
        part = WHOLE_JOB if step is None else str(step)
        words = title if step is None else f"{title}, {name_step(step)} {recordings[0].name}".rstrip()
        figures[part] = plot_recordings(recordings, words, steps=shown.report.steps if shown.report else ())
    for number, records in scans.items():
        figures[str(number)] = plot_points(records, f"{title}, {name_step(number)}: {len(records)} points")
    return figures


def _name_part(part: str) -> str:
    """What a picture shows, in words and names of files; the keys of --json have the index of a step."""
    return part if part == WHOLE_JOB else str(number_step(int(part)))


async def _load_recordings(tutti: "Tutti", job_id: str, steps: list[int]) -> "list[StepRecording]":
    recordings = [await tutti.load_recording(job_id, index) for index in steps[:MAX_PLOTTED_STEPS]]
    if len(steps) > MAX_PLOTTED_STEPS:
        text = f"the first {MAX_PLOTTED_STEPS} of {len(steps)} motion steps are plotted; others with --step"
        errors.print(text, highlight=False, soft_wrap=True)
    return [recording for recording in recordings if recording is not None]


async def _load_scans(tutti: "Tutti", entry: "QueueEntry", step: int | None) -> "dict[int, list[PointRecord]]":
    """The points of each scan of a job, by its first step."""
    scans: dict[int, list[PointRecord]] = {}
    async for point in tutti.iterate_points(entry.id, step):
        known_records = scans.setdefault(point.step, [])
        if len(known_records) < MAX_PLOTTED_POINTS:
            known_records.append(point)
    return scans


def _list_moves(shown: "JobShown") -> list[int]:
    """The numbers of the steps of a job that may have a recording, but for the points of scans."""
    from orchestrator.model.queue import MAX_STEPS
    from orchestrator.model.steps.kinds import MOTION_STEPS
    from orchestrator.model.steps.order import StepOrder

    if shown.report is not None:
        return [step.index for step in shown.report.steps if step.do in MOTION_STEPS]
    if shown.job is None or shown.entry is None:
        return []
    order = StepOrder(shown.job.steps, shown.entry.terms.repeat)
    return [index for index in range(min(len(order), MAX_STEPS)) if order.locate(index).point is None]
