"""Jogs by a gamepad, which the test simulates: the page moves nothing without the dead-man button."""

from collections.abc import Callable

import pytest
from browser.conftest import MockedStream, make_axis, make_controller, make_state
from browser.test_rules import wait_for
from playwright.sync_api import Page, expect

Mock = Callable[..., MockedStream]

PAD = """
const buttons = Array.from({length: 17}, () => ({pressed: false, touched: false, value: 0}));
window.pad = {id: 'Test pad', index: 0, connected: true, axes: [0, 0, 0, 0], buttons, mapping: 'standard'};
navigator.getGamepads = () => [window.pad, null, null, null];
"""
DEAD_MAN = 4
STEADY_MS = 400  # several times the period of polls and renewals: what has not come by then does not come


@pytest.fixture
def pad(mock: Mock, page: Page) -> MockedStream:
    """Set-up with a gamepad, not switched on."""
    page.add_init_script(PAD)
    return mock(view="setup")


def switch_on(page: Page) -> None:
    page.get_by_role("button", name="Use a gamepad").click()
    expect(page.get_by_text("hold the button, then move the stick")).to_be_visible()


def set_pad(page: Page, *, held: bool | None = None, across: float | None = None, upwards: float | None = None) -> None:
    """All at once: the page reads the pad fifty times a second."""
    axes = {number: value for number, value in enumerate((across, upwards)) if value is not None}
    page.evaluate(
        "(axes) => { Object.assign(pad.axes, axes); }", {str(number): value for number, value in axes.items()}
    )
    if held is not None:
        page.evaluate("([number, held]) => { pad.buttons[number].pressed = held; }", [DEAD_MAN, held])


def enable(page: Page) -> None:
    set_pad(page, held=True)
    expect(page.get_by_text("enabled: the stick moves")).to_be_visible()


def jog(page: Page, stream: MockedStream, part: float = 1.0) -> None:
    """Switch on, hold the button, deflect the stick, until the jog is renewed."""
    switch_on(page)
    enable(page)
    set_pad(page, across=part)
    wait_for(page, lambda: stream.find("renew"))


def expect_rest(page: Page, stream: MockedStream) -> None:
    """Exactly one end, and nothing that moves after it."""
    wait_for(page, lambda: stream.find("end-jog"))
    counts = [len(stream.find(verb)) for verb in ("jog", "renew")]
    page.wait_for_timeout(STEADY_MS)
    assert [len(stream.find(verb)) for verb in ("jog", "renew")] == counts
    assert len(stream.find("end-jog")) == 1


def test_a_gamepad_is_off_until_it_is_switched_on(pad: MockedStream, page: Page) -> None:
    set_pad(page, held=True, across=1)
    page.wait_for_timeout(STEADY_MS)
    assert not pad.find("acquire") and not pad.find("jog")


def test_the_stick_jogs_while_the_dead_man_button_is_held(pad: MockedStream, page: Page) -> None:
    jog(page, pad, part=-1.0)
    (frame,) = pad.find("jog")
    # A quarter of 200 mm/s is the fastest jog, 20 % of it the chosen speed.
    assert (frame["axis"], frame["velocity"]) == ("gantry.x", -10.0)
    assert pad.find("acquire")[0]["axes"] == ["gantry.x"]


def test_the_other_way_of_the_stick_jogs_the_other_axis_and_up_is_plus(pad: MockedStream, page: Page) -> None:
    switch_on(page)
    enable(page)
    set_pad(page, across=0.3, upwards=-1)
    wait_for(page, lambda: pad.find("renew"))
    assert [(frame["axis"], frame["velocity"]) for frame in pad.find("jog")] == [("gantry.y", 10.0)]


