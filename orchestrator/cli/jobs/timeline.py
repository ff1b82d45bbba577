"""`tutti job timeline`: the stages of the motion steps of a job."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.jobs import job_argument, load_report
from orchestrator.cli.base.pictures import picture_option, write_picture
from orchestrator.cli.base.steps import StepType
from orchestrator.model.steps.numbers import name_step, number_step

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.report import JobReport
    from orchestrator.monitor.timeline.stages import JobTimeline


@click.command(epilog="Examples: tutti job timeline last; tutti job timeline 3f2a91c0 --step 2 -o start.svg")
@job_argument
@click.option("--step", type=StepType(), default=None, help="This motion step only, from 1.")
@picture_option("Write a picture of each step, the step number before the suffix if there are several.")
@fleet_options
@json_option
def timeline(job: str, step: int | None, out: Path | None, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Show when each stage of the motion steps of JOB began and how long it took: plan, arm, commit, decide, go, fire,
    run; each member's arming; starts and ends of axes as intervals. Times are relative to T0.

    All is from the report of a finished job. The fields of --json count steps from 0.
    """
    from orchestrator.monitor.timeline.stages import make_timeline
    from orchestrator.monitor.timeline.table import make_timeline_tables

    async def show_timeline(tutti: "Tutti") -> None:
        report = await load_report(tutti, job)
        found_step = _select_step(make_timeline(report), report, step)
        if out is not None:
            files = _write_pictures(found_step, out)
            words = "\n".join(f"{name_step(int(index))}: {path}" for index, path in files.items())
            print_result(files, words, as_json=as_json)
        elif as_json:
            print_json(found_step.to_plain())
        else:
            console.print(make_timeline_tables(found_step), highlight=False)

    with_fleet(connect, fleet, show_timeline)


def _select_step(timeline: "JobTimeline", report: "JobReport", step: int | None) -> "JobTimeline":
    indices = [step.step for step in timeline.steps]
    if step is None and indices:
        return timeline
    if step in indices:
        return timeline.model_copy(
            update={"steps": [step_line for step_line in timeline.steps if step_line.step == step]}
        )
    step_words = "step" if step is None else name_step(step)
    text = f"job {report.name!r} {report.job_id} has no motion {step_words} that was armed"
    number_list = (
        f"it has: {', '.join(str(number_step(index)) for index in indices[:12])}"
        if indices
        else "see `tutti job report`"
    )
    exit_with_error(text, FAILED if step is None else BAD_INPUT, number_list)


def _write_pictures(timeline: "JobTimeline", out: Path) -> dict[str, str]:
    from orchestrator.monitor.timeline.picture import draw_step

    files: dict[str, str] = {}
    for step in timeline.steps:
        path = out if len(timeline.steps) == 1 else out.with_stem(f"{out.stem}-{number_step(step.step)}")
        title = f"job {timeline.job_id} {timeline.name!r}, {name_step(step.step)} {step.name}".rstrip()
        write_picture(draw_step(step, title), path)
        files[str(step.step)] = str(path)
    return files
