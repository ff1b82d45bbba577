"""What a job did, as plots and points: few presses away, and from T0 on."""

from typing import Any

import pytest
from browser.conftest import LARGE, SMALL, MockedStream
from browser.test_rules import Mock
from browser.test_starts import make_refusal, make_report, make_step
from playwright.sync_api import Page, ViewportSize, expect


def make_curves(*times: float) -> dict[str, Any]:
    curve = {"t": list(times), "v": [10.0 * at for at in times]}
    return {"unit": "mm", "planned": {"t": [0.0, times[-1]], "v": [0.0, 5.0]}, "actual": curve}


def make_job_curves(steps: int, left_out: int = 0) -> dict[str, Any]:
    return {
        "t0_fleet_ns": 5,
        "steps": [
            {"index": n, "name": "out", "text": f"step {n + 1}", "t0": float(n), "t1": n + 0.5} for n in range(steps)
        ],
        "axes": {"gantry.x": make_curves(-0.4, 0.1, 4.5), "gantry.y": make_curves(-0.2, 2.5)},
        "left_out": left_out,
    }


def make_scan(points: int) -> dict[str, Any]:
    verdicts = {"green": points - 1, "amber": 1}
    return make_step("done") | {
        "do": "scan",
        "index": 2,
        "scan": {"points": points, "done": points} | {"verdicts": verdicts},
    }


def make_point(number: int, **fields: Any) -> dict[str, Any]:
    return {
        "step": 2,
        "point": number,
        "state": "done",
        "verdict": "green",
        "target": {"gantry.x": float(number)},
        "measured": {"gantry.x": number + 0.002},
        "start_skew": {"at_least_ns": 0, "at_most_ns": 5000},
        **fields,
    }


def open_old(mock: Mock, page: Page, *steps: dict[str, Any], view: str = "run", **replies: Any) -> MockedStream:
    """The page after the job `old` has ended. replies: by what is read of that job."""
    reports = make_report("done", *steps)
    more = {f"jobs/id-old/{name}": reply for name, reply in replies.items()}
    return mock(view=view, replies={"jobs/id-old": reports, "jobs": {"jobs": [reports["entry"]]}, **more})


@pytest.mark.parametrize("size", [LARGE, SMALL])
def test_the_plot_of_the_last_run_is_at_most_two_presses_from_the_run_view(
    mock: Mock, page: Page, size: ViewportSize
) -> None:
    page.set_viewport_size(size)
    open_old(mock, page, make_step("done"), plot=make_job_curves(3))
    presses = ["Plot of old"]
    for name in presses:
        page.get_by_role("button", name=name).click()
    plot = page.get_by_role("img", name="Planned and actual positions of gantry.x, gantry.y, steps 1 to 3")
    expect(plot).to_be_in_viewport()
    assert len(presses) <= 2
    expect(plot).to_have_attribute("data-range", "0 4.5")
    page.get_by_text("3 steps with their times").click()
    expect(page.get_by_role("row", name="step 2: out 1.000 s … 1.500 s")).to_be_visible()


def test_the_plot_of_a_running_job_is_one_press_away(mock: Mock, page: Page) -> None:
    job = {
        **{"job_id": "id-r", "name": "raster", "actor": "a", "state": "running", "step": 0, "steps": 3},
        **{"step_name": "out", "fraction": 0.2, "reason": "", "utc": "2026"},
    }
    stream = mock(replies={"jobs/id-r/plot": make_job_curves(2, left_out=7)})
    stream.patch({"jobs": {"id-r": job}})
    page.get_by_role("button", name="Plot of raster").click()
    expect(page.get_by_role("dialog")).to_contain_text("Left out: the 7 steps before.")


def test_a_job_without_a_recording_says_so(mock: Mock, page: Page) -> None:
    open_old(mock, page, make_step("done"), plot=make_refusal("no-file", "it has no recording", "they are deleted"))
    page.get_by_role("button", name="Plot of old").click()
    expect(page.get_by_role("dialog")).to_contain_text("it has no recording; they are deleted")


def test_planned_against_actual_of_a_step_begins_at_t0(mock: Mock, page: Page) -> None:
    recording = {"t0_fleet_ns": 5, "axes": {"gantry.x": make_curves(-3.0, -0.1, 0.1, 0.8)}}
    open_old(mock, page, make_step("done"), view="service", **{"recording/0": recording})
    page.get_by_role("button", name="old", exact=True).click()
    page.get_by_role("button", name="Planned against actual").click()
    plot = page.get_by_role("img", name="Planned and actual position of gantry.x")
    expect(plot).to_have_attribute("data-range", "0 0.8")


def test_a_scan_has_its_plot_and_its_points_by_pages(mock: Mock, page: Page) -> None:
    points = [make_point(number) for number in range(1, 61)]
    points[1] = make_point(2, verdict="amber", measured={"gantry.x": None})
    points[2] = make_point(3, state="skipped", verdict="none", start_skew=None)
    points.append(make_point(1, step=70))  # of the next scan of this job
    open_old(mock, page, make_step("done"), make_scan(60), view="service", points={"points": points})
    page.get_by_role("button", name="old", exact=True).click()
    page.get_by_role("button", name="Points of step 3").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_role("img", name="Deviation of gantry.x over the points")).to_be_visible()
    rows = dialog.get_by_role("table").last.get_by_role("row")
    expect(rows).to_have_count(1 + 25)
    expect(rows.nth(1)).to_contain_text("1gantry.x 1.000 mmgantry.x 0.002 mm✓ green≤ 5.0 µs")
    expect(rows.nth(2)).to_contain_text("gantry.x –◆ amber")
    expect(rows.nth(3)).to_contain_text("skipped")
    expect(dialog).to_contain_text("points 1 to 25 of 60")
    expect(dialog.get_by_role("button", name="Earlier points")).to_have_attribute("aria-disabled", "true")
    for _ in range(2):
        dialog.get_by_role("button", name="Later points").click()
    expect(dialog).to_contain_text("points 51 to 60 of 60")
    expect(dialog.get_by_role("button", name="Later points")).to_have_attribute("aria-disabled", "true")
    dialog.get_by_role("button", name="Earlier points").click()
    expect(dialog).to_contain_text("points 26 to 50 of 60")


def test_points_of_a_job_that_was_not_done_are_not_green(mock: Mock, page: Page) -> None:
    reports = make_report("aborted", make_scan(3))
    replies = {"jobs/id-old": reports, "jobs": {"jobs": [reports["entry"]]}}
    mock(view="service", replies={**replies, "jobs/id-old/points": {"points": [make_point(1)]}})
    page.get_by_role("button", name="old", exact=True).click()
    page.get_by_role("button", name="Points of step 3").click()
    expect(page.get_by_role("dialog")).to_contain_text("within the budget")
    expect(page.get_by_text("✓")).to_have_count(0)
