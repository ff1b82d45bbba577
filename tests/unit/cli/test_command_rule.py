"""The rule of all commands: exit codes, and errors as JSON. Tested over every command, and on a fleet."""

import json
from collections.abc import Iterator

import click
import pytest
from click.testing import CliRunner
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.cli.main import main

# Commands that print no JSON, and why.
WITHOUT_JSON = {
    "axis jog": "a panel on a terminal",
    "completion": "what it prints is a script",
    "record start": "it records until it is interrupted",
    "router": "runs in the foreground; --print-config is JSON",
    "fleet expand": "what it prints is JSON already",
    "schema": "what it prints is JSON already",
}


def leaves() -> Iterator[tuple[str, click.Command]]:
    def walk(group: click.Command, words: list[str]) -> Iterator[tuple[str, click.Command]]:
        if not isinstance(group, click.Group):
            yield " ".join(words), group
            return
        context = click.Context(group)
        for name in group.list_commands(context):
            found = group.get_command(context, name)
            assert found is not None
            yield from walk(found, [*words, name])

    yield from walk(main, [])


def test_every_command_has_json_or_a_reason() -> None:
    without = {name for name, command in leaves() if "--json" not in [o for p in command.params for o in p.opts]}
    assert without == set(WITHOUT_JSON)


def test_an_option_of_the_root_command_behind_another_one_is_put_right() -> None:
    result = CliRunner().invoke(main, ["status", "--identity", "x", "--json"], prog_name="tutti")
    assert result.exit_code == 2
    assert json.loads(result.stdout)["remedy"] == "give it before the command: `tutti --identity …`"


@pytest.mark.parametrize("name", [name for name, _ in leaves() if name not in WITHOUT_JSON])
def test_a_wrong_option_is_bad_input_in_both_forms(name: str) -> None:
    for words in ([*name.split(), "--jsonn"], [*name.split(), "--jsonn", "--json"]):
        result = CliRunner().invoke(main, words, prog_name="tutti")
        assert result.exit_code == 2, (words, result.output)
    assert json.loads(result.stdout)["code"] == "bad-input"
    assert "--jsonn" in json.loads(result.stdout)["text"]
    assert not result.stderr


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["stattus"], "did you mean one of: 'stats', 'status'"),
        (["axis", "mvoe"], "did you mean 'move'"),
        (["move", "gantry.x=1"], "did you mean `tutti axis move`?"),
        (["jog", "gantry.x"], "did you mean `tutti axis jog` or `tutti bench jog`?"),
        (["enabel"], "did you mean `tutti axis enable`?"),
        (["job", "home"], "did you mean `tutti axis home`?"),
        (["axis", "disable"], "which motors are to be switched off?"),
        (["status", "--conect", "x"], "--connect"),
        (["status", "--connect", "garbage"], "'garbage' is not an endpoint"),
        (["status", "--connect", "tcp/127.0.0.1:99999"], "is not an endpoint"),
        (["status", "--connect", "tcp/127.0.0.1"], "is not an endpoint"),
        (["status", "--fleet", "No/Fleet"], "fleet 'No/Fleet'"),
        (["axis", "move", "gantry.x=10", "gantry.x=20"], "gantry.x is given twice, as 10.0 and as 20"),
        (["axis", "set-position", "gantry.x=1", "gantry.x=1"], "gantry.x is given twice"),
        (["axis", "set-position", "gantry.x=1", "--clear"], "with --clear"),
        (["axis", "move", "gantry.x"], "write AXIS=VALUE"),
        (["axis", "move", "gantry.x=nan"], "nan"),
        (["axis", "acquire", "gantry", "--for", "25h"], "at most 24h"),
        (["axis", "acquire", "gantry", "--what", "x" * 81], "at most 80"),
        (["job", "release"], "name jobs, or give --all"),
        (["job", "show", ""], "write the beginning of a job's id"),
        (["sim", "push", "gantry.x", "far"], "far"),
        (["fleet", "check", "/nowhere/x.yaml"], "/nowhere/x.yaml"),
        (["up", "/nowhere/x.yaml"], "/nowhere/x.yaml"),
        (["sim", "check", "shrc203", "/nowhere"], "/nowhere"),
        (["epics", "serve", "--interface", "0.0.0.0"], "have no users"),
        (["epics", "serve", "--interface", "lab-pc"], "lab-pc is not an address"),
    ],
)
def test_bad_input_needs_no_fleet(words: list[str], said: str) -> None:
    shown = CliRunner().invoke(main, words, prog_name="tutti")
    assert (shown.exit_code, shown.stdout) == (2, ""), shown.output
    assert said.lower() in shown.stderr.lower()
    assert "http" not in shown.stderr
    again = CliRunner().invoke(main, [*words, "--json"], prog_name="tutti")
    assert again.exit_code == 2
    assert said.lower() in json.loads(again.stdout)["text"].lower()


