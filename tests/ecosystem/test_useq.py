"""Sequences of useq-schema as jobs, run on the demo fleet."""

import json
import os
import sys
from pathlib import Path
from subprocess import CompletedProcess, run
from typing import Any

import pytest
import yaml
from click.testing import CliRunner
from pages import read_blocks
from useq import GridRowsColumns, MDASequence

from integrations.useq.mapping import read_mapping
from integrations.useq.steps import UnmappedSequence, make_steps
from orchestrator.cli.main import main
from tutti.testing import LiveTestbed, find_example

ROOT = Path(__file__).parents[2]
MAP = ["x=gantry.x,y=gantry.y,z=stage.u,camera=gantry.lamp,channel.DAPI=gantry.laser"]
SEQUENCE: dict[str, Any] = {
    "stage_positions": [(10, 5, 1), (20, 6, 2)],
    "z_plan": {"range": 1, "step": 1},
    "channels": [{"config": "DAPI", "exposure": 10}],
    "time_plan": {"interval": 2, "loops": 2},
    "axis_order": "tpcz",
}


def convert(file: Path, *words: str) -> CompletedProcess[str]:
    call = "from orchestrator.cli.entry import main; main()"
    command = [sys.executable, "-c", call, "job", "from-useq", str(file), *words]
    return run(command, capture_output=True, text=True, check=False)


def test_a_sequence_is_written_as_a_job_and_run(demo_fleet: LiveTestbed, tmp_path: Path) -> None:
    file, target = tmp_path / "exp.yaml", tmp_path / "exp.job.yaml"
    file.write_text(yaml.safe_dump(json.loads(MDASequence(**SEQUENCE).model_dump_json(exclude_unset=True))))
    words = ["--map", MAP[0].replace(",channel.DAPI=gantry.laser", ""), "--ignore", "channel.DAPI", "--json"]
    written = convert(file, *words, "-o", str(target))
    assert json.loads(written.stdout)["points"] == 8, written
    report = demo_fleet.tutti.submit(target).result()
    assert report.state == "done", report.reason
    assert sum(step.scan.done for step in report.steps if step.scan) == 8
    again = convert(file, *words, "-o", str(target))
    assert again.returncode == 2 and "is there already" in json.loads(again.stdout)["text"]


def test_a_grid_is_one_scan_between_its_channels() -> None:
    grid = GridRowsColumns(rows=2, columns=2, fov_width=1, fov_height=1)
    sequence = MDASequence(stage_positions=[(10, 5)], grid_plan=grid, channels=[{"config": "DAPI", "exposure": 10}])
    steps = make_steps(sequence, read_mapping([MAP[0].replace("z=stage.u,", "")], []), None)
    assert [step["do"] for step in steps] == ["output", "scan", "output"]
    assert len(steps[1]["points"]["rows"]) == 4 and steps[1]["points"]["rows"][0] == [9.5, 5.5]
    assert steps[1]["at_each"] == [{"do": "output", "output": "gantry.lamp", "value": True, "pulse": "10 ms"}]


@pytest.mark.parametrize(
    ("fields", "entries", "said"),
    [
        ({}, ["x=gantry.x,y=gantry.y,z=stage.u"], "camera=CONTROLLER.OUTPUT"),
        ({}, ["x=gantry.x,y=gantry.y,camera=gantry.lamp,channel.DAPI=gantry.laser"], "z=CONTROLLER.AXIS"),
        ({"channels": ["Cy5"]}, MAP, "channel.Cy5"),
        ({"channels": ["DAPI"]}, MAP, "no exposure of channel DAPI"),
        ({"autofocus_plan": {"autofocus_motor_offset": 5, "axes": ("p",)}}, MAP, "autofocus"),
        ({"stage_positions": [{"x": 1}]}, MAP, "no y"),
    ],
)
def test_what_a_sequence_has_and_nothing_stands_for_is_named(
    fields: dict[str, Any], entries: list[str], said: str
) -> None:
    with pytest.raises(UnmappedSequence, match=said):
        make_steps(MDASequence(**(SEQUENCE | fields)), read_mapping(entries, []), None)


@pytest.mark.parametrize("text", ["- 1\n", "{", "stage_positions: 5\n", "channels: [{exposure: x}]\n"])
def test_a_file_that_is_no_sequence_is_refused(tmp_path: Path, text: str) -> None:
    file = tmp_path / "exp.yaml"
    file.write_text(text)
    words = ["job", "from-useq", str(file), "--map", MAP[0], "-o", str(tmp_path / "x.yaml")]
    refused = CliRunner().invoke(main, words)
    assert refused.exit_code == 2 and "exp.yaml" in refused.stderr


@pytest.mark.nightly
def test_the_page_runs(tmp_path: Path) -> None:
    page = ROOT / "docs/how-to/run-a-microscope-sequence.md"
    (tmp_path / "exp.yaml").write_text(read_blocks(page, "yaml")[0])
    (tmp_path / "demo.fleet.yaml").write_text(find_example("demo.fleet.yaml").read_text())
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    for line in "".join(read_blocks(page, "console")).splitlines():
        done = run(line.removeprefix("$ "), shell=True, cwd=tmp_path, env={**os.environ, "PATH": path}, check=False)
        assert done.returncode == 0, line
