"""Bytes of terminals as keys."""

from random import Random

import pytest

from orchestrator.cli.manual.jog.keys import (
    DeviceAttributes,
    FocusChange,
    KeyboardFlags,
    KeyEvent,
    KeyParser,
    TerminalEvent,
)

CASES: list[tuple[bytes, list[TerminalEvent]]] = [
    (b"\x1b[D", [KeyEvent("left")]),
    (b"\x1bOC", [KeyEvent("right")]),
    (b"\x1b[1;2A", [KeyEvent("up")]),
    (b"\x1b[1;1:1D", [KeyEvent("left", "press")]),
    (b"\x1b[1;1:2D", [KeyEvent("left", "repeat")]),
    (b"\x1b[1;1:3D", [KeyEvent("left", "release")]),
    (b"\x1b[1;130:3B", [KeyEvent("down", "release")]),
    (b"\x1b[57417;1:3u", [KeyEvent("left", "release")]),
    (b"\x1b[57403u", [KeyEvent("4")]),
    (b"\x1b[27u", [KeyEvent("escape")]),
    (b"\x1b[99;5u", [KeyEvent("ctrl+c")]),
    (b"\x1b[99;69u", [KeyEvent("ctrl+c")]),
    (b"\x1b[122;5:3u", [KeyEvent("ctrl+z", "release")]),
    (b"\x1b[97:65;2u", [KeyEvent("A")]),
    (b"\x1b[32;1:3u", [KeyEvent("space", "release")]),
    (b"q 1+!", [KeyEvent("q"), KeyEvent("space"), KeyEvent("1"), KeyEvent("+"), KeyEvent("!")]),
    (b"\x03\x1a\r\x7f", [KeyEvent("ctrl+c"), KeyEvent("ctrl+z"), KeyEvent("enter"), KeyEvent("backspace")]),
    ("äµ".encode(), [KeyEvent("ä"), KeyEvent("µ")]),
    (b"\x1bq", [KeyEvent("alt+q")]),
    (b"\x1b\x1b[C", [KeyEvent("escape"), KeyEvent("right")]),
    (b"\x1b[I\x1b[O", [FocusChange(True), FocusChange(False)]),
    (b"\x1b[?3u\x1b[?62;22c", [KeyboardFlags(3), DeviceAttributes()]),
    (b"\x1b[?0u", [KeyboardFlags(0)]),
    # Passed over, without harm to what follows.
    (b"\x1b[15~\x1b[1;5Pq", [KeyEvent("q")]),
    (b"\x1b[\x1b[D", [KeyEvent("left")]),
    (b"\x1b[1;\xffq", [KeyEvent("q")]),
    (b"\xffq", [KeyEvent("q")]),
    (b"\xc3q", [KeyEvent("q")]),
    (b"\x1b]11;rgb:s/!/q\x07q", [KeyEvent("q")]),
    (b"\x1bP1+r\x1b[D\x1b\\q", [KeyEvent("left"), KeyEvent("alt+\\"), KeyEvent("q")]),
    (b"\x1b_Gi=1;OK\x1b\\q", [KeyEvent("q")]),
    (b"\x1b[1;1:9Dq", [KeyEvent("q")]),
    (b"\x1b[?1;2$yq", [KeyEvent("q")]),
    (b"\x00q", [KeyEvent("q")]),
]


@pytest.mark.parametrize(("data", "events"), CASES)
def test_sequences(data: bytes, events: list[TerminalEvent]) -> None:
    parser = KeyParser()
    assert parser.parse_bytes(data) == events
    assert not parser.is_incomplete


@pytest.mark.parametrize(("data", "events"), CASES)
def test_in_pieces(data: bytes, events: list[TerminalEvent]) -> None:
    parser = KeyParser()
    assert [event for byte in data for event in parser.parse_bytes(bytes([byte]))] == events


def test_escape_is_a_key_when_nothing_follows() -> None:
    parser = KeyParser()
    assert parser.parse_bytes(b"\x1b") == []
    assert parser.is_incomplete
    assert parser.expire_sequence() == [KeyEvent("escape")]
    assert not parser.is_incomplete
    assert parser.expire_sequence() == []


def test_a_sequence_that_is_cut_off_is_no_key() -> None:
    parser = KeyParser()
    assert parser.parse_bytes(b"\x1b[1;") == []
    assert parser.expire_sequence() == []
    assert parser.parse_bytes(b"q") == [KeyEvent("q")]


def test_garbage_without_end_is_dropped() -> None:
    parser = KeyParser()
    assert parser.parse_bytes(b"\x1b]" + b"x" * 1000) == []
    assert not parser.is_incomplete


def test_any_bytes_are_accepted() -> None:
    draw = Random(5)
    parser = KeyParser()
    for _ in range(3000):
        parser.parse_bytes(bytes(draw.choice(b"\x1b[O]P;:?0123DuqcI\xff\xc3\x07\\") for _ in range(draw.randrange(12))))
        parser.expire_sequence()
    assert parser.parse_bytes(b"\x1b[D") == [KeyEvent("left")]
