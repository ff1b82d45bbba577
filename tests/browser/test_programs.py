"""A program in G-code on the page: from its upload over its preview to its rest after an e-stop."""

import re
from pathlib import Path

import pytest
from browser.conftest import SMALL
from browser.test_page import open_page
from browser.test_rules import wait_for
from fleet import EXAMPLES, RunningFleet
from playwright.sync_api import Locator, Page, expect

SLOW = "G21 G90 F600\nG0 X10 Y5\nG1 X40 Y5\nG1 X40 Y25\nG1 X10 Y25 F3000\nG1 X10 Y5\nM5\nM30\n"  # first 10 mm/s


@pytest.fixture(scope="module")
def ready(fleet: RunningFleet) -> RunningFleet:
    fleet.ready()
    return fleet


def upload(page: Page, path: Path) -> Locator:
    page.get_by_role("button", name="New job").click()
    page.get_by_role("dialog").get_by_label("Choose a file").set_input_files(path)
    return page.get_by_role("dialog", name=f"Job {path.name}")


def confirm(dialog: Locator, words: str, press: str) -> None:
    """Tick what is written there, and press."""
    button = dialog.get_by_role("button", name=press)
    expect(button).to_have_attribute("aria-disabled", "true")
    dialog.get_by_role("group", name=words).get_by_role("checkbox").check()
    button.click()


def go_on(panel: Locator, path: Path) -> Locator:
    """Go on with a job, and give its file."""
    panel.get_by_role("button", name=f"Go on with {path.name}").click()
    dialog = panel.page.get_by_role("dialog")
    expect(dialog).to_contain_text(f"was made of the file '{path.name}', which is compared with what ran")
    dialog.get_by_label("Choose a file").set_input_files(path)
    return dialog


def test_what_a_program_needs_is_asked_with_its_line(page: Page, ready: RunningFleet) -> None:
    open_page(page, ready)
    dialog = upload(page, EXAMPLES / "part.ngc")
    problems = dialog.get_by_role("alert", name="Problems")
    expect(problems).to_contain_text("line 5:")
    expect(problems).to_contain_text("column 1")
    dialog.get_by_label("spindle").select_option("none")
    dialog.get_by_label("tools").select_option("none")
    expect(problems).to_have_count(0)
    expect(dialog.get_by_role("group", name="Before it runs")).to_contain_text("M5 and S switch nothing")
    reach = dialog.get_by_role("table", name="Reach of the program")
    expect(reach).to_contain_text("limits -10 … 400")
    drawing = dialog.get_by_role("img", name="Path of X, Y")
    colours = drawing.locator("path").evaluate_all("paths => paths.map(path => getComputedStyle(path).stroke)")
    assert len(set(colours)) == 2
    assert all(drawing.locator("path").evaluate_all("paths => paths.map(path => path.getTotalLength() > 10)"))
    dialog.get_by_label("G54").fill("380, 0")
    expect(reach).to_contain_text("20 mm too far")
    expect(problems).to_contain_text("line 8:")


def stop_and_reset(page: Page, panel: Locator, ready: RunningFleet) -> None:
    """Press the e-stop while a job runs, reset it, and start the queue again."""
    page.get_by_role("button", name="E-stop", exact=True).click()
    expect(panel.get_by_text("aborted").first).to_be_visible()
    page.get_by_role("button", name="Reset").click()
    expect(page.get_by_role("button", name="Reset")).to_have_count(0)
    ready.works()
    page.get_by_role("button", name="Start queue").first.click()


