"""The lines of several log files in the order of fleet time, and a tail that survives rotation."""

import json
import os
from io import StringIO
from pathlib import Path
from random import Random
from typing import Any

import pytest
from rich.console import Console

from orchestrator.bus.logfile import LogFile, rotate_files
from orchestrator.clock.utc import format_utc_ns
from orchestrator.monitor.logs.files import LogFolder
from orchestrator.monitor.logs.filter import LogFilter
from orchestrator.monitor.logs.line import LogLine, parse_line
from orchestrator.monitor.logs.placing import PlacedLine, place_lines
from orchestrator.monitor.logs.words import LineLayout, make_plain_line

S = 1_000_000_000
NOON = 1_800_000_000 * S


def line(file: str, number: int, utc_ns: int | None, fleet_ns: int | None, **fields: Any) -> LogLine:
    return LogLine(file, utc_ns, fleet_ns, fields={"number": number, **fields})


def numbers(placed: list[PlacedLine]) -> list[int]:
    return [each.line.fields["number"] for each in placed]


@pytest.mark.parametrize("seed", range(40))
def test_lines_are_in_the_order_in_which_they_were_written(seed: int) -> None:
    """Of three files, over a step of the wall clock, with lines of every kind."""
    random = Random(seed)
    step_at, step_ns = random.randrange(80), random.choice([-3600, -5, -1, 1, 5, 3600]) * S
    files: dict[str, list[LogLine]] = {"a": [], "b": [], "c": []}
    fleet_ns = 0
    for number in range(80):
        fleet_ns += random.randrange(1_000_000, S)
        utc_ns = NOON + fleet_ns + (step_ns if number >= step_at else 0) + random.randrange(20_000)
        # Near the step every line has both times: without, no place is certain.
        whole = abs(number - step_at) < 3 or number < 3 or number > 76 or random.random() < 0.7
        name = "abc"[number % 3]
        files[name].append(line(name, number, utc_ns, fleet_ns if whole else None))
    assert numbers(place_lines(files, {})) == list(range(80))


def test_without_fleet_time_a_step_of_the_wall_clock_would_change_the_order() -> None:
    """The seeded test above rests on fleet time alone."""
    files = {"a": [line("a", 0, NOON, None)], "b": [line("b", 1, NOON - S, None)]}
    assert numbers(place_lines(files, {})) == [1, 0]


