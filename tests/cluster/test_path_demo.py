"""`tutti demo --path`: it is done, within its bound, and its picture is written."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from orchestrator.cli.main import main
from orchestrator.runtime.virtual.path_demo import measure_distances


def test_the_figure_of_eight_stays_within_its_bound(tmp_path: Path) -> None:
    picture = tmp_path / "eight.png"
    shown = CliRunner().invoke(main, ["demo", "--path", "--json", "-o", str(picture)])
    assert shown.exit_code == 0, shown.output
    found = json.loads(shown.stdout)
    bound = found["path"]["bound"]
    assert found["state"] == "done" and found["truth"]["within_bound"] and found["truth"]["instants"] > 500
    assert found["truth"]["largest"] < bound["proven"] <= bound["predicted"] < bound["tolerance"]
    # By the controllers themselves, all the way.
    assert set(found["samples"]) == {"gantry.x", "slide.y", "lift.z"} and min(found["samples"].values()) > 300
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_a_picture_needs_the_path() -> None:
    shown = CliRunner().invoke(main, ["demo", "-o", "a.png"])
    assert shown.exit_code == 2 and "add --path" in shown.output


def test_distances_are_those_from_the_lines_between_points() -> None:
    course = np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 10.0]])
    found = measure_distances(np.array([[5.0, 2.0], [12.0, 5.0], [-3.0, 4.0]]), course)
    assert found == pytest.approx([2.0, 2.0, 5.0])
