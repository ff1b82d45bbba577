"""`tutti submit --proposed`, `tutti job plan` and `approve`, `tutti command ls`: what they print, and their exit codes."""

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


@pytest.fixture
def proposal(world: CommandWorld, tmp_path: Path) -> str:
    """The id of a proposed job that moves to a saved position."""
    for words in ("axis enable gantry", "axis home gantry", "position save sample --at gantry.x=10"):
        world.done(*words.split())
    file = tmp_path / "move.job.yaml"
    file.write_text("schema: tutti.job/1\nname: of bob\nsteps:\n  - {do: move, to: sample}\n", encoding="utf-8")
    return json.loads(world.done("submit", str(file), "--proposed", "--json"))["job_id"]


def test_a_plan_is_shown_and_approved_by_the_first_digits_of_its_hash(world: CommandWorld, proposal: str) -> None:
    shown = world.done("job", "plan", proposal).splitlines()
    assert shown[0].startswith(f"job 'of bob' {proposal} of anna: waits for approval")
    assert shown[1] == "  1 move to sample"
    assert "  position sample of gantry.x: 10 mm" in shown and "  offset of gantry.x: 0 mm" in shown
    assert f"proposed; its plan: `tutti job plan {proposal}`" in world.done("job", "show", proposal)
    planned = json.loads(world.done("job", "plan", proposal, "--json"))
    assert planned["plan"]["hash"] == shown[-1] and planned["changed"] == []
    assert "waits for the approval of its plan" in world.refused(1, "job", "release", proposal)
    said = world.done("job", "approve", proposal, "--plan", shown[-1][:17])
    assert said == f"job 'of bob' {proposal} is approved: {shown[-1]}"
    world.let_pass(20.0)
    assert "done" in world.done("job", "show", proposal).splitlines()[0]


def test_a_plan_that_has_changed_is_not_approved(world: CommandWorld, proposal: str) -> None:
    seen = world.done("job", "plan", proposal).splitlines()[-1]
    world.done("position", "save", "sample", "--at", "gantry.x=11")
    assert "position sample of gantry.x was 10 mm, is 11 mm" in world.refused(
        1, "job", "approve", proposal, "--plan", seen
    )
    assert "is another one now" in world.refused(1, "job", "approve", proposal, "--plan", seen[:17])
    for wrong in ("abc", "sha256:xyz", "sha1:0123456789"):
        assert "is no hash of a plan" in world.refused(2, "job", "approve", proposal, "--plan", wrong)
    assert "give --plan or --yes" in world.refused(2, "job", "approve", proposal)
    assert "no job nothing" in world.refused(2, "job", "plan", "nothing")
    approved = world.done("job", "approve", proposal, "--yes").splitlines()
    assert "  position sample of gantry.x: 11 mm" in approved and "is approved" in approved[-1]


def test_a_proposal_cannot_be_one_that_must_not_wait(world: CommandWorld, tmp_path: Path) -> None:
    file = tmp_path / "wait.job.yaml"
    file.write_text("schema: tutti.job/1\nname: w\nsteps:\n  - {do: dwell, duration: 1 s}\n", encoding="utf-8")
    assert "waits for its approval" in world.refused(1, "submit", str(file), "--proposed", "--now")


def test_commands_are_listed_with_user_and_refusal(world: CommandWorld, proposal: str) -> None:
    world.refused(1, "job", "release", proposal)
    listed = json.loads(world.done("command", "ls", "--json"))
    assert [(each["verb"], each["refused"]) for each in listed[:2]] == [("release", "awaits-approval")] * 2
    rows = world.done("command", "ls", "--limit", "3").splitlines()
    assert rows[0].split() == ["time", "user", "command", "about", "refused"]
    assert " ".join(rows[3:]).split()[2:] == ["anna", "submit", proposal, "'of", "bob',", "proposed"]
    assert json.loads(world.done("command", "ls", "--before", "2026-01-01T00:00:00Z", "--json")) == []
