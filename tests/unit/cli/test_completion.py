"""Completion in a shell: names of the running fleet, and silence without one."""

import asyncio
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
from click.shell_completion import ShellComplete
from click.testing import CliRunner
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.bus.zenoh.sessions import RouterUnreachable
from orchestrator.cli.base import completion
from orchestrator.cli.main import main


@pytest.fixture(scope="module")
def world() -> Iterator[CommandWorld]:
    with pytest.MonkeyPatch.context() as patch:
        opened = open_world(patch)
        world = next(opened)

        async def open_bus(*_: object) -> Any:
            return world.fleet.make_client("completion").bus

        patch.setattr("orchestrator.bus.zenoh.bus.open_bus", open_bus)
        patch.setattr(completion, "asyncio", SimpleNamespace(run=world.wait, timeout=asyncio.timeout))
        world.done("axis", "enable", "gantry")
        yield world
        next(opened, None)


def offered(line: str) -> list[str]:
    """What is offered for the last word of the line."""
    *words, begun = line.split(" ")
    return [each.value for each in ShellComplete(main, {}, "tutti", "_TUTTI_COMPLETE").get_completions(words, begun)]


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("axis enable ga", ["gantry.x", "gantry.y", "gantry"]),
        ("axis home ta", ["table"]),
        ("axis move gantry.x=1 stage.", ["stage.u=", "stage.v=", "stage.focus="]),
        ("io set ", ["gantry.lamp"]),
        ("io set gantry.lamp o", ["on", "off"]),
        ("sim input ", ["gantry.door", "gantry.touch"]),
        ("sim stall s", ["stage.u", "stage.v", "stage.focus"]),
        ("trace ", ["gantry", "stage"]),
        ("clock show s", ["stage"]),
        ("job show la", ["last"]),
        ("status --fleet ", ["demo"]),
        ("axis enable nope", []),
        ("compl", ["completion"]),
    ],
)
def test_names_of_the_fleet_are_offered(world: CommandWorld, line: str, names: list[str]) -> None:
    assert offered(line) == names


def test_jobs_are_offered_with_their_names(world: CommandWorld) -> None:
    last, job_id = ShellComplete(main, {}, "tutti", "_TUTTI_COMPLETE").get_completions(["job", "cancel"], "")
    assert (last.value, last.help) == ("last", "the newest job")
    assert job_id.help == "manual: enable"


@pytest.mark.parametrize("line", ["axis enable g", "io set ", "job show ", "status --fleet "])
def test_nothing_is_said_where_no_fleet_answers(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], line: str
) -> None:
    async def open_bus(*_: object) -> Any:
        raise RouterUnreachable("nothing there")

    monkeypatch.setattr("orchestrator.bus.zenoh.bus.open_bus", open_bus)
    assert offered(line) == []
    assert capsys.readouterr() == ("", "")


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_each_shell(shell: str) -> None:
    shown = CliRunner().invoke(main, ["completion", shell])
    assert shown.exit_code == 0
    assert f"_TUTTI_COMPLETE={shell}_complete" in shown.stdout
