"""`tutti status` of many controllers, and of a part of a fleet."""

import json
from collections.abc import Iterator

import pytest
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.monitor import fleet_summary


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandWorld]:
    monkeypatch.setenv("COLUMNS", "200")
    yield from open_world(monkeypatch)


def test_many_controllers_are_summed_up_and_each_is_shown_on_request(
    world: CommandWorld, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = world.done("status")
    assert "velocity" in whole
    monkeypatch.setattr(fleet_summary, "MANY", 1)
    short = world.done("status")
    assert short.splitlines()[0] == "2 controllers: 2 idle"
    assert short.splitlines()[1:3] == ["1 off: gantry", "1 unreferenced: stage"] and "velocity" not in short
    assert world.done("status", "--all") == whole
    assert list(json.loads(world.done("status", "--json"))) == ["gantry", "stage"]


def test_names_patterns_and_modes_choose_what_is_shown(world: CommandWorld) -> None:
    def shown(*words: str) -> dict[str, list[str]]:
        states = json.loads(world.done("status", *words, "--json"))
        return {name: list(state["axes"]) for name, state in states.items()}

    everything = shown()
    assert shown("gan*") == {"gantry": everything["gantry"]}
    assert shown("gantry.x", "stage") == {"gantry": ["x"], "stage": everything["stage"]}
    assert shown("*.x") == {name: ["x"] for name, axes in everything.items() if "x" in axes}
    assert shown("--mode", "idle") == everything
    assert shown("--mode", "fault") == {}
    assert "no controller is in the mode fault" in world.done("status", "--mode", "fault")
    assert "gantry" in world.refused(BAD_INPUT, "status", "gantri")
    assert "for example hall-1*" in world.refused(BAD_INPUT, "status", "[a]")
    assert world.run("status", "--mode", "ill").exit_code == BAD_INPUT
