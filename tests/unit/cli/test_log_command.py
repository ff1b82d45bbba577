"""`tutti log`: the lines of a state folder, for people and for programs."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.cli.view import log as log_module


def run(*words: str) -> tuple[int, str, str]:
    result = CliRunner().invoke(main, ["log", *words], prog_name="tutti")
    return result.exit_code, result.stdout, result.stderr


def entry(second: int, text: str, **fields: Any) -> str:
    utc = f"2020-11-26T10:00:{second:02}.000000Z"
    return json.dumps({"utc": utc, "fleet_ns": second * 10**9, "level": "info", "text": text, **fields}) + "\n"


@pytest.fixture
def state(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The state folder of a fleet `lab` that does not run."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    folder = tmp_path / "tutti" / "lab" / "log"
    folder.mkdir(parents=True)
    coordinator = [entry(1, "leads the fleet"), "{damaged\n", entry(5, "job is done", job="3f2a91c0")]
    (folder / "coordinator.jsonl").write_text("".join(coordinator))
    host = [entry(2, "online", controller="gantry"), entry(3, "busy", level="warning", controller="stage")]
    (folder / "host-lab.jsonl").write_text("".join(host))
    return folder.parent


def test_the_logs_of_the_only_fleet_are_found_although_it_does_not_run(state: Path) -> None:
    code, shown, said = run("--utc")
    assert code == 0
    assert [line.split("Z")[0] for line in shown.splitlines()] == [
        f"2020-11-26 10:00:0{second}.000" for second in (1, 1, 2, 3, 5)
    ]
    assert "{damaged" in shown.splitlines()[1]
    assert said == "1 damaged lines in coordinator, shown as they are\n"
    assert run("--utc", "--fleet", "lab")[1] == run("--utc", "--state", str(state))[1] == shown


def test_lines_are_selected(state: Path) -> None:
    def selected(*words: str) -> list[str]:
        code, shown, _ = run("--json", "--state", str(state), *words)
        assert code == 0
        return [found.get("text") or found["raw"] for found in map(json.loads, shown.splitlines())]

    assert selected("--job", "3f2a") == ["job is done"]
    assert selected("--controller", "gantry") == ["online"]
    assert selected("--level", "warning") == ["{damaged", "busy"]
    assert selected("--last", "2") == ["busy", "job is done"]
    assert selected("--since", "1s") == []


@pytest.mark.parametrize(
    ("words", "code", "text"),
    [
        (["--state", "/nowhere"], 2, "/nowhere has no logs"),
        (["--fleet", "other"], 2, "other has no logs"),
        (["--job", "last"], 3, "no fleet answers"),
        (["--since", "10m"], 2, "min"),
        (["--level", "error"], 2, "warning"),
    ],
)
def test_a_wrong_choice_gets_a_message(state: Path, words: list[str], code: int, text: str) -> None:
    del state
    found, shown, said = run(*words)
    assert (found, shown) == (code, "") and text in said and "Traceback" not in said


def test_several_fleets_are_a_question(state: Path) -> None:
    (state.parent / "two" / "log").mkdir(parents=True)
    code, _, said = run()
    assert code == 2 and "several fleets have logs: lab, two" in said


def test_following_continues_with_new_lines_until_it_is_interrupted(
    state: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pauses: list[float] = []

    def write_or_interrupt(duration_s: float) -> None:
        pauses.append(duration_s)
        if len(pauses) > 2:
            raise KeyboardInterrupt
        with (state / "log" / "host-lab.jsonl").open("a") as file:
            file.write(entry(6 + len(pauses), f"new {len(pauses)}", controller="gantry"))

    monkeypatch.setattr(log_module.time, "sleep", write_or_interrupt)
    code, shown, _ = run("--follow", "--json", "--controller", "gantry")
    assert code == 130
    texts = [json.loads(line)["text"] for line in shown.splitlines() if line.startswith('{"at"')]
    assert texts == ["online", "new 1", "new 2"]
    assert min(pauses) > 0.1
