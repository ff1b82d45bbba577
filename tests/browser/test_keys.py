"""Keys of the page: Esc closes what is open, and stops only when nothing is; Pause always stops."""

from collections.abc import Callable
from typing import Any

import pytest
from browser.conftest import MockedStream, make_entry, make_state
from browser.test_rules import Mock, wait_for
from playwright.sync_api import Page, expect

ALARM = {
    **{"id": "vacuum", "kind": "vacuum", "subject": "chamber", "priority": "high", "text": "too high", "action": ""},
    **{"state": "unacknowledged", "raised_utc": "2026-01-01T00:00:00Z", "count": 1},
}
TEMPLATE = {"name": "scan", "file": "scan.template.job.yaml", "parameters": []}
PREVIEW = {
    "motions": [{"job_id": "id-alpha", "name": "alpha", "text": "step 1: move", "axes": ["gantry.x"]}],
    "lasting": [],
    "shown": "1",
}
PLAN = {"plan": {"hash": "abc", "parts": {}}}
ENDED = {"id": "id-old", "name": "old", "actor": "anna", "state": "failed", "reason": "it broke"}
REPORT = {
    **{"job_id": "id-old", "name": "old", "actor": "anna", "state": "failed", "reason": "it broke"},
    **{"submitted_utc": "2026-01-01T00:00:00Z", "max_start_skew_ns": 1, "steps": []},
}
STOPPED = {"reason": "a break", "actor": "anna", "utc": "2026-01-01T00:00:00Z"}


def open_messages(page: Page) -> None:
    page.evaluate("""for (const text of ['a', 'b', 'c']) window.tutti.feed(JSON.stringify(
        {stopped: {by: 'me', what: 'stop', answers: {[text]: {code: 'c', text, remedy: ''}}}}))""")
    page.get_by_role("button", name="more").click()


def open_form(page: Page) -> None:
    page.get_by_role("button", name="New job").click()
    page.get_by_role("button", name="Fill in scan").click()


def press(name: str, view: str = "run") -> tuple[str, Callable[[Page], None]]:
    return view, lambda page: page.get_by_role("button", name=name).first.click()


DIALOGS: dict[str, tuple[str, Callable[[Page], None]]] = {
    "menu of an axis": press("Menu of gantry.x"),
    "move of an axis": press("Go: gantry.x"),
    "settings": press("Settings"),
    "alarms": press("1 alarm"),
    "new job": press("New job"),
    "form of a job": ("run", open_form),
    "start of the queue": press("Start queue"),
    "release": press("Release alpha"),
    "get ready": press("Get ready …", "setup"),
    "approval": press("Review beta"),
    "report": press("old", "service"),
    "run again": press("Run again: old"),
    "messages": ("run", open_messages),
}


@pytest.fixture
def full(mock: Mock) -> Callable[..., MockedStream]:
    """A page on which every dialog can be opened."""

    def open_full(view: str) -> MockedStream:
        replies = {
            "templates": {"templates": [TEMPLATE]},
            "preview-start": PREVIEW,
            "check-job": {"job": None},
            "retry": {"steps": ["step 1: move"]},
            "jobs": {"jobs": [ENDED | {"submitted_utc": "2026-01-01T00:00:00Z"}]},
            "jobs/id-beta/plan": PLAN,
            "jobs/id-alpha": {"job": {"steps": [{"do": "move", "to": {"gantry.x": 1}}]}},
            "jobs/id-old": {"report": REPORT, "entry": ENDED},
        }
        jobs = [make_entry("alpha", held_by="anna"), make_entry("beta", proposed=True, held_by="approval")]
        state: dict[str, Any] = make_state(
            queue={"stopped": STOPPED, "waiting": 2, "total": 2, "jobs": jobs}, alarms={"vacuum": ALARM}
        )
        state["controllers"]["gantry"]["axes"]["x"]["referenced"] = False
        return mock(state, view, replies)

    return open_full


@pytest.mark.parametrize("dialog", DIALOGS)
def test_escape_closes_a_dialog_and_stops_nothing_and_pause_stops(
    full: Callable[..., MockedStream], page: Page, dialog: str
) -> None:
    view, open_dialog = DIALOGS[dialog]
    stream = full(view)
    open_dialog(page)
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.wait_for_timeout(100)
    assert not stream.find("stop")
    open_dialog(page)
    expect(page.get_by_role("dialog")).to_be_visible()
    page.keyboard.press("Pause")
    wait_for(page, lambda: stream.find("stop"))
    expect(page.get_by_role("dialog")).to_be_visible()  # it does nothing else
    page.keyboard.press("Escape")
    page.keyboard.press("Escape")
    wait_for(page, lambda: len(stream.find("stop")) == 2)  # with nothing open it stops


