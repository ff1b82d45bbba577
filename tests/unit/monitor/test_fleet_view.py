"""The display of the running jobs on a screen."""

from io import StringIO

from rich.console import Console

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.report import JobProgress, JobState
from orchestrator.monitor.fleet_view import MAX_JOBS_SHOWN, LiveView


def progress(job_id: str, state: JobState, step: int = 0) -> BusSample:
    said = JobProgress(
        job_id=job_id,
        name="scan",
        actor="anna",
        state=state,
        step=step,
        steps=3,
        step_name="move",
        fraction=step / 3,
        remaining_s=None,
        reason="",
        utc="2026-01-01T00:00:00Z",
    )
    return BusSample(f"tutti/v1/lab/job/{job_id}/state", said.to_json())


def screen(view: LiveView) -> str:
    console = Console(width=100, record=True, file=StringIO())
    console.print(view.render_screen())
    return console.export_text()


def test_all_running_jobs_are_shown_and_the_newest_ended_ones() -> None:
    view = LiveView(FleetKeys("lab"), lambda: 0.0)
    assert view.take_sample(progress("aaaa", "running"))
    assert view.take_sample(progress("bbbb", "running"))
    assert view.take_sample(progress("aaaa", "running")) is None
    assert view.take_sample(progress("aaaa", "running", 1))
    assert "aaaa" in screen(view) and "bbbb" in screen(view)
    for job_id in ("cccc", "dddd"):
        view.take_sample(progress(job_id, "done", 2))
    assert "cccc" not in screen(view) and "dddd" in screen(view)
    view.take_sample(progress("aaaa", "running", 2))
    assert "dddd" in screen(view)


def test_a_long_queue_is_cut_after_the_running_jobs() -> None:
    view = LiveView(FleetKeys("lab"), lambda: 0.0)
    for number in range(MAX_JOBS_SHOWN + 3):
        view.take_sample(progress(f"q{number:03}", "queued"))
    view.take_sample(progress("zzzz", "running"))
    shown = screen(view)
    assert "zzzz" in shown and "and 4 more jobs" in shown


def test_a_step_has_the_number_that_step_takes() -> None:
    view = LiveView(FleetKeys("lab"), lambda: 0.0)
    line = view.take_sample(progress("aaaa", "running", 1))
    assert line is not None and "step 2 of 3 move" in line
    assert "step 2 of 3 move" in screen(view)
