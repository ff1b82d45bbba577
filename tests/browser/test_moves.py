"""The move of one axis: to a value or by a step, at a speed that is seen before it moves."""

from typing import Any

import pytest
from browser.conftest import make_axis, make_controller, make_state
from browser.test_rules import Mock, wait_for
from playwright.sync_api import Locator, Page, expect


def open_move(page: Page, axis: str = "gantry.x") -> Locator:
    page.get_by_role("button", name=f"Go: {axis}").click()
    return page.get_by_role("dialog", name=f"Move {axis}")


def test_go_is_one_press_from_the_row_with_the_focus_in_the_field(mock: Mock, page: Page) -> None:
    stream = mock()
    dialog = open_move(page)
    expect(dialog.get_by_label("Position in mm")).to_be_focused()
    expect(dialog).to_contain_text("soft limits -10.000 mm … 400.000 mm")
    expect(dialog).to_contain_text("12.500 mm")
    page.keyboard.type("42,5")
    page.keyboard.press("Enter")
    expect(dialog).to_have_count(0)
    wait_for(page, lambda: stream.find("work"))
    assert stream.find("work")[0]["step"] == {"do": "move", "to": {"gantry.x": 42.5}, "speed": 0.2}


@pytest.mark.parametrize(
    ("text", "speed", "shown"),
    [
        ("5 mm/s", "5 mm/s", "at most 5.000 mm/s"),
        ("2,5mm/s", "2.5 mm/s", "at most 2.500 mm/s"),
        ("300 µm/s", "300 um/s", "at most 300 µm/s"),
        ("50 %", 0.5, "at most 100.000 mm/s"),
        ("0.1", 0.1, "at most 20.000 mm/s"),
    ],
)
def test_the_speed_of_a_move_is_read_as_in_a_job(
    mock: Mock, page: Page, text: str, speed: float | str, shown: str
) -> None:
    stream = mock()
    dialog = open_move(page)
    expect(dialog.get_by_label("Speed")).to_have_value("20 %")
    dialog.get_by_label("Speed").fill(text)
    expect(dialog).to_contain_text(shown)
    dialog.get_by_label("Position in mm").fill("20")
    dialog.get_by_role("button", name="Go to 20.000 mm").click()
    wait_for(page, lambda: stream.find("work"))
    assert stream.find("work")[0]["step"]["speed"] == speed


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "write a speed as 5 mm/s, 50 % or 0.5"),
        ("fast", "write a speed as 5 mm/s, 50 % or 0.5"),
        ("5", "5 without a unit is a part of the limit, above 0 to 1; with one it is a speed: 5 mm/s"),
        ("101 %", "a percentage of the limit is above 0 to 100 %"),
        ("0 mm/s", "a speed is above 0"),
        ("201 mm/s", "the limit of this axis is 200 mm/s; choose a lower speed"),
    ],
)
def test_a_speed_that_is_none_is_named_before_go(mock: Mock, page: Page, text: str, problem: str) -> None:
    stream = mock()
    dialog = open_move(page)
    dialog.get_by_label("Position in mm").fill("20")
    dialog.get_by_label("Speed").fill(text)
    expect(dialog.get_by_text(problem)).to_be_visible()
    expect(dialog.get_by_role("button", name="Go to")).to_have_attribute("aria-disabled", "true")
    dialog.get_by_label("Position in mm").press("Enter")
    expect(dialog).to_be_visible()
    assert not stream.find("work")


def test_a_step_is_chosen_and_each_press_is_one(mock: Mock, page: Page) -> None:
    stream = mock()
    dialog = open_move(page)
    dialog.get_by_label("Step of gantry.x").select_option("0.1")
    dialog.get_by_role("button", name="Step gantry.x by −0.1 mm").click()
    wait_for(page, lambda: stream.find("work"))
    assert stream.find("work")[0]["step"] == {"do": "move", "by": {"gantry.x": -0.1}, "speed": 0.2}
    plus = dialog.get_by_role("button", name="Step gantry.x by +0.1 mm")
    expect(plus).to_have_attribute("aria-disabled", "true")  # while the first is under way
    stream.send({"work": {"id": stream.find("work")[0]["id"], "state": "done"}})
    plus.click()
    wait_for(page, lambda: len(stream.find("work")) == 2)
    page.keyboard.press("Escape")
    open_move(page, "gantry.y")  # the step is remembered
    expect(page.get_by_role("button", name="Step gantry.y by +0.1 mm")).to_be_visible()


def test_a_step_beyond_a_soft_limit_is_named(mock: Mock, page: Page) -> None:
    mock(make_state(controllers={"gantry": make_controller({"x": make_axis(position=399.5)})}))
    plus = open_move(page).get_by_role("button", name="Step gantry.x by +1 mm")
    expect(plus).to_have_attribute("aria-disabled", "true")
    assert "beyond the soft limit 400.000 mm" in str(plus.get_attribute("title"))


@pytest.mark.parametrize("fields", [{"manual_speed": 0.05}, {"manual_speed": 0.333333333}])
def test_the_speed_begins_at_that_of_the_axis(mock: Mock, page: Page, fields: dict[str, Any]) -> None:
    mock(make_state(controllers={"gantry": make_controller({"x": make_axis(**fields)})}))
    expect(open_move(page).get_by_label("Speed")).to_have_value({0.05: "5 %"}.get(fields["manual_speed"], "33.3333 %"))


def test_a_named_position_is_gone_to_at_the_speed_of_each_axis_for_single_moves(mock: Mock, page: Page) -> None:
    near = {"name": "near", "axes": {"gantry.x": 40}, "source": "file", "problems": []}
    stream = mock(view="setup", replies={"positions": {"positions": [near]}})
    page.get_by_role("button", name="Go to near").click()
    wait_for(page, lambda: stream.find("work"))
    assert stream.find("work")[0]["step"] == {"do": "move", "to": "near", "speed": "manual"}


def test_space_presses_no_button_of_the_move(mock: Mock, page: Page) -> None:
    stream = mock()
    dialog = open_move(page)
    dialog.get_by_label("Position in mm").fill("20")
    for name in ("Go to 20.000 mm", "Step gantry.x by +1 mm"):
        dialog.get_by_role("button", name=name).focus()
        page.keyboard.press("Space")
    page.wait_for_timeout(100)
    assert not stream.find("work")
