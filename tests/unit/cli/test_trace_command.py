"""`tutti trace` against a fleet in virtual time."""

import json
from collections.abc import Iterator, Sequence
from typing import Any

import pytest
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.cli.view import trace as trace_module
from orchestrator.runtime.trace_frames import FrameList


def test_frames_are_shown_in_words_by_time_and_as_they_are(world: CommandWorld) -> None:
    lines = world.done("trace", "stage", "--last", "2s").splitlines()
    assert lines[0].endswith("is 0 s")
    (asked,) = [line for line in lines if "Q:SPC" in line][:1]
    assert asked.endswith("ask coordinates and states") and " s → Q:SPC" in asked
    assert all(-2.001 < float(line.split()[0]) <= 0 for line in lines[1:])
    raw = world.done("trace", "stage", "--last", "2s", "--raw").splitlines()
    assert any(line.endswith("→ Q:SPC\\r\\n") for line in raw) and not any("ask coordinates" in line for line in raw)


def test_programs_get_frames_beside_the_bytes(world: CommandWorld) -> None:
    found = json.loads(world.done("trace", "gantry", "--last", "1s", "--json"))
    assert found["make"] == "smc4000" and found["entries"]
    frame = next(each for each in found["frames"] if each["meaning"] == "ask data record")
    assert frame["direction"] == "out" and found["fleet_ns"] - 10**9 <= frame["fleet_ns"] <= found["fleet_ns"]


def test_following_shows_each_frame_once(world: CommandWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    shown: list[Sequence[Any]] = []

    def keep(reader: FrameList, reply: Any, *, as_json: bool) -> None:
        del as_json
        shown.append([(each.after_s, each.text) for each in reader.read_frames(reply)])
        if len(shown) == 4:
            raise SystemExit(130)

    monkeypatch.setattr(trace_module, "_print_frames", keep)
    assert world.run("trace", "stage", "--follow", "--last", "1s").exit_code == 130
    frames = [frame for part in shown for frame in part]
    assert all(shown) and frames == sorted(frames, key=lambda each: each[0])
    assert len(set(frames)) == len(frames)


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--last", "2min"), "at most 60s"),
        (("--follow", "--format", "asc", "--output", "x"), "--follow cannot be given"),
        (("--format", "asc"), "must be given together"),
    ],
)
def test_a_wrong_option_gets_a_message(world: CommandWorld, words: tuple[str, ...], text: str) -> None:
    assert text in world.refused(2, "trace", "stage", *words)


@pytest.fixture(scope="module")
def world() -> Iterator[CommandWorld]:
    with pytest.MonkeyPatch.context() as patch:
        yield from open_world(patch)
