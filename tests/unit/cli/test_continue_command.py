"""`tutti job continue`: what is shown, what is asked for, and what is refused."""

import json
from pathlib import Path

import pytest
from unit.cli.command_world import CommandWorld, open_world

world = pytest.fixture(open_world)
PATH = (
    "schema: tutti.job/1\nname: bend\nsteps:\n"
    "  - {do: output, output: gantry.lamp, value: true}\n"
    "  - {do: path, axes: [gantry.x, gantry.y], start: [0, 0], tolerance: 100 um, speed: 10 mm/s,"
    " pieces: [{piece: line, to: [20, 0]}, {piece: line, to: [20, 20]}]}\n"
)


def stop_on_the_way(world: CommandWorld, folder: Path) -> None:
    """A job whose path an e-stop has ended some mm after its start; the axes are at 0 again."""
    path = folder / "bend.job.yaml"
    path.write_text(PATH)
    for words in (("axis", "enable", "gantry"), ("axis", "home", "gantry"), ("queue", "start"), ("submit", str(path))):
        world.done(*words)
    world.let_pass(1.5)
    client = world.fleet.make_client()
    world.wait(client.estop())
    world.let_pass(1)
    world.wait(client.reset())
    for words in (("axis", "enable", "gantry"), ("axis", "home", "gantry"), ("queue", "start")):
        world.done(*words)


def test_a_job_goes_on_after_two_confirmations(world: CommandWorld, tmp_path: Path) -> None:
    stop_on_the_way(world, tmp_path)
    assert "give --yes-move and --yes-start" in world.refused(2, "job", "continue", "bend", "--yes-move")
    found = json.loads(world.done("job", "continue", "bend", "--dry-run", "--json"))
    assert (found["piece"], found["outputs"]) == (1, {"gantry.lamp": True})
    shown = world.done("job", "continue", "bend", "--dry-run")
    assert "'bend' stood at step 2 (path), piece 1 of 2" in shown
    assert "the axes go back, straight and together:" in shown and "gantry.lamp is switched on" in shown
    assert "path of gantry.x gantry.y, 2 pieces" in shown
    printed = world.done("job", "continue", "bend", "--yes-move", "--yes-start")
    assert "'rest of bend'" in printed and "goes on with job" in printed
    world.let_pass(10)
    assert json.loads(world.done("job", "ls", "--json"))[0]["state"] == "done"
    assert "is done: nothing of it is left" in world.refused(1, "job", "continue", "last", "--dry-run")


def test_nothing_is_submitted_without_a_word(
    world: CommandWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stop_on_the_way(world, tmp_path)
    before = len(json.loads(world.done("job", "ls", "--json")))
    asked: list[str] = []

    def say(question: str) -> bool:
        asked.append(question)
        return len(asked) == 2

    monkeypatch.setattr("orchestrator.cli.jobs.continuing.is_terminal", lambda: True)
    monkeypatch.setattr("orchestrator.cli.jobs.continuing.confirm_shown", say)
    assert "nothing moves" in world.done("job", "continue", "bend")
    assert len(json.loads(world.done("job", "ls", "--json"))) == before
    asked.append("")
    assert "no job is submitted" in world.done("job", "continue", "bend", "--yes-move")
    assert asked == ["is the way free? move there?", "", "switch these outputs, and go on from there?"]
