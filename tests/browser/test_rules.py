"""The rules of the page, each by name, without a fleet: the test writes what the socket sends."""

import re
from collections.abc import Callable
from typing import Any

import pytest
from browser.conftest import LARGE, SMALL, MockedStream, make_axis, make_controller, make_entry, make_state
from playwright.sync_api import Locator, Page, ViewportSize, expect

Mock = Callable[..., MockedStream]
VIEWS = ("run", "setup", "service")
BACKGROUND = "#page"


def plus(page: Page) -> Locator:
    return page.get_by_role("button", name="Jog gantry.x +", exact=True)


def hold(page: Page, mock: MockedStream) -> None:
    """Press the jog button with the mouse, and keep it down until it is renewed."""
    box = plus(page).bounding_box()
    assert box is not None
    page.mouse.move(box["x"] + 20, box["y"] + 20)
    page.mouse.down()
    wait_for(page, lambda: mock.find("renew"))


def wait_for(page: Page, condition: Callable[[], Any]) -> None:
    for _ in range(1500):
        if condition():
            return
        page.wait_for_timeout(20)
    raise AssertionError("not within 30 s")


def test_an_open_bus_is_shown_in_every_view_also_when_its_alarm_is_shelved(mock: Mock, page: Page) -> None:
    text = "INSECURE: the bus at tcp/0.0.0.0:7447 has no TLS; everything that reaches it can move this fleet"
    alarm = {
        **{"id": "open-bus", "kind": "open-bus", "subject": "bus", "priority": "high", "text": text, "action": ""},
        **{"state": "acknowledged", "raised_utc": "2026-01-01T00:00:00Z", "shelved_until_utc": "2026-01-01T10:00:00Z"},
    }
    for view in VIEWS:
        mock(make_state(alarms={"open-bus": alarm}), view=view)
        expect(page.get_by_role("alert").filter(has_text="has no TLS")).to_be_visible()
    mock(make_state(alarms={"open-bus": {**alarm, "state": "returned"}}))
    expect(page.get_by_role("alert").filter(has_text="has no TLS")).to_have_count(0)


# A jog


@pytest.mark.parametrize(
    "how", ["pointerup", "pointercancel", "lostpointercapture", "blur", "hidden", "escape", "closed"]
)
def test_a_jog_ends_by(mock: Mock, page: Page, how: str) -> None:
    """One frame, in the event itself; and nothing is renewed after it."""
    stream = mock(view="setup")
    hold(page, stream)
    assert len(stream.find("jog")) == 1
    if how == "pointerup":
        page.mouse.up()
    elif how == "escape":
        page.keyboard.press("Escape")
    elif how == "hidden":
        session = page.context.new_cdp_session(page)
        page.evaluate("Object.defineProperty(document, 'visibilityState', {get: () => 'hidden'})")
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
        session.detach()
    elif how == "blur":
        page.evaluate("window.dispatchEvent(new Event('blur'))")
    elif how == "closed":
        stream.close()
    else:
        plus(page).dispatch_event(how, {"pointerId": 1, "isPrimary": True})
    if how == "closed":
        page.wait_for_timeout(500)
        expect(page.get_by_text("stops by itself within 200 ms")).to_be_visible()
        return
    wait_for(page, lambda: stream.find("end-jog"))
    assert len(stream.find("end-jog")) == 1
    renewed = len(stream.find("renew"))
    page.wait_for_timeout(500)
    assert len(stream.find("renew")) == renewed
    assert bool(stream.find("stop")) == (how == "escape")


def test_a_touch_that_the_system_cancels_ends_the_jog(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    box = plus(page).bounding_box()
    assert box is not None
    session = page.context.new_cdp_session(page)
    point = {"x": box["x"] + 20, "y": box["y"] + 20}
    session.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [point]})
    wait_for(page, lambda: stream.find("renew"))
    session.send("Input.dispatchTouchEvent", {"type": "touchCancel", "touchPoints": []})
    wait_for(page, lambda: stream.find("end-jog"))


