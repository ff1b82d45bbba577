"""The order of a job's progress."""

import pytest

from orchestrator.bus.keys import FleetKeys
from orchestrator.model.report import FINISHED_STATES, JobProgress, JobState
from orchestrator.monitor.fleet_view import LiveView


def progress(state: JobState) -> JobProgress:
    return JobProgress(
        job_id="j1",
        name="short",
        actor="a",
        state=state,
        step=0,
        steps=1,
        step_name="move",
        fraction=0.0,
        remaining_s=None,
        reason="",
        utc="2026-01-01T00:00:00.000000Z",
    )


@pytest.mark.parametrize("end", sorted(FINISHED_STATES))
def test_what_an_end_has_overtaken_does_not_count(end: JobState) -> None:
    assert progress(end).follows(progress("planning")) and progress("planning").follows(None)
    assert not progress("planning").follows(progress(end))


def test_a_job_that_has_ended_stays_so_on_a_screen() -> None:
    view = LiveView(FleetKeys("demo"), lambda: 0.0)
    view.store_progress(progress("running"))
    assert view.store_progress(progress("done"))
    assert not view.store_progress(progress("planning"))
    assert view.jobs["j1"].state == "done"