def test_a_line_without_fleet_time_stays_between_its_neighbours() -> None:
    """The wall clock was set back by an hour before the second line, or after it."""
    for utc_ns in (NOON + 2 * S, NOON + 2 * S - 3600 * S):
        files = {
            "a": [
                line("a", 1, NOON + S, S),
                line("a", 2, utc_ns, None),
                line("a", 3, NOON + 3 * S - 3600 * S, 3 * S),
            ],
            "b": [line("b", 0, NOON + S // 2, S // 2), line("b", 4, NOON + 4 * S - 3600 * S, 4 * S)],
        }
        assert numbers(place_lines(files, {})) == [0, 1, 2, 3, 4]


def test_fleet_time_begins_anew_with_another_scale() -> None:
    later = NOON + 1000 * S
    files = {
        "a": [line("a", 0, NOON + 50 * S, 50 * S), line("a", 2, later - S, None), line("a", 3, later + S, S)],
        "b": [line("b", 1, NOON + 60 * S, 60 * S), line("b", 4, later + 2 * S, 2 * S)],
    }
    assert numbers(place_lines(files, {})) == [0, 1, 2, 3, 4]


def test_lines_without_any_time_stay_behind_the_line_before_them() -> None:
    files = {
        "a": [line("a", 0, NOON, 0), line("a", 1, None, None), line("a", 3, NOON + 2 * S, 2 * S)],
        "b": [line("b", 2, NOON + S, S)],
        "host.err": [line("host.err", 4, None, None)],
    }
    placed = place_lines(files, {"host.err": NOON + 3 * S})
    assert numbers(placed) == [0, 1, 2, 3, 4]
    assert placed[-1].at_ns == NOON + 3 * S


def write(log: LogFile, text: str, second: int, **fields: Any) -> None:
    entry = {"utc": format_utc_ns(NOON + second * S), "fleet_ns": second * S, "level": "info", "text": text}
    log.append_line(json.dumps(entry | fields))


def texts(lines: list[PlacedLine]) -> list[str]:
    return [each.line.fields.get("text") or each.line.raw for each in lines]


def test_a_tail_survives_rotation_and_finds_new_files(tmp_path: Path) -> None:
    path = tmp_path / "host-lab.jsonl"
    log = LogFile(path)
    write(log, "one", 1, role="host", id="lab")
    rotate_files(path)
    write(log, "two", 2, role="host", id="lab")
    folder = LogFolder(tmp_path)
    assert texts(folder.read_all()) == ["one", "two"]
    assert folder.read_added() == []
    write(log, "three", 3)
    rotate_files(path)
    write(log, "four", 4)
    other = LogFile(tmp_path / "coordinator.jsonl")
    write(other, "between", 3)
    assert texts(folder.read_added()) == ["three", "between", "four"]
    rotate_files(path)
    assert folder.read_added() == []
    write(log, "five", 5)
    assert texts(folder.read_added()) == ["five"]
    for each in (folder, log, other):
        each.close()


def test_a_line_that_is_being_written_is_read_when_it_is_whole(tmp_path: Path) -> None:
    path = tmp_path / "host-lab.err"
    path.write_text("first\nsec")
    folder = LogFolder(tmp_path)
    assert texts(folder.read_all()) == ["first"]
    with path.open("a") as file:
        file.write("ond\n")
    assert texts(folder.read_added()) == ["second"]
    os.truncate(path, 0)  # as a file is rotated that another process has open
    with path.open("a") as file:
        file.write("3\n")
    assert texts(folder.read_added()) == ["3"]
    folder.close()


@pytest.mark.parametrize(
    "text",
    ["", "{", "[]", "null", "1", '{"utc": 1}', '{"utc": "now"}', '{"fleet_ns": "1"}', '{"utc": "2026-01-01T00:00:00"}',
     "[" * 100_000, "\ufffd\x1b[2J", '{"utc": "9999-99-99T00:00:00Z"}'],
)  # fmt: skip
def test_a_damaged_line_keeps_its_text(text: str) -> None:
    found = parse_line("host-lab", text)
    assert found.damaged and found.raw == text and found.level == "warning"
    assert make_plain_line(PlacedLine(NOON, found))["raw"] == text


def test_a_filter_keeps_what_passes_all_of_its_conditions() -> None:
    lines = [
        PlacedLine(NOON, parse_line("host-lab", json.dumps(entry)))
        for entry in (
            {"level": "info", "text": "0", "controller": "gantry", "job": "3f2a91c0"},
            {"level": "warning", "text": "1", "controller": "gantry"},
            {"level": "info", "text": "2", "controller": "stage", "kind": "fault"},
            {"level": "warning", "text": "3", "holder": "3f2a91c0"},
            {"level": "info", "text": "4", "role": "controller", "id": "gantry"},
        )
    ]

    def kept(wanted: LogFilter) -> str:
        return "".join(texts([each for each in lines if wanted.accepts(each)]))

    assert kept(LogFilter()) == "01234"
    assert kept(LogFilter(job="3f2a")) == "03"
    assert kept(LogFilter(controller="gantry")) == "014"
    assert kept(LogFilter(level="warning")) == "123"
    assert kept(LogFilter(controller="gantry", level="warning")) == "1"
    assert kept(LogFilter(since_ns=NOON + 1)) == ""


def test_a_line_has_no_control_characters_and_no_colour_without_reason() -> None:
    entry = {"level": "info", "text": "ok", "controller": "gantry", "answer": "\x1b[2J", "trace": ["a", "b"]}
    calm = PlacedLine(NOON, parse_line("host-lab", json.dumps(entry)))
    alarm = PlacedLine(NOON, parse_line("host-lab", json.dumps(entry | {"level": "warning"})))
    console = Console(file=StringIO(), width=200, force_terminal=True, color_system="standard")
    layout = LineLayout([calm])
    for each in (calm, alarm):
        console.print(layout.format_line(each))
    first, second = console.file.getvalue().splitlines()  # type: ignore[attr-defined]
    assert "\x1b[33m" not in first and "\x1b[33m" in second
    assert "\x1b[2J" not in first and "answer=\\x1b[2J" in first and "trace=[2]" in first
