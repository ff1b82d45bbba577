"""Whether a key is held, with and without reported releases."""

import pytest

from orchestrator.cli.jog.held_key import BEGIN_NS, GAP_NS, SILENT_NS, TAP_NS, WAIT_NS, Grip, Hold
from orchestrator.cli.jog.keys import Key
from orchestrator.clock.base import NS_PER_MS, NS_PER_S

LEFT, RIGHT = Key("left"), Key("right")


def test_a_reported_release_ends_the_hold_at_once() -> None:
    hold = Hold(releases=True)
    assert hold.take(LEFT, 0) is Grip.BEGIN
    assert hold.take(Key("left", "repeat"), NS_PER_S // 2) is None
    assert hold.look(NS_PER_S) is None
    assert hold.take(Key("left", "release"), NS_PER_S) is Grip.END
    assert hold.look(9 * NS_PER_S) is None
    assert hold.take(Key("left", "repeat"), 9 * NS_PER_S) is None
    assert hold.key is None


def test_a_terminal_that_falls_silent_ends_it_too() -> None:
    hold = Hold(releases=True)
    hold.take(LEFT, 0)
    hold.alive(SILENT_NS // 2)
    assert hold.look(SILENT_NS) is None
    assert hold.look(SILENT_NS + SILENT_NS // 2) is Grip.SILENT
    assert hold.key is None


def test_the_release_of_another_key_changes_nothing() -> None:
    hold = Hold(releases=True)
    hold.take(LEFT, 0)
    assert hold.take(RIGHT, 1) is Grip.BEGIN
    assert hold.take(Key("left", "release"), 2) is None
    assert hold.key == "right"


@pytest.mark.parametrize(("delay_ms", "rate_hz"), [(250, 25), (500, 30), (660, 40), (375, 11)])
def test_repeats_hold_without_stutter(delay_ms: int, rate_hz: int) -> None:
    hold = Hold(releases=False)
    assert hold.take(LEFT, 0) is Grip.BEGIN
    assert hold.look(TAP_NS) is Grip.END
    began_ns = delay_ms * NS_PER_MS
    assert hold.take(LEFT, began_ns) is Grip.GO_ON
    for k in range(1, 40):
        at_ns = began_ns + k * NS_PER_S // rate_hz
        assert hold.look(at_ns - 1) is None
        assert hold.take(LEFT, at_ns) is None
    assert hold.look(at_ns + WAIT_NS - 1) is None
    assert hold.look(at_ns + WAIT_NS) is Grip.END


def test_a_key_pressed_after_a_pause_is_pressed_anew() -> None:
    hold = Hold(releases=False)
    hold.take(LEFT, 0)
    hold.look(TAP_NS)
    assert hold.take(LEFT, BEGIN_NS + 1) is Grip.BEGIN
    hold.look(BEGIN_NS + 1 + TAP_NS)
    again_ns = 2 * BEGIN_NS
    assert hold.take(LEFT, again_ns) is Grip.GO_ON
    hold.look(again_ns + WAIT_NS)
    assert hold.take(LEFT, again_ns + GAP_NS + 1) is Grip.BEGIN


def test_another_key_is_always_pressed_anew() -> None:
    hold = Hold(releases=False)
    hold.take(LEFT, 0)
    assert hold.take(RIGHT, 1) is Grip.BEGIN
    assert hold.take(LEFT, 2) is Grip.BEGIN


def test_a_second_press_within_a_tap_does_not_shorten_it() -> None:
    hold = Hold(releases=False)
    hold.take(LEFT, 0)
    hold.take(LEFT, 30 * NS_PER_MS)
    assert hold.look(TAP_NS - 1) is None
    assert hold.look(TAP_NS) is Grip.END