def test_an_unforeseen_error_has_no_traceback(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("TUTTI_DEBUG", raising=False)
    monkeypatch.setattr("orchestrator.cli.jobs.queue.with_fleet", lambda *_: [][0])
    shown = CliRunner().invoke(main, ["queue", "status"])
    assert shown.exit_code == 1
    assert "internal error: IndexError" in shown.stderr
    assert "Traceback" not in shown.output


@pytest.fixture(scope="module")
def world() -> Iterator[CommandWorld]:
    with pytest.MonkeyPatch.context() as patch:
        yield from open_world(patch)


@pytest.mark.parametrize(
    ("code", "command", "said"),
    [
        # A name that the fleet does not have.
        (2, "axis limits tabel", "did you mean table?"),
        (2, "axis enable nope", "the fleet has no axis, group or controller nope"),
        (2, "axis home gantri", "did you mean gantry"),
        (2, "axis move gantry.xx=10", "did you mean gantry.x"),
        (2, "axis move table=10", "the fleet has no axis table"),
        (2, "axis move gantry.x=5kg", "unknown unit 'kg'"),
        (2, "axis set-position gantry.x=5deg", "gantry.x: deg is a unit of"),
        (2, "axis acquire gantryy --for 1h", "did you mean gantry"),
        (2, "axis release nope", "nope"),
        (2, "trace nope", "the fleet has no controller nope; it has: gantry, stage"),
        (2, "clock show gantri", "did you mean gantry"),
        (2, "raw nope MG --i-know", "nope"),
        (2, "io set gantry.lampe on", "did you mean gantry.lamp?"),
        (2, "job show nope", "no job nope"),
        (2, "job cancel nope", "no job nope"),
        (2, "job hold nope", "no job nope"),
        (2, "job report last", "there is no job"),
        (2, "job retry nope --yes", "no job nope"),
        (2, "job plot nope", "no job nope"),
        (2, "reset nope", "no e-stop nope is latched"),
        # Nothing answers.
        (3, "status --fleet nope", "no fleet nope; there are: demo"),
        (3, "axis ls --fleet nope", "no fleet nope; there are: demo"),
        (3, "io ls --fleet nope", "no fleet nope; there are: demo"),
        (3, "stop --fleet nope", "no fleet nope; there are: demo"),
        (3, "reset --fleet nope", "no fleet nope; there are: demo"),
        (3, "clock ls --fleet nope", "no fleet nope; there are: demo"),
        (3, "job ls --fleet nope", "no fleet nope; there are: demo"),
        (3, "queue status --fleet nope", "no fleet nope; there are: demo"),
        (3, "axis move gantry.x=1 --fleet nope", "no fleet nope; there are: demo"),
        (3, "job show last --fleet nope", "no fleet nope; there are: demo"),
        # Refused by a running fleet.
        (1, "axis move gantry.x=10", "gantry.x is not enabled"),
        (1, "raw gantry MG", "--i-know"),
    ],
)
def test_a_command_that_is_refused(world: CommandWorld, code: int, command: str, said: str) -> None:
    words = world.refused(code, *command.split())
    assert said in words
    assert "job file" not in words
    assert "Refusal" not in words
