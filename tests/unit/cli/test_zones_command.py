"""`tutti zones check`: what it lists, and what it says of files and positions that do not fit."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner, Result

from orchestrator.cli.main import main as command

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"


def check(*options: str, file: str = "zones.fleet.yaml") -> Result:
    return CliRunner().invoke(command, ["zones", "check", str(EXAMPLES / file), *options])


def test_it_lists_bodies_rules_distances_and_what_is_not_checked() -> None:
    result = check()
    assert result.exit_code == 0, result.output
    for words in (
        "3 bodies, 4 rules",
        "sample: rides on stage.u, stage.phi",
        "detector-sample: holds: detector and sample are 160 mm apart, and must be 5 mm apart",
        "not checked yet: jogs of axes without a reference, ",
        "order of homing, where no axis has a reference: none; home some of them",
        "no safety function",
    ):
        assert words in result.output


def test_a_rule_that_is_broken_at_positions_ends_it_with_1() -> None:
    result = check("--at", "gantry.x=15.6 cm", "--json")
    assert result.exit_code == 1
    rules = json.loads(result.output)["rules"]
    assert rules["detector-sample"]["holds"] is False and rules["column"]["holds"] is True
    assert rules["detector-sample"]["distance_mm"] == pytest.approx(4.0, abs=1e-6)
    assert "BROKEN: detector and sample touch" in check("--at", "gantry.x=200").output
    relation = check("--at", "stage.phi=50", "--json")
    assert json.loads(relation.output)["rules"]["low-detector"]["holds"] is False


@pytest.mark.parametrize(
    ("options", "file", "words"),
    [
        ((), "demo.fleet.yaml", "has no `zones`"),
        (("--at", "gantry.q=1"), "zones.fleet.yaml", "the fleet has no axis gantry.q; did you mean gantry.z?"),
        (("--at", "gantry.x=1deg"), "zones.fleet.yaml", "deg is a unit of angle"),
        (("--at", "gantry.x"), "zones.fleet.yaml", "write AXIS=VALUE"),
    ],
)
def test_bad_input_is_said_and_ends_it_with_2(options: tuple[str, ...], file: str, words: str) -> None:
    result = check(*options, file=file)
    assert result.exit_code == 2 and words in result.output


def test_it_draws_the_zones_and_marks_what_is_broken(tmp_path: Path) -> None:
    def plot(*options: str, file: str = "zones.fleet.yaml") -> Result:
        return CliRunner().invoke(command, ["zones", "plot", str(EXAMPLES / file), *options])

    picture = tmp_path / "zones.svg"
    result = plot("--at", "stage.phi=30", "-o", str(picture))
    assert result.exit_code == 0 and str(picture) in result.output
    assert picture.read_text(encoding="utf-8").startswith("<?xml")
    assert plot("--at", "gantry.x=158", "--at", "stage.phi=50", "-o", str(picture)).exit_code == 1
    missing = plot("-o", str(tmp_path / "no-such" / "zones.png"))
    assert missing.exit_code == 1 and "cannot be written" in missing.output
    assert plot("--at", "gantry.w=1", "-o", str(picture)).exit_code == 2
    none = plot("-o", str(picture), file="demo.fleet.yaml")
    assert none.exit_code == 2 and "has no `zones`" in none.output
