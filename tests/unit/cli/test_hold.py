"""Whether a key is held, with and without reported releases."""

import pytest

from orchestrator.cli.manual.jog.held_key import (
    REPEAT_DELAY_NS,
    REPEAT_GAP_NS,
    REPEAT_WAIT_NS,
    SILENCE_NS,
    TAP_NS,
    HeldKey,
    KeyChange,
)
from orchestrator.cli.manual.jog.keys import KeyEvent
from orchestrator.clock.base import NS_PER_MS, NS_PER_S

LEFT, RIGHT = KeyEvent("left"), KeyEvent("right")


def test_a_reported_release_ends_the_hold_at_once() -> None:
    hold = HeldKey(releases=True)
    assert hold.handle_key(LEFT, 0) is KeyChange.BEGIN
    assert hold.handle_key(KeyEvent("left", "repeat"), NS_PER_S // 2) is None
    assert hold.check_time(NS_PER_S) is None
    assert hold.handle_key(KeyEvent("left", "release"), NS_PER_S) is KeyChange.END
    assert hold.check_time(9 * NS_PER_S) is None
    assert hold.handle_key(KeyEvent("left", "repeat"), 9 * NS_PER_S) is None
    assert hold.key is None


def test_a_silent_terminal_ends_it_too() -> None:
    hold = HeldKey(releases=True)
    hold.handle_key(LEFT, 0)
    hold.note_activity(SILENCE_NS // 2)
    assert hold.check_time(SILENCE_NS) is None
    assert hold.check_time(SILENCE_NS + SILENCE_NS // 2) is KeyChange.SILENT
    assert hold.key is None


def test_the_release_of_another_key_changes_nothing() -> None:
    hold = HeldKey(releases=True)
    hold.handle_key(LEFT, 0)
    assert hold.handle_key(RIGHT, 1) is KeyChange.BEGIN
    assert hold.handle_key(KeyEvent("left", "release"), 2) is None
    assert hold.key == "right"


@pytest.mark.parametrize(("delay_ms", "rate_hz"), [(250, 25), (500, 30), (660, 40), (375, 11)])
def test_repeats_hold_without_stutter(delay_ms: int, rate_hz: int) -> None:
    hold = HeldKey(releases=False)
    assert hold.handle_key(LEFT, 0) is KeyChange.BEGIN
    assert hold.check_time(TAP_NS) is KeyChange.END
    began_ns = delay_ms * NS_PER_MS
    assert hold.handle_key(LEFT, began_ns) is KeyChange.GO_ON
    for k in range(1, 40):
        at_ns = began_ns + k * NS_PER_S // rate_hz
        assert hold.check_time(at_ns - 1) is None
        assert hold.handle_key(LEFT, at_ns) is None
    assert hold.check_time(at_ns + REPEAT_WAIT_NS - 1) is None
    assert hold.check_time(at_ns + REPEAT_WAIT_NS) is KeyChange.END


def test_a_key_pressed_after_a_pause_is_a_new_press() -> None:
    hold = HeldKey(releases=False)
    hold.handle_key(LEFT, 0)
    hold.check_time(TAP_NS)
    assert hold.handle_key(LEFT, REPEAT_DELAY_NS + 1) is KeyChange.BEGIN
    hold.check_time(REPEAT_DELAY_NS + 1 + TAP_NS)
    again_ns = 2 * REPEAT_DELAY_NS
    assert hold.handle_key(LEFT, again_ns) is KeyChange.GO_ON
    hold.check_time(again_ns + REPEAT_WAIT_NS)
    assert hold.handle_key(LEFT, again_ns + REPEAT_GAP_NS + 1) is KeyChange.BEGIN


def test_another_key_is_always_a_new_press() -> None:
    hold = HeldKey(releases=False)
    hold.handle_key(LEFT, 0)
    assert hold.handle_key(RIGHT, 1) is KeyChange.BEGIN
    assert hold.handle_key(LEFT, 2) is KeyChange.BEGIN


def test_a_second_press_within_a_tap_does_not_shorten_it() -> None:
    hold = HeldKey(releases=False)
    hold.handle_key(LEFT, 0)
    hold.handle_key(LEFT, 30 * NS_PER_MS)
    assert hold.check_time(TAP_NS - 1) is None
    assert hold.check_time(TAP_NS) is KeyChange.END
