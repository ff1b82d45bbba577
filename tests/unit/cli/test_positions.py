"""`tutti position …` and names where targets stand: what they print, and their exit codes."""

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.monitor.times import show_utc


@pytest.fixture
def world(monkeypatch: pytest.MonkeyPatch) -> Iterator[CommandWorld]:
    monkeypatch.setenv("TUTTI_UTC", "1")
    yield from open_world(monkeypatch)
    show_utc(wanted=False)


def test_a_position_is_saved_shown_used_and_removed(world: CommandWorld) -> None:
    for words in ("axis enable gantry stage", "axis home", "axis move gantry.x=12.5 stage.u=3mm"):
        world.done(*words.split())
    said = world.done(
        "position", "save", "sample", "gantry.x", "stage.u", "--at", "gantry.y=7mm", "--description", "a b"
    )
    assert said == "sample is saved: gantry.x 12.5 mm, gantry.y 7 mm, stage.u 3 mm"
    row = next(line for line in world.done("position", "ls").splitlines() if line.startswith("sample"))
    assert "gantry.x 12.5 mm" in row and "anna, 2026-01-01 " in row and "a b" in row
    (listed,) = [each for each in json.loads(world.done("position", "ls", "--json")) if each["name"] == "sample"]
    assert (listed["source"], listed["actor"], listed["axes"]["gantry.y"]) == ("saved", "anna", "7 mm")
    assert world.done("position", "show", "sample").splitlines()[1:3] == ["a b", "  gantry.x 12.5 mm"]
    world.done("axis", "move", "gantry.x=0", "gantry.y=0", "stage.u=0")
    assert world.done("position", "goto", "sample", "stage.u", "--speed", "1") == "stage.u 3.000 mm"
    assert world.done("position", "goto", "sample", "gantry") == "gantry.x 12.500 mm, gantry.y 7.000 mm"
    world.done("axis", "move", "gantry.x=0")
    assert world.done("axis", "move", "gantry.x=sample") == "gantry.x 12.500 mm"
    whole = json.loads(world.done("position", "goto", "sample", "--json"))
    assert list(whole["axes"]) == ["gantry.x", "gantry.y", "stage.u"]
    assert "position sample: gantry.x 12.5 mm" in world.done("job", "report", "last")
    assert "position sample: gantry.x 12.5 mm" in world.done("job", "show", "last")
    assert "sample" in json.loads(world.done("job", "report", "last", "--json"))["positions_used"]
    assert world.done("position", "rm", "sample") == "sample is removed"


def test_wrong_names_and_values_say_what_to_do(world: CommandWorld) -> None:
    world.done("position", "save", "sample", "--at", "gantry.x=5")
    for words, code, text in (
        ("position goto sampel", 2, "no position sampel; did you mean sample?"),
        ("position goto sample gantry.y", 1, "sample has no value for gantry.y; it has: gantry.x"),
        ("position goto sample stage", 1, "position sample has no axis of stage; it has: gantry.x"),
        ("position goto sample gantyr", 2, "no axis gantyr"),
        ("position show sampel", 2, "no position sampel; did you mean sample?"),
        ("position rm sampel", 2, "no position sampel; did you mean sample?"),
        ("axis move gantry.x=sampel", 2, "no position sampel; did you mean sample?"),
        ("axis move gantry.x=sample --relative", 2, "'sample' is not a quantity"),
        ("position save 5mm", 2, "'5mm' is no name of a position"),
        ("position save gantry", 2, "has the name of a controller"),
        ("position save x gantry.q", 2, "no axis, group or controller gantry.q"),
        ("position save x --at gantry.x", 2, "write AXIS=VALUE"),
        ("position save x --at gantry.x=5deg", 2, "deg is a unit of angle"),
        ("position save x gantry.x", 1, "axis gantry.x is not referenced"),
        ("position save x --at gantry.x=9999", 1, "beyond its soft limits"),
    ):
        assert text in world.refused(code, *words.split()), words


JOB = """schema: tutti.job/1
name: {name}
parameters:
  there: {{type: text, default: sample, choices: [sample, nowhere]}}
  width: {{type: quantity, unit: mm, default: 5 mm, max: 20 mm}}
steps:
  - {{do: move, to: {{gantry.x: "${{there}}"}}}}
  - {{do: move, by: {{gantry.x: "${{width}}"}}}}
"""


def test_parameters_and_positions_go_together_from_the_file_to_the_report(world: CommandWorld, tmp_path: Path) -> None:
    for words in ("axis enable gantry", "axis home gantry", "position save sample --at gantry.x=10"):
        world.done(*words.split())
    path = tmp_path / "x.job.yaml"
    path.write_text(JOB.format(name="a scan"), encoding="utf-8")
    said = world.done("submit", str(path), "--set", "width=12mm", "--wait")
    assert "parameters: there sample, width 12 mm" in said and "position sample: gantry.x 10 mm" in said
    assert "gantry.x=12 mm" in world.done("job", "show", "last")
    assert "parameters: there sample, width 12 mm" in world.done("job", "show", "last")
    world.done("job", "retry", "last", "--yes")
    world.let_pass(20)
    again = json.loads(world.done("job", "report", "last", "--json"))
    assert (again["state"], again["parameters_used"]) == ("done", {"there": "sample", "width": "12 mm"})
    assert "gantry.x=10 mm" in world.done("submit", str(path), "--dry-run")
    for words, text in (
        (("--set", "width=1deg", "--set", "ther=x"), "the parameter is in mm"),
        (("--set", "width"), "write NAME=VALUE"),
        (("--set", "width=1", "--set", "width=2"), "width is given twice"),
    ):
        assert text in world.refused(2, "submit", str(path), *words)
    assert "no position nowhere" in world.refused(2, "submit", str(path), "--set", "there=nowhere")
    missing = world.refused(2, "submit", str(path), "--set-file", str(tmp_path / "none.yaml"))
    assert "none.yaml:1: cannot be read" in missing
