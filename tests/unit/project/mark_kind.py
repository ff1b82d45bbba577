"""Uses the sample kind of step in a copy of the tree that has it; see `test_step_kind.py`."""

import sys
from io import StringIO
from pathlib import Path

from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet
from rich.console import Console

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.jobs.files import FileError
from orchestrator.model.report import JobReport
from orchestrator.monitor.export.moves import make_moves_table
from orchestrator.monitor.report_table import make_report_tables
from orchestrator.plan.forecast.job import forecast_job
from orchestrator.runtime.virtual.fleet import VirtualFleet
from tutti import Mark
from tutti import __file__ as tutti_file

MARKED = job(
    "[{do: move, to: {gantry.x: 60}}, {do: mark, label: between}, {do: move, to: {gantry.x: 90}}, "
    "{do: mark, label: then, name: last}, {do: dwell, duration: 5 s}]"
)


def check_ahead() -> None:
    """It is read from a file, refused with its place, described, and run forward."""
    mark = MARKED.steps[1]
    assert isinstance(mark, Mark)
    assert mark.describe() == "mark label=between"
    forecast = forecast_job(demo_fleet(), [mark])
    assert not forecast.problems
    assert forecast.steps[0].conditions == ["the instant of 'between' is recorded"]
    try:
        job("[{do: mark}]")
    except FileError as error:
        assert "label" in str(error)
    else:
        raise AssertionError("a mark without a label was accepted")


def check_report(report: JobReport) -> None:
    """It is in the report, between two moves that follow each other without a stop of the service, and shown."""
    assert report.state == "done", report.reason
    marks = [step for step in report.steps if step.do == "mark"]
    assert [step.mark.label for step in marks if step.mark is not None] == ["between", "then"]
    after = report.steps[2]
    assert after.chain is not None and after.chain.kept, after.chain
    assert JobReport.read_message(report.to_json()) == report
    console = Console(width=200, record=True, file=StringIO())
    console.print(make_report_tables(report, detailed=True))
    assert "last" in console.export_text()
    assert make_moves_table(report).row_count == 2


async def check_orders(fleet: VirtualFleet) -> None:
    """A job is paused before it, run on, cancelled behind it, and run again from it."""
    client = fleet.make_client()
    submitted = await client.submit(MARKED)
    await sleep_ns(fleet.clock, NS_PER_S // 2)
    await submitted.pause()
    await sleep_ns(fleet.clock, 5 * NS_PER_S)
    shown = await client.show_job(submitted)
    assert shown.progress is not None and shown.progress.reason.endswith("after step 3"), shown.progress
    await submitted.resume()
    report = await submitted.result()
    assert report.state == "done" and report.steps[1].mark is not None
    retried = await client.retry_job(submitted, 3)
    await sleep_ns(fleet.clock, 2 * NS_PER_S)
    assert retried.job_id is not None
    await client.cancel_job(retried.job_id)
    ended = await client.wait_for_job(retried.job_id)
    assert ended.state == "cancelled"
    assert [step.do for step in ended.steps] == ["mark"]


async def main(fleet: VirtualFleet) -> None:
    """All of it."""
    await outcome(fleet, PREPARE)
    check_report(await outcome(fleet, MARKED))
    await check_orders(fleet)


if __name__ == "__main__":
    assert Path(tutti_file).is_relative_to(sys.argv[1]), "the tree under test is not the one that is imported"
    check_ahead()
    run_fleet(main)