@pytest.mark.parametrize("how", ["button", "centre", "disconnect", "blur", "hidden", "absent", "stop", "dialog"])
def test_a_jog_by_a_gamepad_ends_by(pad: MockedStream, page: Page, how: str) -> None:
    jog(page, pad)
    if how == "button":
        set_pad(page, held=False)
    elif how == "centre":
        set_pad(page, across=0.1)  # within the dead zone
    elif how == "disconnect":
        page.evaluate("pad.connected = false; window.dispatchEvent(new Event('gamepaddisconnected'))")
    elif how == "absent":
        page.evaluate("navigator.getGamepads = () => [null]")
    elif how == "blur":
        page.evaluate("document.hasFocus = () => false; window.dispatchEvent(new Event('blur'))")
    elif how == "hidden":
        page.evaluate("Object.defineProperty(document, 'visibilityState', {get: () => 'hidden'})")
        page.evaluate("document.dispatchEvent(new Event('visibilitychange'))")
    elif how == "stop":
        page.keyboard.press("Pause")
    else:
        page.get_by_role("button", name="Settings").click()
    expect_rest(page, pad)
    if how in ("disconnect", "absent"):
        expect(page.get_by_text("Test pad is gone")).to_be_visible()
        expect(page.get_by_role("button", name="Use a gamepad")).to_have_attribute("aria-pressed", "false")


def test_the_end_is_sent_in_the_event_itself(pad: MockedStream, page: Page) -> None:
    """Not at the next poll: a timer of a page that is being hidden may never run."""
    jog(page, pad)
    page.evaluate(
        "window.setInterval = () => 0; document.hasFocus = () => false; window.dispatchEvent(new Event('blur'))"
    )
    expect_rest(page, pad)


@pytest.mark.parametrize("how", ["stop", "blur", "refusal"])
def test_after_another_end_the_button_must_be_pressed_again(pad: MockedStream, page: Page, how: str) -> None:
    jog(page, pad)
    if how == "stop":
        page.keyboard.press("Pause")
    elif how == "blur":
        page.evaluate("window.dispatchEvent(new Event('blur'))")
    else:
        refused = {"code": "not-jogging", "text": "axis x: the fleet was stopped", "remedy": ""}
        pad.send({"jog": {"axis": "gantry.x", "refused": refused}})
    expect_rest(page, pad)
    set_pad(page, across=0)
    page.wait_for_timeout(STEADY_MS)
    set_pad(page, across=1)
    page.wait_for_timeout(STEADY_MS)
    assert len(pad.find("jog")) == 1  # the button is still held, and that is not enough
    set_pad(page, held=False, across=0)
    expect(page.get_by_text("hold the button, then move the stick")).to_be_visible()
    enable(page)
    set_pad(page, across=1)
    wait_for(page, lambda: len(pad.find("jog")) == 2)


def test_a_button_that_is_pressed_at_a_deflected_stick_enables_nothing(pad: MockedStream, page: Page) -> None:
    switch_on(page)
    set_pad(page, across=1)
    set_pad(page, held=True)
    expect(page.get_by_text("let the button go, centre the stick, and press again")).to_be_visible()
    page.wait_for_timeout(STEADY_MS)
    assert not pad.find("jog")


def test_a_button_that_is_held_when_it_is_switched_on_enables_nothing(pad: MockedStream, page: Page) -> None:
    set_pad(page, held=True)
    page.get_by_role("button", name="Use a gamepad").click()
    expect(page.get_by_text("let the button go, centre the stick, and press again")).to_be_visible()


def test_a_new_speed_goes_with_a_renewal_and_at_most_ten_times_a_second(pad: MockedStream, page: Page) -> None:
    """A `jog` frame would move an axis again that a stop has ended meanwhile."""
    jog(page, pad)
    first = len(pad.find("renew"))
    page.evaluate("let n = 0; window.wobble = setInterval(() => { n += 1; pad.axes[0] = 0.4 + (n % 7) / 10; }, 10)")
    page.wait_for_timeout(1000)
    renewals = pad.find("renew")[first:]
    assert len(renewals) <= 11
    page.evaluate("clearInterval(wobble)")
    set_pad(page, across=0)
    assert len(pad.find("jog")) == 1
    velocities = {frame["velocity"] for frame in renewals if "velocity" in frame}
    assert velocities and all(0 < velocity <= 10 for velocity in velocities)