def test_a_program_runs_and_goes_on_where_an_e_stop_has_stopped_it(
    page: Page, ready: RunningFleet, tmp_path: Path
) -> None:
    open_page(page, ready)
    path = tmp_path / "slow.ngc"
    path.write_text(SLOW)
    dialog = upload(page, path)
    dialog.get_by_label("spindle").select_option("none")
    confirm(dialog, "Before it runs", "Submit")
    panel = page.get_by_role("region", name="Running job")
    expect(panel).to_contain_text("lines 2 to 6")
    expect(panel).to_contain_text("line 4: G1 X40 Y25")  # the one that runs
    wait_for(page, lambda: find_position(ready, "y") > 15)
    stop_and_reset(page, panel, ready)
    path.write_text(SLOW.replace("X40", "X41"))
    dialog = go_on(panel, path)
    expect(dialog.get_by_role("alert")).to_contain_text("the text is not that of 'slow.ngc' as it ran")
    dialog.get_by_role("button", name="Close").click()
    path.write_text(SLOW)
    dialog = go_on(panel, path)
    back = dialog.get_by_role("group", name="First to the start of line 4")
    expect(back).to_contain_text("gantry.x to 40 mm, gantry.y to 5 mm")
    page.set_viewport_size(SMALL)
    assert page.evaluate("document.documentElement.scrollWidth") <= SMALL["width"]
    confirm(dialog, "First to the start of line 4", "Move to line 4")
    expect(dialog.get_by_role("group", name="Before it runs")).to_contain_text("line 4 begins with work offset G54")
    dialog.get_by_label("from line").fill("5")  # another line needs another move
    expect(dialog.get_by_role("button", name="Move to line 5")).to_be_visible()
    expect(dialog.get_by_text("confirm what is written above first")).to_be_visible()
    dialog.get_by_label("from line").fill("4")
    confirm(dialog, "Before it runs", "Submit")
    expect(panel).to_contain_text("lines 4 to 6")
    wait_for(page, lambda: find_position(ready, "x") < 10.1)


def test_a_program_starts_at_a_line_of_its_text(page: Page, ready: RunningFleet, tmp_path: Path) -> None:
    open_page(page, ready)
    path = tmp_path / "slow.ngc"
    path.write_text(SLOW)
    dialog = upload(page, path)
    dialog.get_by_label("spindle").select_option("none")
    dialog.get_by_text("Program", exact=True).click()
    text = dialog.get_by_role("textbox", name="Program")
    text.click(position={"x": 20, "y": 4 + 4.5 * text.evaluate("box => (box.clientHeight - 8) / box.rows")})
    dialog.get_by_role("button", name="Start here: line 5").click()
    expect(dialog.get_by_label("from line")).to_have_value("5")
    expect(dialog.get_by_role("group", name="First to the start of line 5")).to_contain_text("gantry.y to 25 mm")


def find_position(fleet: RunningFleet, axis: str) -> float:
    return float(fleet.status()["gantry"].axes[axis].raw_counts) / 1000


BEND = """schema: tutti.job/1
name: bend
steps:
  - {do: move, to: {gantry.x: 0, gantry.y: 0}}
  - do: path
    axes: [gantry.x, gantry.y]
    start: [0, 0]
    tolerance: 100 um
    speed: 8 mm/s
    pieces: [{piece: line, to: [30, 0]}, {piece: line, to: [30, 10]}]
"""


def test_a_path_goes_on_where_an_e_stop_has_stopped_it(page: Page, ready: RunningFleet, tmp_path: Path) -> None:
    open_page(page, ready)
    path = tmp_path / "bend.job.yaml"
    path.write_text(BEND)
    upload(page, path).get_by_role("button", name="Submit").click()
    panel = page.get_by_role("region", name="Running job")
    expect(panel).to_contain_text("step 2 of 2")
    wait_for(page, lambda: 8 < find_position(ready, "x") < 25)
    stop_and_reset(page, panel, ready)
    panel.get_by_role("button", name="Go on with bend").click()
    dialog = page.get_by_role("dialog")
    # The axes brake on their way, or beside it.
    expect(dialog.get_by_role("group", name=re.compile("First back|Before it runs"))).to_be_visible()
    if dialog.get_by_role("group", name="First back: step 2 (path), piece 1 of 2").count():
        confirm(dialog, "First back", "Move back")
    expect(dialog.get_by_role("group", name="Before it runs")).to_contain_text("bend stood at step 2 (path), piece 1")
    confirm(dialog, "Before it runs", "Submit")
    wait_for(page, lambda: find_position(ready, "y") > 9.9)
