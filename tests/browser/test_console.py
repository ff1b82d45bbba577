"""The console of maintainers: a command in a controller's own language, with the trace of its link."""

import re
from collections.abc import Callable
from typing import Any

import pytest
from browser.conftest import MAY, MockedStream, make_axis, make_controller, make_state
from browser.test_rules import wait_for
from playwright.sync_api import Locator, Page, expect

Mock = Callable[..., MockedStream]

RAW = "controllers/gantry/raw"
REFUSED = {"code": "leased", "text": "gantry is in use by paul (job 'raster')", "remedy": "wait for its end"}
TRACE = {
    "frames": [
        {"at_s": -0.5, "direction": "out", "text": "MG TIME", "meaning": "read the clock"},
        {"at_s": -0.4, "direction": "in", "text": "1234567.0", "meaning": ""},
    ],
    "newest": 2,
    "lost": 0,
}


@pytest.fixture
def open_console(mock: Mock, page: Page) -> Callable[..., MockedStream]:
    def open_mock(reply: Any, **replies: Any) -> MockedStream:
        rights = {"role": "maintainer", "may": [*MAY, "raw"], "users": True, "user": "mia", "csrf": "x"}
        controllers = {name: make_controller({"x": make_axis()}) for name in ("gantry", "stage")}
        state = make_state(controllers=controllers)
        return mock(state, view="service", replies={RAW: reply, "trace/gantry": TRACE, **replies}, **rights)

    return open_mock


def find_panel(page: Page) -> Locator:
    return page.get_by_role("region", name="Console")


def find_line(page: Page) -> Locator:
    return find_panel(page).get_by_role("textbox", name="Command in its own language")


def send(page: Page, command: str) -> None:
    find_line(page).fill(command)
    find_line(page).press("Enter")


def confirm(page: Page) -> None:
    find_panel(page).get_by_role("checkbox", name=re.compile("^I know")).check()


def test_a_command_is_sent_and_its_reply_shown(open_console: Callable[..., MockedStream], page: Page) -> None:
    stream = open_console({"refused": None, "reply": "1234567.0"})
    confirm(page)
    send(page, "MG TIME")
    log = find_panel(page).get_by_role("log", name="Commands and replies")
    expect(log).to_contain_text("gantry MG TIME")
    expect(log).to_contain_text("1234567.0")
    assert stream.asked == [(RAW, {"command": "MG TIME", "i_know": True})]
    expect(find_line(page)).to_have_value("")


def test_nothing_is_sent_without_the_confirmation(open_console: Callable[..., MockedStream], page: Page) -> None:
    stream = open_console({"refused": None, "reply": ""})
    send(page, "BG X")
    button = find_panel(page).get_by_role("button", name="Send")
    expect(button).to_have_attribute("aria-description", "confirm first that no limit is checked")
    button.click(force=True)
    expect(find_line(page)).to_have_value("BG X")
    assert not stream.asked


def test_the_confirmation_is_for_one_controller_and_one_visit(
    open_console: Callable[..., MockedStream], page: Page
) -> None:
    open_console({"refused": None, "reply": ""}, **{"trace/stage": TRACE})
    box = find_panel(page).get_by_role("checkbox", name=re.compile("^I know"))
    confirm(page)
    find_panel(page).get_by_role("combobox", name="Controller").select_option("stage")
    expect(box).not_to_be_checked()
    confirm(page)
    views = page.get_by_role("navigation", name="Views")
    views.get_by_role("button", name="Run").click()
    views.get_by_role("button", name="Service").click()
    expect(box).not_to_be_checked()


def test_a_refusal_is_in_the_log_with_its_remedy(open_console: Callable[..., MockedStream], page: Page) -> None:
    open_console({"refused": REFUSED})
    confirm(page)
    send(page, "BG X")
    log = find_panel(page).get_by_role("log", name="Commands and replies")
    expect(log).to_contain_text("▲ gantry is in use by paul (job 'raster'); wait for its end")


def test_arrow_keys_bring_earlier_commands_back(open_console: Callable[..., MockedStream], page: Page) -> None:
    stream = open_console({"refused": None, "reply": "ok"})
    confirm(page)
    for command in ("MG TIME", "MG _TPX", "MG TIME"):
        send(page, command)
        expect(find_line(page)).to_have_value("")
        sent_count = len(stream.asked)
        wait_for(page, lambda count=sent_count: len(stream.asked) >= count)
        expect(find_panel(page).get_by_role("button", name="Send")).not_to_have_attribute(
            "aria-description", re.compile("not been answered")
        )
    find_line(page).fill("half a comm")
    for key, shown in (
        ("ArrowUp", "MG TIME"),
        ("ArrowUp", "MG _TPX"),
        ("ArrowUp", "MG _TPX"),  # there are no older ones
        ("ArrowDown", "MG TIME"),
        ("ArrowDown", "half a comm"),
        ("ArrowDown", "half a comm"),
    ):
        find_line(page).press(key)
        expect(find_line(page)).to_have_value(shown)
    assert len(stream.asked) == 3


def test_the_trace_of_the_controller_is_beside_it(open_console: Callable[..., MockedStream], page: Page) -> None:
    open_console({"refused": None, "reply": ""})
    trace = find_panel(page).get_by_role("log", name="Trace of gantry")
    expect(trace).to_contain_text("read the clock")
    expect(trace.get_by_role("row").first).to_contain_text("1234567.0")  # the newest first


def test_a_trace_that_cannot_be_read_says_so_in_its_place(
    open_console: Callable[..., MockedStream], page: Page
) -> None:
    absent = {"code": "absent", "text": "gantry has no adapter", "remedy": "start its host", "controller": "gantry"}
    open_console({"refused": None, "reply": ""}, **{"trace/gantry": {"refused": absent}})
    expect(find_panel(page).get_by_text("gantry has no adapter; start its host")).to_be_visible()
    expect(page.get_by_role("region", name="Messages").get_by_text("gantry has no adapter")).to_have_count(0)


@pytest.mark.parametrize("role", ["viewer", "proposer", "operator"])
def test_other_roles_see_why_they_may_not(mock: Mock, page: Page, role: str) -> None:
    mock(view="service", role=role, may=MAY, users=True, user="vera", csrf="x")
    expect(find_panel(page).get_by_text(f"role {role}")).to_be_visible()
    expect(find_line(page)).to_have_count(0)


def test_nothing_of_it_is_kept_in_the_browser(open_console: Callable[..., MockedStream], page: Page) -> None:
    open_console({"refused": None, "reply": "ok"})
    confirm(page)
    send(page, "MG SECRET")
    expect(find_panel(page).get_by_text("MG SECRET")).to_be_visible()
    assert "SECRET" not in page.evaluate("JSON.stringify({...localStorage, ...sessionStorage})")


def test_the_stop_key_works_while_a_command_is_written(open_console: Callable[..., MockedStream], page: Page) -> None:
    stream = open_console({"refused": None, "reply": "ok"})
    find_line(page).focus()
    page.keyboard.press("Pause")
    wait_for(page, lambda: stream.find("stop"))


def test_replies_with_markup_are_texts(open_console: Callable[..., MockedStream], page: Page) -> None:
    evil = "<img src=x onerror=alert(1)>"
    open_console({"refused": None, "reply": evil})
    confirm(page)
    send(page, evil)
    expect(find_panel(page).get_by_text(evil)).to_have_count(2)
    assert page.locator("img").count() == 0