def test_without_answers_nothing_is_renewed(pad: MockedStream, page: Page) -> None:
    jog(page, pad)
    pad.mute()
    page.wait_for_timeout(STEADY_MS)
    counts = len(pad.find("renew"))
    page.wait_for_timeout(STEADY_MS)
    assert len(pad.find("renew")) == counts


def test_a_pad_that_stops_being_read_is_not_renewed(pad: MockedStream, page: Page) -> None:
    """Each renewal reads the pad itself: the polls are not what it relies on."""
    switch_on(page)
    page.evaluate(
        "window.reads = 0; const old = navigator.getGamepads; navigator.getGamepads = () => { reads += 1; return old(); }"
    )
    enable(page)
    set_pad(page, across=1)
    wait_for(page, lambda: pad.find("renew"))
    page.evaluate("pad.axes[0] = NaN")
    expect_rest(page, pad)
    assert page.evaluate("reads") > 0


def test_choices_are_kept_and_that_it_is_on_is_not(pad: MockedStream, page: Page) -> None:
    switch_on(page)
    page.get_by_role("combobox", name="Stick for left and right").select_option("2")
    page.get_by_label("Stick for left and right, reversed").check()
    page.get_by_role("combobox", name="Button to hold").select_option("7")
    page.get_by_role("combobox", name="Dead zone").select_option("0.3")
    page.reload()
    button = page.get_by_role("button", name="Use a gamepad")
    expect(button).to_have_attribute("aria-pressed", "false")
    switch_on(page)
    expect(page.get_by_role("combobox", name="Stick for left and right")).to_have_value("2")
    expect(page.get_by_role("combobox", name="Button to hold")).to_have_value("7")
    expect(page.get_by_role("combobox", name="Dead zone")).to_have_value("0.3")
    page.evaluate("pad.buttons[7].pressed = true")
    expect(page.get_by_text("enabled: the stick moves")).to_be_visible()
    page.evaluate("pad.axes[2] = 1")
    wait_for(page, lambda: pad.find("jog"))
    assert pad.find("jog")[0]["velocity"] == -10.0


def test_another_view_switches_it_off(pad: MockedStream, page: Page) -> None:
    switch_on(page)
    page.get_by_role("button", name="Run", exact=True).click()
    page.get_by_role("button", name="Set-up").click()
    expect(page.get_by_role("button", name="Use a gamepad")).to_have_attribute("aria-pressed", "false")


def test_axis_and_scale_are_shown(pad: MockedStream, page: Page) -> None:
    switch_on(page)
    expect(page.get_by_text("Full deflection moves gantry.x at 10.000 mm/s.")).to_be_visible()
    set_pad(page, across=0.575)
    expect(page.get_by_role("meter", name="Left and right")).to_have_attribute("aria-valuenow", "50")
    expect(page.get_by_text("gantry.x 5.000 mm/s")).to_be_visible()


def test_an_axis_that_cannot_be_jogged_says_why(mock: Mock, page: Page) -> None:
    page.add_init_script(PAD)
    stream = mock(make_state(controllers={"gantry": make_controller({"x": make_axis(enabled=False)})}), view="setup")
    switch_on(page)
    enable(page)
    set_pad(page, across=1)
    expect(page.get_by_text("Not now: Jog gantry.x")).to_be_visible()
    page.wait_for_timeout(STEADY_MS)
    assert not stream.find("acquire")


def test_a_pad_that_is_not_there_yet_and_a_browser_without_pads_are_said(mock: Mock, page: Page) -> None:
    page.add_init_script("navigator.getGamepads = () => [null, null]")
    mock(view="setup")
    page.get_by_role("button", name="Use a gamepad").click()
    expect(page.get_by_text("No gamepad is seen.")).to_be_visible()
    page.add_init_script("navigator.getGamepads = undefined")
    page.reload()
    expect(page.get_by_role("button", name="Use a gamepad")).to_have_attribute("aria-disabled", "true")
