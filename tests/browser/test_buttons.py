"""Job files that are offered as buttons."""

import re
from collections.abc import Callable
from typing import Any

import pytest
from browser.conftest import LARGE, SMALL, MockedStream, make_state
from playwright.sync_api import Page, ViewportSize, expect

Mock = Callable[..., MockedStream]

JOB = {"schema": "tutti.job/1", "name": "park", "steps": [{"do": "dwell", "duration": "1 s"}]}
CHECKED = {"problems": [], "parameters": [], "job": JOB, "forecast": None, "preview": None}
WIDTH = {"name": "width", "type": "quantity", "unit": "mm", "default": "20 mm"}


def make_template(file: str, label: str | None, group: str | None = None, **fields: Any) -> dict[str, Any]:
    button = None if label is None else {"label": label, "group": group}
    name = file.removesuffix(".job.yaml")
    return {"name": name, "file": file, "parameters": [], "problem": None, "button": button, **fields}


TEMPLATES = [
    make_template("park.job.yaml", "Park", "Ends"),
    make_template("scan.job.yaml", "Line scan", "Scans", parameters=[WIDTH]),
    make_template("bad.job.yaml", "Broken", "Scans", problem="bad.job.yaml:4: steps[0].to: unknown axis gantry.q"),
    make_template("plain.job.yaml", None),
    make_template("lamp.job.yaml", "Lamp on"),
]


def replies(**more: Any) -> dict[str, Any]:
    return {
        "templates": {"templates": TEMPLATES},
        "check-job": CHECKED,
        "submit": {"refused": None, "job_id": "j1"},
        **more,
    }


@pytest.mark.parametrize("view", ["run", "setup"])
def test_job_files_with_a_button_are_offered_by_group(mock: Mock, page: Page, view: str) -> None:
    mock(view=view, replies=replies())
    panel = page.get_by_role("region", name="Buttons")
    ends, scans = panel.get_by_role("group", name="Ends"), panel.get_by_role("group", name="Scans")
    expect(ends.get_by_role("button")).to_have_text(["Park"])
    expect(scans.get_by_role("button")).to_have_text(["Line scan …", "Broken"])
    expect(panel.get_by_role("button")).to_have_text(["Lamp on", "Park", "Line scan …", "Broken"])


def test_without_buttons_there_is_no_panel(mock: Mock, page: Page) -> None:
    mock(replies=replies(templates={"templates": [make_template("plain.job.yaml", None)]}))
    expect(page.get_by_role("region", name="Running job")).to_be_visible()
    expect(page.get_by_role("region", name="Buttons")).to_have_count(0)


def test_a_button_submits_its_job_by_one_press(mock: Mock, page: Page) -> None:
    stream = mock(view="setup", replies=replies())
    page.get_by_role("button", name="Park", exact=True).click()
    expect(page.get_by_text("Park is in the queue")).to_be_visible()
    assert [path for path, _ in stream.asked] == ["check-job", "submit"]
    (_, checked), (_, submitted) = stream.asked
    assert checked == {"template": "park.job.yaml", "values": {}}
    assert submitted["job"] == JOB and submitted["terms"] == {} and submitted["client_key"]


def test_a_second_press_while_a_job_is_submitted_makes_no_second_job(mock: Mock, page: Page) -> None:
    stream = mock(replies=replies())
    # Two presses within one task of the browser: no answer can come between them.
    button = page.get_by_role("button", name="Park", exact=True)
    button.evaluate("(element) => { element.click(); setTimeout(() => element.click()); }")
    expect(page.get_by_text("Park is in the queue")).to_be_visible()
    assert [path for path, _ in stream.asked].count("submit") == 1


def test_a_button_with_parameters_opens_the_form(mock: Mock, page: Page) -> None:
    stream = mock(replies=replies())
    page.get_by_role("button", name="Line scan …").click()
    expect(page.get_by_role("dialog").get_by_label(re.compile("^width"))).to_be_visible()
    assert not [path for path, _ in stream.asked if path == "submit"]


def test_a_file_that_has_got_parameters_opens_the_form_instead(mock: Mock, page: Page) -> None:
    stream = mock(replies=replies(**{"check-job": {**CHECKED, "parameters": [WIDTH]}}))
    page.get_by_role("button", name="Park", exact=True).click()
    expect(page.get_by_role("dialog").get_by_label(re.compile("^width"))).to_be_visible()
    assert not [path for path, _ in stream.asked if path == "submit"]


def test_a_job_that_does_not_fit_the_machine_is_not_submitted(mock: Mock, page: Page) -> None:
    problem = {"line": 4, "place": "steps[0].to", "text": "9000 is beyond the soft limits of gantry.x"}
    stream = mock(replies=replies(**{"check-job": {**CHECKED, "problems": [problem]}}))
    page.get_by_role("button", name="Park", exact=True).click()
    expect(page.get_by_text("9000 is beyond the soft limits of gantry.x")).to_be_visible()
    expect(page.get_by_text("Mend park.job.yaml on the computer of the fleet.")).to_be_visible()
    assert not [path for path, _ in stream.asked if path == "submit"]


def test_a_file_with_a_mistake_keeps_its_button_and_says_why(mock: Mock, page: Page) -> None:
    stream = mock(replies=replies())
    button = page.get_by_role("button", name="Broken")
    expect(button).to_have_attribute("aria-disabled", "true")
    button.click(force=True)
    expect(page.get_by_text("unknown axis gantry.q").first).to_be_visible()
    assert not stream.asked


def test_a_viewer_may_not_press_and_a_proposer_proposes(mock: Mock, page: Page) -> None:
    mock(replies=replies(), role="viewer", may=["stop", "estop"], users=True, user="vera", csrf="x")
    button = page.get_by_role("button", name="Park", exact=True)
    expect(button).to_have_attribute("aria-description", re.compile("role viewer"))
    mock(replies=replies(), role="proposer", may=["submit", "check-job"], users=True, user="paul", csrf="x")
    button.click()
    expect(page.get_by_text("Park waits for the approval of an operator")).to_be_visible()


def test_a_refusal_of_the_fleet_is_shown(mock: Mock, page: Page) -> None:
    refused = {"code": "queue-full", "text": "10000 jobs wait", "remedy": "cancel some", "controller": None}
    mock(replies=replies(submit={"refused": refused}))
    page.get_by_role("button", name="Park", exact=True).click()
    expect(page.get_by_text("10000 jobs wait")).to_be_visible()


def test_labels_with_markup_are_texts(mock: Mock, page: Page) -> None:
    evil = "<img src=x onerror=alert(1)>"
    mock(replies=replies(templates={"templates": [make_template("a.job.yaml", evil, evil)]}))
    expect(page.get_by_role("button", name=evil)).to_be_visible()
    assert page.locator("img").count() == 0


@pytest.mark.parametrize("size", [SMALL, LARGE])
def test_long_labels_fit_the_screen(mock: Mock, page: Page, size: ViewportSize) -> None:
    page.set_viewport_size(size)
    templates = [make_template(f"{number}.job.yaml", "W" * 40, "G" * 40) for number in range(12)]
    mock(make_state(), replies=replies(templates={"templates": templates}))
    expect(page.get_by_role("region", name="Buttons")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
    if size == LARGE:
        assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")