def test_a_jog_is_renewed_at_most_ten_times_a_second_and_only_while_answers_come(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    hold(page, stream)
    before = len(stream.find("renew"))
    page.wait_for_timeout(1000)
    assert len(stream.find("renew")) - before <= 11
    stream._take = lambda message: stream.sent.append(__import__("json").loads(message))  # type: ignore[method-assign]
    assert stream._socket is not None
    stream._socket.on_message(stream._take)
    page.wait_for_timeout(300)
    silent = len(stream.find("renew"))
    page.wait_for_timeout(700)
    assert len(stream.find("renew")) == silent
    page.mouse.up()


def test_keys_jog_while_they_are_held_and_never_by_their_repeats(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    page.get_by_role("group", name="Jog pad").focus()
    for _ in range(5):
        page.keyboard.down("ArrowRight")
    wait_for(page, lambda: stream.find("renew"))
    assert len(stream.find("jog")) == 1
    page.keyboard.up("ArrowRight")
    wait_for(page, lambda: stream.find("end-jog"))
    assert stream.find("jog")[0]["velocity"] > 0


def test_space_moves_nothing(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    stops = page.locator("button:visible").count()
    for _ in range(stops + 10):
        page.keyboard.press("Tab")
        focused = page.evaluate(
            "document.activeElement.getAttribute('aria-label') || document.activeElement.textContent"
        )
        if focused in ("E-stop", "Stop") or "Enable" in str(focused) or "Home" in str(focused):
            continue
        page.keyboard.press("Space")
        page.keyboard.press("Escape") if page.get_by_role("dialog").count() else None
    assert not stream.find("jog") and not stream.find("work") and not stream.find("acquire")


def test_a_finger_on_a_jog_button_selects_and_scrolls_nothing(mock: Mock, page: Page) -> None:
    mock(view="setup")
    for property_, value in (("touch-action", "none"), ("user-select", "none")):
        expect(plus(page)).to_have_css(property_, value)
    prevented = plus(page).evaluate(
        "button => !button.dispatchEvent(new MouseEvent('contextmenu', {bubbles: true, cancelable: true}))"
    )
    assert prevented


def test_the_view_stays_while_an_axis_is_under_manual_control(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    hold(page, stream)
    page.evaluate("location.hash = '#service'")
    page.wait_for_timeout(200)
    expect(plus(page)).to_be_visible()
    page.mouse.up()


def test_position_limits_reason_and_jog_are_on_one_screen(mock: Mock, page: Page) -> None:
    state = make_state(controllers={"gantry": make_controller({"x": make_axis(referenced=False)})})
    mock(state, view="setup")
    region = page.get_by_role("region", name="Jog", exact=True)
    for text in ("12.500", "-10.000", "400.000", "not referenced", "home it"):
        expect(region.get_by_text(text).first).to_be_in_viewport()
    expect(plus(page)).to_be_in_viewport()


# Stops


@pytest.mark.parametrize("size", [LARGE, SMALL])
@pytest.mark.parametrize("view", VIEWS)
def test_the_stop_bar_is_large_fixed_and_apart(mock: Mock, page: Page, size: ViewportSize, view: str) -> None:
    page.set_viewport_size(size)
    mock(view=view)
    bar = page.get_by_role("region", name="Stop bar")
    buttons = [bar.get_by_role("button", name=name, exact=True) for name in ("Stop", "E-stop")]
    boxes = [each.bounding_box() for each in buttons]
    for box in boxes:
        assert box is not None and box["height"] >= 64
        assert box["y"] + box["height"] > size["height"] / 2 if size is SMALL else box["y"] < 100
    others = page.locator("button:visible, a:visible, select:visible, input:visible").all()
    for other in others:
        place = other.bounding_box()
        if place is None or place in boxes:
            continue
        for box in boxes:
            assert box is not None
            across = max(box["x"] - place["x"] - place["width"], place["x"] - box["x"] - box["width"])
            along = max(box["y"] - place["y"] - place["height"], place["y"] - box["y"] - box["height"])
            assert max(across, along) >= 24 or is_under(place, size), (other.inner_text(), place, box)
    page.mouse.wheel(0, 2000)
    expect(buttons[0]).to_be_in_viewport()


def is_under(place: Any, size: ViewportSize) -> bool:
    """Whether it is scrolled under the bar of small screens: then the bar's own ground covers it. What is above that
    ground is at least 24 px from the buttons."""
    return size is SMALL and place["y"] + place["height"] > size["height"] - GROUND


GROUND = 64 + 12 + 24  # the buttons, the edge of the screen, and the distance


def test_a_stop_asks_nothing_and_who_did_it_stays_in_view(mock: Mock, page: Page) -> None:
    stream = mock()
    page.get_by_role("button", name="Stop", exact=True).click()
    wait_for(page, lambda: stream.find("stop"))
    stream.send({"stopped": {"by": "vera@192.0.2.7", "what": "stop", "utc": "2026-01-01T00:00:01Z", "answers": {}}})
    message = page.get_by_text("Stopped by vera@192.0.2.7")
    expect(message.first).to_be_visible()
    for _ in range(5):
        stream.patch({"utc": "2026-01-01T00:00:02Z"})
        page.wait_for_timeout(300)
    expect(message.first).to_be_visible()


def test_a_stop_that_a_controller_does_not_confirm_is_said(mock: Mock, page: Page) -> None:
    stream = mock()
    refused = {
        "code": "no-answer",
        "text": "gantry does not answer",
        "remedy": "use the wired stop",
        "controller": None,
    }
    answers = {"gantry": refused}
    stream.send({"stopped": {"by": "me", "what": "stop", "utc": "2026-01-01T00:00:01Z", "answers": answers}})
    expect(page.get_by_text("gantry has not confirmed the stop").first).to_be_visible()


def test_a_stop_is_for_every_role(mock: Mock, page: Page) -> None:
    stream = mock(role="viewer", may=["stop", "estop"], users=True, user="vera", csrf="x")
    page.get_by_role("button", name="E-stop", exact=True).click()
    wait_for(page, lambda: stream.find("estop"))


# What is old


def test_what_is_old_is_marked_with_its_age_and_only_a_stop_is_left(mock: Mock, page: Page) -> None:
    mock().beating = False  # the socket is open, and silent
    page.wait_for_timeout(2500)
    expect(page.get_by_text(re.compile(r"no news for \d+ s")).first).to_be_visible()
    row = page.get_by_test_id("axis-gantry.x")
    expect(row.locator("xpath=..")).to_have_class(re.compile("stale"))
    page.get_by_role("button", name="Menu of gantry.x").click()
    enable = page.get_by_role("button", name="Disable gantry.x")
    expect(enable).to_have_attribute("aria-disabled", "true")
    assert "old" in str(enable.get_attribute("aria-description")) or "old" in str(enable.get_attribute("title"))
    stop = page.get_by_role("button", name="Stop", exact=True)
    assert stop.is_enabled() and stop.get_attribute("aria-disabled") is None


def test_an_old_controller_is_marked_and_another_one_is_not(mock: Mock, page: Page) -> None:
    controllers = {"gantry": make_controller({"x": make_axis()}, age_s=3), "stage": make_controller({"u": make_axis()})}
    mock(make_state(controllers=controllers))
    expect(page.locator("[data-controller=gantry]")).to_have_class(re.compile("stale"))
    expect(page.locator("[data-controller=stage]")).not_to_have_class(re.compile("stale"))
    expect(page.locator("[data-controller=gantry]").get_by_text("3 s old").first).to_be_visible()


def test_a_clock_of_the_browser_that_is_wrong_by_a_day_changes_nothing(mock: Mock, page: Page) -> None:
    page.clock.set_system_time("2027-01-02T00:00:00Z")
    stream = mock()
    for _ in range(4):
        stream.patch({"utc": "2026-01-01T00:00:02Z"})
        page.wait_for_timeout(400)
    expect(page.locator("[data-controller=gantry]")).not_to_have_class(re.compile("stale"))
    expect(page.get_by_text("no news")).to_have_count(0)


def test_a_coordinator_that_is_away_is_said_and_a_stop_works(mock: Mock, page: Page) -> None:
    stream = mock(make_state(coordinator={"present": False}))
    expect(page.get_by_text("The coordinator is away").first).to_be_visible()
    page.get_by_role("button", name="Stop", exact=True).click()
    wait_for(page, lambda: stream.find("stop"))


# Axes


def test_an_axis_says_why_it_is_not_ready_and_what_to_do_and_which_user_holds_it(mock: Mock, page: Page) -> None:
    axes = {"x": make_axis(referenced=False), "y": make_axis(enabled=False), "z": make_axis(limit="forward")}
    leases = {"gantry": {"holder": "manual-7", "actor": "paul@192.0.2.1", "what": "alignment"}}
    mock(make_state(controllers={"gantry": make_controller(axes)}, leases=leases))
    for axis, reason, remedy in (
        ("x", "not referenced", "home it"),
        ("y", "motor off", "enable it"),
        ("z", "limit", "jog"),
    ):
        row = page.get_by_test_id(f"axis-gantry.{axis}")
        expect(row.get_by_text(reason).first).to_be_visible()
        expect(row.get_by_text(remedy).first).to_be_visible()
        expect(row).to_contain_text("paul")


def test_home_and_set_position_are_in_the_menu_with_the_value_written_out(mock: Mock, page: Page) -> None:
    stream = mock(view="setup")
    assert page.get_by_role("button", name=re.compile("^Home gantry.x")).count() == 0
    page.get_by_role("button", name="Menu of gantry.x").click()
    page.get_by_label("Position in mm").fill("42.5")
    page.get_by_role("button", name="Set the present position to 42.500 mm").click()
    wait_for(page, lambda: stream.find("work"))
    assert stream.find("work")[0]["step"] == {"do": "set-position", "axes": {"gantry.x": 42.5}}


def test_numbers_do_not_change_the_width_of_anything(mock: Mock, page: Page) -> None:
    stream = mock()
    cell = page.get_by_test_id("position-gantry.x")
    expect(cell).to_have_css("font-variant-numeric", re.compile("tabular-nums"))
    before = cell.bounding_box()
    stream.patch({"controllers": {"gantry": {"axes": {"x": {"position": -9.999}}}}})
    expect(cell).to_contain_text("-9.999")
    assert cell.bounding_box() == before


@pytest.mark.parametrize("axes", [2, 5])
def test_the_run_view_needs_no_scrolling_at_1280_by_800(mock: Mock, page: Page, axes: int) -> None:
    many = {name: make_axis() for name in "abcdefgh"[:axes]}
    jobs = [make_entry(f"job {number}", place=number) for number in range(1, 4)]
    queue = {"waiting": 3, "total": 3, "jobs": jobs}
    mock(make_state(controllers={"gantry": make_controller(many)}, queue=queue))
    assert page.evaluate("document.documentElement.scrollHeight <= innerHeight")


@pytest.mark.parametrize("size", [SMALL, LARGE, {"width": 2560, "height": 1440}])
@pytest.mark.parametrize("view", VIEWS)
def test_nothing_is_wider_than_the_screen(mock: Mock, page: Page, size: ViewportSize, view: str) -> None:
    page.set_viewport_size(size)
    mock(view=view)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")


# The queue


def make_queue(*names: str) -> dict[str, Any]:
    jobs = [make_entry(name, place=place) for place, name in enumerate(names, 1)]
    return make_state(queue={"waiting": len(jobs), "total": len(jobs), "jobs": jobs})


@pytest.mark.parametrize("by", ["drag", "keyboard"])
def test_a_job_is_moved_by(mock: Mock, page: Page, by: str) -> None:
    asked: list[Any] = []
    mock(make_queue("alpha", "beta", "gamma"))
    page.route(
        "**/v1/reorder",
        lambda route: (asked.append(route.request.post_data_json), route.fulfill(json={"refused": None})),
    )
    waiting = page.get_by_role("list", name="Waiting jobs")
    if by == "keyboard":
        page.get_by_label("Move gamma before").select_option("id-alpha")
    else:
        grip = waiting.locator("[data-job=id-gamma]").get_by_title("Drag to move").first
        target = waiting.locator("[data-job=id-alpha]").bounding_box()
        start = grip.bounding_box()
        assert start is not None and target is not None
        page.mouse.move(start["x"] + start["width"] / 2, start["y"] + start["height"] / 2)
        page.mouse.down()
        page.mouse.move(target["x"] + 40, target["y"] + 60, steps=5)
        page.mouse.move(target["x"] + 40, target["y"] + 4, steps=5)
        page.mouse.up()
    wait_for(page, lambda: asked)
    assert asked == [{"job_id": "id-gamma", "before": "id-alpha"}]


def test_a_waiting_job_says_what_it_waits_for(mock: Mock, page: Page) -> None:
    mock(make_queue("alpha"))
    card = page.locator("[data-job=id-alpha]")
    expect(card).to_contain_text("waits for gantry: job 'other' 1234 of anna")


# Roles and texts


def test_the_page_mirrors_the_role_with_the_reason(mock: Mock, page: Page) -> None:
    mock(make_queue("alpha"), role="viewer", may=["stop", "estop"], users=True, user="vera", csrf="x")
    hold_button = page.get_by_role("button", name="Hold alpha")
    expect(hold_button).to_be_visible()
    expect(hold_button).to_have_attribute("aria-disabled", "true")
    assert "role viewer" in str(hold_button.get_attribute("aria-description") or hold_button.get_attribute("title"))
    hold_button.click(force=True)  # does nothing


def test_without_users_the_page_says_so(mock: Mock, page: Page) -> None:
    mock()
    expect(page.get_by_text("There are no users").first).to_be_visible()


def test_names_with_markup_are_texts(mock: Mock, page: Page) -> None:
    evil = "<img src=x onerror=alert(1)><b>bold</b>"
    state = make_queue(evil)
    state["events"] = [{"n": 1, "controller": "gantry", "kind": "fault", "text": evil, "utc": "2026-01-01T00:00:00Z"}]
    state["leases"] = {"gantry.x": {"holder": "manual-1", "actor": evil, "what": evil}}
    fault = {"code": "f", "text": evil, "remedy": evil}
    state["controllers"] = {"gantry": make_controller({"x": make_axis()}, faults=[fault], mode="fault")}
    mock(state)
    for view in ("Run", "Set-up", "Service"):
        page.get_by_role("navigation", name="Views").get_by_role("button", name=view).click()
        assert page.locator("img").count() == 0 and page.get_by_text("bold", exact=True).count() == 0
    page.get_by_role("navigation", name="Views").get_by_role("button", name="Run").click()
    expect(page.get_by_text(evil).first).to_be_visible()


def test_a_refusal_stays_until_it_is_dismissed(mock: Mock, page: Page) -> None:
    stream = mock()
    refused = {"code": "leased", "text": "gantry.x is in use by paul", "remedy": "wait for the end", "controller": None}
    stream.answers["work"] = {"refused": refused}
    page.get_by_role("button", name="Menu of gantry.x").click()
    page.get_by_role("button", name="Disable gantry.x").click()
    message = page.get_by_text("gantry.x is in use by paul").first
    expect(message).to_be_visible()
    expect(page.get_by_text("wait for the end").first).to_be_visible()
    for _ in range(6):
        stream.patch({"utc": "2026-01-01T00:00:03Z"})
        page.wait_for_timeout(400)
    expect(message).to_be_visible()


def test_an_alarm_is_one_step_away_and_in_title_and_icon(mock: Mock, page: Page) -> None:
    alarm = {
        "id": "disconnected-gantry",
        "kind": "disconnected",
        "subject": "gantry",
        "priority": "high",
        "text": "gantry is disconnected",
        "action": "check the cable",
        "state": "unacknowledged",
        "raised_utc": "2026-01-01T00:00:00.000000Z",
        "count": 1,
    }
    mock(make_state(alarms={"disconnected-gantry": alarm}))
    expect(page).to_have_title(re.compile("1 alarm"))
    page.get_by_role("button", name=re.compile("1 alarm, 1 new")).click()
    expect(page.get_by_text("gantry is disconnected").first).to_be_visible()
    expect(page.get_by_text("check the cable").first).to_be_visible()


def test_a_socket_that_is_lost_is_opened_again(mock: Mock, page: Page) -> None:
    stream = mock()
    stream.close()
    expect(page.get_by_text("not connected").first).to_be_visible()
    expect(page.get_by_text("not connected")).to_have_count(0)


def test_a_gap_in_the_numbers_is_noticed(mock: Mock, page: Page) -> None:
    stream = mock()
    stream._number += 5
    stream.patch({"utc": "2026-01-01T00:00:02Z"})
    wait_for(page, lambda: stream.find("resync"))
