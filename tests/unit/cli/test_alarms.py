"""`tutti alarm …` and the line of `tutti status`: what they print, and their exit codes."""

import json
import re
from collections.abc import Iterator

import pytest
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.monitor.times import show_utc


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandWorld]:
    monkeypatch.setenv("TUTTI_UTC", "1")
    monkeypatch.setenv("COLUMNS", "200")
    yield from open_world(monkeypatch)
    show_utc(wanted=False)


def test_alarms_are_listed_acknowledged_and_shelved(world: CommandWorld) -> None:
    assert world.done("alarm", "ls") == "no alarms"
    assert "alarms:" not in world.done("status")
    world.fleet.wires["stage"].cut = True
    world.let_pass(15)
    shown = world.done("alarm", "ls")
    row = next(line for line in shown.splitlines() if "disconnected-stage" in line)
    assert row.split()[:2] == ["high", "unacknowledged"]
    assert "          stage is offline: no reply" in shown and "→ check" in shown
    assert "alarms: 2 high; 2 not acknowledged → `tutti alarm ls`" in world.done("status")
    assert world.done("alarm", "ack", "disconnected-stage") == "disconnected-stage: acknowledged"
    assert "alarms: 2 high; 1 not acknowledged" in world.done("status")
    listed = {each["id"]: each for each in json.loads(world.done("alarm", "ls", "--json"))}
    assert listed["disconnected-stage"]["acknowledged_by"] == "anna"
    said = world.done("alarm", "shelve", "disconnected-stage", "--for", "2h", "--why", "new cable")
    assert said.startswith("disconnected-stage is shelved until 2026-01-01 02:00:1") and said.endswith("Z")
    assert "shelved by anna until" in world.done("alarm", "ls") and ": new cable" in world.done("alarm", "ls")
    assert "alarms: 1 high; 1 not acknowledged" in world.done("status")
    assert world.done("alarm", "unshelve", "disconnected-stage") == "disconnected-stage: unacknowledged"
    assert len(world.done("alarm", "ack", "--all").splitlines()) == 2
    assert world.done("alarm", "ack", "--all") == "nothing had to be acknowledged"
    world.fleet.wires["stage"].cut = False
    world.let_pass(15)
    assert world.done("alarm", "ls") == "no alarms"
    assert "normal" in world.done("alarm", "ls", "--all")
    assert len(world.done("alarm", "ls", "--history", "3").splitlines()) == 1 + 2 * 3


def test_mistakes_say_what_to_do(world: CommandWorld) -> None:
    for words, code, text in (
        ("alarm ack", 2, "name alarms, or give --all"),
        ("alarm ack x --all", 2, "name alarms, or give --all"),
        ("alarm ack nothing", 2, "there is no alarm nothing"),
        ("alarm ack Nothing", 2, "alarm_ids.0: String should match pattern"),
        ("alarm shelve nothing --for 2d", 2, "2d is too long: at most 24h"),
        ("alarm shelve nothing --for 2", 2, "write a number and s, min, h, d or w"),
        ("alarm shelve nothing --for 1h", 2, "there is no alarm nothing"),
        ("alarm unshelve nothing", 2, "see `tutti alarm ls --all`"),
    ):
        assert text in world.refused(code, *words.split()), words


def test_statistics_are_tables_csv_and_json(world: CommandWorld) -> None:
    for words in ("axis enable gantry stage", "axis home", "axis move gantry.x=12.5 stage.u=3mm"):
        world.done(*words.split())
    shown = world.done("stats", "--since", "2026-01-01T00:00:00Z")
    rows = {line.split()[0]: line.split()[1:] for line in shown.splitlines() if line.strip()}
    assert rows["gantry.x"][:2] == ["1", "0"] and rows["stage.u"][2:4] == ["3", "mm"]
    assert re.search(r"^gantry +100\.00%", shown, re.MULTILINE) and rows["jobs:"] == ["3", "done"]
    assert shown.startswith("since 2026-01-01\n") and "gantry - stage" in shown
    lines = world.done("stats", "--since", "2026-01-01T00:00:00Z", "--csv").splitlines()
    assert lines[0] == "day,kind,subject,figure,value,unit" and "2026-01-01,axis,stage.u,distance,3.0,mm" in lines
    found = json.loads(world.done("stats", "--since", "2026-01-01T00:00:00Z", "--json", "--by-day"))
    assert found["total"]["jobs"] == {"done": 3} and [each["day"] for each in found["days"]] == ["2026-01-01"]
    assert world.done("stats", "--since", "2025-01-01T00:00:00Z", "--by-day").count("gantry.x") == 2
    assert "nothing was counted" in world.done("stats", "--since", "2026-02-01T00:00:00Z")
    both = world.run("stats", "--csv", "--json")
    assert both.exit_code == 2 and "choose one of --csv and --json" in both.stdout
