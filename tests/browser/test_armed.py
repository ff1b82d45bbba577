"""A live job, and a motion that waits armed, on the page."""

from collections.abc import Callable
from typing import Any

from browser.conftest import MockedStream
from browser.test_rules import wait_for
from playwright.sync_api import Page, expect

Mock = Callable[..., MockedStream]


def make_progress(**fields: Any) -> dict[str, Any]:
    """The progress of a job as the stream has it."""
    return {
        "job_id": "id-r",
        "name": "exposure",
        "actor": "anna",
        "state": "armed",
        "step": 1,
        "steps": 2,
        "step_name": "move",
        "fraction": 0.5,
        "reason": "waits for input gantry.door, or go",
        "utc": "2026-01-01T00:00:00Z",
        **fields,
    }


def test_an_armed_motion_is_started_by_go(mock: Mock, page: Page) -> None:
    stream = mock(replies={"go": {"refused": None, "t0_fleet_ns": 1}})
    job = page.get_by_role("article", name="Job exposure")
    stream.patch({"jobs": {"id-r": make_progress()}})
    expect(job).to_contain_text("armed")
    expect(job).to_contain_text("waits for input gantry.door, or go")
    expect(job.get_by_role("button", name="Go exposure")).to_have_count(0)
    armed = {"since_fleet_ns": 1, "until_fleet_ns": 2, "lead_ns": 60_000_000, "most_lead_ns": 1}
    stream.patch({"jobs": {"id-r": make_progress(armed=armed)}})
    job.get_by_role("button", name="Go exposure").click()
    wait_for(page, lambda: stream.asked)
    assert [(name, body["job_id"]) for name, body in stream.asked] == [("go", "id-r")]


def test_a_live_job_is_shown_as_what_it_is(mock: Mock, page: Page) -> None:
    stream = mock()
    reason = "waits for moves of its program"
    stream.patch({"jobs": {"id-r": make_progress(state="running", steps=1, step_name="live", reason=reason)}})
    job = page.get_by_role("article", name="Job exposure")
    expect(job).to_contain_text("live")
    expect(job).to_contain_text(reason)
    expect(job.get_by_role("button", name="Go exposure")).to_have_count(0)
