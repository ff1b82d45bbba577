"""Bytes of terminals as keys."""

from random import Random

import pytest

from orchestrator.cli.jog.keys import DeviceAttributes, Event, Focus, Key, KeyboardFlags, KeyParser

CASES: list[tuple[bytes, list[Event]]] = [
    (b"\x1b[D", [Key("left")]),
    (b"\x1bOC", [Key("right")]),
    (b"\x1b[1;2A", [Key("up")]),
    (b"\x1b[1;1:1D", [Key("left", "press")]),
    (b"\x1b[1;1:2D", [Key("left", "repeat")]),
    (b"\x1b[1;1:3D", [Key("left", "release")]),
    (b"\x1b[1;130:3B", [Key("down", "release")]),
    (b"\x1b[57417;1:3u", [Key("left", "release")]),
    (b"\x1b[57403u", [Key("4")]),
    (b"\x1b[27u", [Key("escape")]),
    (b"\x1b[99;5u", [Key("ctrl+c")]),
    (b"\x1b[99;69u", [Key("ctrl+c")]),
    (b"\x1b[122;5:3u", [Key("ctrl+z", "release")]),
    (b"\x1b[97:65;2u", [Key("A")]),
    (b"\x1b[32;1:3u", [Key("space", "release")]),
    (b"q 1+!", [Key("q"), Key("space"), Key("1"), Key("+"), Key("!")]),
    (b"\x03\x1a\r\x7f", [Key("ctrl+c"), Key("ctrl+z"), Key("enter"), Key("backspace")]),
    ("äµ".encode(), [Key("ä"), Key("µ")]),
    (b"\x1bq", [Key("alt+q")]),
    (b"\x1b\x1b[C", [Key("escape"), Key("right")]),
    (b"\x1b[I\x1b[O", [Focus(True), Focus(False)]),
    (b"\x1b[?3u\x1b[?62;22c", [KeyboardFlags(3), DeviceAttributes()]),
    (b"\x1b[?0u", [KeyboardFlags(0)]),
    # Passed over, without harm to what follows.
    (b"\x1b[15~\x1b[1;5Pq", [Key("q")]),
    (b"\x1b[\x1b[D", [Key("left")]),
    (b"\x1b[1;\xffq", [Key("q")]),
    (b"\xffq", [Key("q")]),
    (b"\xc3q", [Key("q")]),
    (b"\x1b]11;rgb:s/!/q\x07q", [Key("q")]),
    (b"\x1bP1+r\x1b[D\x1b\\q", [Key("left"), Key("alt+\\"), Key("q")]),
    (b"\x1b_Gi=1;OK\x1b\\q", [Key("q")]),
    (b"\x1b[1;1:9Dq", [Key("q")]),
    (b"\x1b[?1;2$yq", [Key("q")]),
    (b"\x00q", [Key("q")]),
]


@pytest.mark.parametrize(("data", "events"), CASES)
def test_sequences(data: bytes, events: list[Event]) -> None:
    parser = KeyParser()
    assert parser.feed(data) == events
    assert not parser.waiting


@pytest.mark.parametrize(("data", "events"), CASES)
def test_in_pieces(data: bytes, events: list[Event]) -> None:
    parser = KeyParser()
    assert [event for byte in data for event in parser.feed(bytes([byte]))] == events


def test_escape_is_a_key_when_nothing_follows() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b") == []
    assert parser.waiting
    assert parser.expire() == [Key("escape")]
    assert not parser.waiting
    assert parser.expire() == []


def test_a_sequence_that_is_cut_off_is_no_key() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b[1;") == []
    assert parser.expire() == []
    assert parser.feed(b"q") == [Key("q")]


def test_garbage_without_end_is_dropped() -> None:
    parser = KeyParser()
    assert parser.feed(b"\x1b]" + b"x" * 1000) == []
    assert not parser.waiting


def test_no_bytes_are_too_wild() -> None:
    draw = Random(5)
    parser = KeyParser()
    for _ in range(3000):
        parser.feed(bytes(draw.choice(b"\x1b[O]P;:?0123DuqcI\xff\xc3\x07\\") for _ in range(draw.randrange(12))))
        parser.expire()
    assert parser.feed(b"\x1b[D") == [Key("left")]
