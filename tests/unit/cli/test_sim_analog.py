"""`tutti sim analog` writes its line to the pipe of the simulated controller."""

import os
from pathlib import Path

import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.model.jobs.files import load_fleet
from sim.link.world import EnvironmentChange

FLEET = Path(__file__).parents[3] / "deploy" / "examples" / "demo.fleet.yaml"


@pytest.fixture
def state(tmp_path: Path) -> Path:
    (tmp_path / "fleet.json").write_text(load_fleet(FLEET).model_dump_json(exclude_unset=True, by_alias=True))
    (tmp_path / "world").mkdir()
    return tmp_path


def test_the_line_sets_the_voltage(state: Path) -> None:
    pipe = state / "world" / "gantry"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        done = CliRunner().invoke(main, ["sim", "analog", "--state", str(state), "gantry", "1", "--", "-2.5"])
        assert done.exit_code == 0, done.output
        assert EnvironmentChange.model_validate_json(os.read(reader, 1000)).analog == (1, -2.5)
    finally:
        os.close(reader)


@pytest.mark.parametrize(
    "words", [["nope", "1", "2"], ["gantry", "0", "2"], ["gantry", "1", "x"], ["gantry", "1", "nan"]]
)
def test_wrong_arguments_are_refused(state: Path, words: list[str]) -> None:
    done = CliRunner().invoke(main, ["sim", "analog", "--state", str(state), *words])
    assert done.exit_code == 2, done.output
    assert "Traceback" not in done.output