@pytest.mark.parametrize("view", ["run", "setup", "service"])
@pytest.mark.parametrize("key", ["Escape", "Pause"])
def test_with_nothing_open_both_keys_stop_in_every_view(mock: Mock, page: Page, view: str, key: str) -> None:
    stream = mock(view=view)
    page.keyboard.press(key)
    wait_for(page, lambda: stream.find("stop"))


def test_escape_lets_a_dragged_card_go_and_stops_nothing(mock: Mock, page: Page) -> None:
    jobs = [make_entry("alpha"), make_entry("beta", place=2)]
    stream = mock(make_state(queue={"waiting": 2, "total": 2, "jobs": jobs}))
    box = page.locator("[data-job=id-beta] .handle").bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 5, box["y"] + 5)
    page.mouse.down()
    page.mouse.move(box["x"] + 5, box["y"] - 60, steps=4)
    page.keyboard.press("Escape")
    expect(page.locator(".dragged")).to_have_count(0)
    page.mouse.up()
    page.wait_for_timeout(100)
    assert not stream.find("stop")
    page.keyboard.press("Escape")
    wait_for(page, lambda: stream.find("stop"))


def test_escape_closes_an_open_list_and_stops_nothing(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    choice = page.get_by_label("Left and right")
    choice.focus()
    page.keyboard.press("Alt+ArrowDown")
    expect(page.locator("select:open")).to_have_count(1)
    page.keyboard.press("Escape")
    expect(page.locator("select:open")).to_have_count(0)
    assert not stream.find("stop")


def test_a_key_of_the_users_choice_always_stops(mock: Mock, page: Page) -> None:
    stream = mock()
    page.keyboard.press("F8")
    page.get_by_role("button", name="Settings").click()
    page.wait_for_timeout(100)
    assert not stream.find("stop")
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Also stops, always").select_option("F8")
    expect(dialog.get_by_role("table")).to_contain_text("Pause, F8")
    page.keyboard.press("F8")
    wait_for(page, lambda: stream.find("stop"))
    expect(dialog).to_contain_text("Esc closes this; Pause or F8 stops.")


def test_escape_in_the_full_screen_view_closes_that_and_stops_nothing(mock: Mock, page: Page) -> None:
    stream = mock()
    page.evaluate("document.documentElement.requestFullscreen()")
    wait_for(page, lambda: page.evaluate("document.fullscreenElement !== null"))
    page.keyboard.press("Escape")
    wait_for(page, lambda: page.evaluate("document.fullscreenElement === null"))
    page.wait_for_timeout(100)
    assert not stream.find("stop")
    page.keyboard.press("Escape")  # with nothing open, and no full screen, it stops
    wait_for(page, lambda: stream.find("stop"))


def test_a_dialog_in_the_full_screen_view_is_closed_first(mock: Mock, page: Page) -> None:
    stream = mock()
    page.evaluate("document.documentElement.requestFullscreen()")
    wait_for(page, lambda: page.evaluate("document.fullscreenElement !== null"))
    page.get_by_role("button", name="Menu of gantry.x").click()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert page.evaluate("document.fullscreenElement !== null")
    assert not stream.find("stop")


def test_a_held_escape_closes_and_does_not_go_on_to_stop(mock: Mock, page: Page) -> None:
    stream = mock()
    page.get_by_role("button", name="Menu of gantry.x").click()
    for _ in range(4):
        page.keyboard.down("Escape")  # the first is a press, the others are repeats
    page.keyboard.up("Escape")
    page.wait_for_timeout(100)
    assert not stream.find("stop")


def test_one_tab_reaches_the_jog_pad_and_a_press_leaves_the_arrow_keys_ready(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    pad = page.get_by_role("group", name="Jog pad")
    page.keyboard.press("Tab")
    expect(pad).to_be_focused()
    page.get_by_role("button", name="Run", exact=True).click()
    page.get_by_role("button", name="Set-up").click()
    page.keyboard.press("Tab")
    expect(pad).to_be_focused()
    page.get_by_label("Left and right").focus()
    page.get_by_role("button", name="Jog gantry.x +", exact=True).click(delay=200)
    expect(pad).to_be_focused()
    before = len(stream.find("jog"))
    page.keyboard.down("ArrowLeft")
    wait_for(page, lambda: len(stream.find("jog")) > before)
    page.keyboard.up("ArrowLeft")
    assert stream.find("jog")[-1]["velocity"] < 0
