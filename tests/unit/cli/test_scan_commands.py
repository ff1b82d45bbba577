"""`tutti` with scans: submit with a file of points, show, points, plot, retry; and what is said about wrong files."""

import csv
import json
from pathlib import Path

import pytest
from cluster.worlds import EXAMPLES
from unit.cli.command_world import CommandWorld, open_world

world = pytest.fixture(open_world)
FLEET = str(EXAMPLES / "demo.fleet.yaml")


def write_job(folder: Path, steps: str) -> str:
    path = folder / "scan.job.yaml"
    path.write_text(f"schema: tutti.job/1\nname: scan\nsteps:\n{steps}", encoding="utf-8")
    return str(path)


def test_a_raster_is_submitted_shown_written_plotted_and_run_again(world: CommandWorld, tmp_path: Path) -> None:
    small = (EXAMPLES / "raster.job.yaml").read_text(encoding="utf-8")
    for many, few in (("points: 11", "points: 3"), ("points: 6", "points: 2")):
        assert many in small
        small = small.replace(many, few)
    (tmp_path / "raster.job.yaml").write_text(small, encoding="utf-8")
    shown = world.done("submit", str(tmp_path / "raster.job.yaml"), "--wait")
    assert "6 of 6 points" in shown and "verdict green" in shown
    lines = world.done("job", "show", "last").splitlines()
    assert lines[3].startswith("  3 scan 'field' gantry.x=10…110 (3) stage.u=0…5 (2 snake), 6 points, at each dwell")
    assert lines[4].startswith("  21 move to gantry.x=0 stage.u=0: done")
    table = world.done("job", "points", "last", "--limit", "3")
    assert "gantry.x=10 stage.u=0" in table and "more with --limit" in table
    points = json.loads(world.done("job", "points", "last", "--json"))
    assert len(points) == 6 and points[-1]["target"] == {"gantry.x": 110.0, "stage.u": 5.0}
    assert world.done("job", "points", "last", "--csv", str(tmp_path / "p.csv")).startswith("6 points")
    rows = list(csv.DictReader((tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 6 and all(row["gantry.x measured"] for row in rows)
    assert abs(float(rows[2]["gantry.x measured"]) - 60) < 0.01
    picture = tmp_path / "raster.png"
    assert "step 3: " in world.done("job", "plot", "last", "--out", str(picture), "--step", "3")
    assert picture.stat().st_size > 10_000
    parts = json.loads(world.done("job", "plot", "last", "--out", str(tmp_path / "all.svg"), "--json"))
    assert parts == {"job": str(tmp_path / "all.svg"), "2": str(tmp_path / "all-3.svg")}
    assert all("<svg" in Path(each).read_text(encoding="utf-8") for each in parts.values())
    drawn = world.done("job", "timeline", "last", "-o", str(tmp_path / "stages.png"))
    assert drawn == f"step 21: {tmp_path / 'stages.png'}" and (tmp_path / "stages.png").stat().st_size > 10_000
    assert "coordinator" in world.done("job", "timeline", "last") and "start x" in world.done("job", "timeline", "last")
    assert json.loads(world.done("job", "timeline", "last", "--json"))["schema"] == "tutti.timeline/1"
    assert "it has: 21" in world.refused(2, "job", "timeline", "last", "--step", "7")
    assert "ends in .png or .svg" in world.refused(2, "job", "plot", "last", "-o", "x.jpg")
    assert "cannot be written" in world.refused(1, "job", "plot", "last", "-o", str(tmp_path / "none" / "x.png"))
    assert "no scan" in world.refused(1, "job", "retry", "last", "--step", "2", "--from-point", "3", "--yes")
    old = world.refused(2, "job", "retry", "last", "--from-step", "2", "--from-point", "4", "--yes")
    assert "what was --from-step 2 is --step 3" in old
    for command in (("retry", "last", "--yes"), ("plot", "last"), ("points", "last"), ("timeline", "last")):
        assert "0 is not in the range x>=1" in world.refused(2, "job", *command, "--step", "0")
    again = world.run("job", "retry", "last", "--step", "3", "--from-point", "4", "--yes")
    assert again.exit_code == 0 and "12 scan" in again.output
    world.let_pass(10)
    assert [each["point"] for each in json.loads(world.done("job", "points", "last", "--json"))] == [4, 5, 6]


def test_a_wrong_file_of_points_is_named_by_line_and_column(world: CommandWorld, tmp_path: Path) -> None:
    job = write_job(tmp_path, "  - {do: scan, points: {file: p.csv}}\n")
    (tmp_path / "p.csv").write_text("gantry.x,stage.u\n1,2\n1,2 deg\n3\n4,1_0\n,5\n", encoding="utf-8")
    for words in (("submit", job), ("submit", job, "--dry-run"), ("job", "check", job, "--fleet", FLEET)):
        said = world.run(*words)
        assert said.exit_code == 2, said.output
        found = said.stderr.replace(str(tmp_path) + "/", "")
        for line in (
            "p.csv:3: column 2 (stage.u): deg is a unit of angle, and the axis is in mm",
            "p.csv:4: has 1 values for 2 axes",
            "p.csv:5: column 2 (stage.u): '1_0' is not a quantity; write 10",
            "p.csv:6: column 1 (gantry.x): is empty; write a number, or one with a unit: 12.5 mm",
        ):
            assert line in found, found
    (tmp_path / "p.csv").write_text("gantry.q,stage.u\n1,2\n", encoding="utf-8")
    assert "p.csv:1: the fleet has no axis gantry.q; its axes are: gantry.x" in world.run("submit", job).stderr


def test_a_check_offline_reads_the_points(world: CommandWorld, tmp_path: Path) -> None:
    job = write_job(tmp_path, "  - {do: scan, points: {file: p.csv}, at_each: [{do: dwell, duration: 1 s}]}\n")
    (tmp_path / "p.csv").write_text("gantry.x\n" + "".join(f"{k}\n" for k in range(300)), encoding="utf-8")
    assert "1 step, " in world.done("job", "check", job, "--fleet", FLEET)
    (tmp_path / "p.csv").write_text("gantry.x\n1\n402 mm\n", encoding="utf-8")
    said = world.run("job", "check", job, "--fleet", FLEET)
    assert said.exit_code == 2
    assert "axis gantry.x: target 402 mm is beyond its soft limits -10 to 400 mm, at point 2 of 2" in said.stderr


def test_a_scan_that_flies_is_submitted_written_plotted_and_run_again(world: CommandWorld, tmp_path: Path) -> None:
    shown = world.done("submit", str(EXAMPLES / "flying.job.yaml"), "--wait")
    assert "205 of 205 points" in shown and "verdict green" in shown
    world.done("job", "points", "last", "--csv", str(tmp_path / "p.csv"))
    rows = list(csv.DictReader((tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()))
    assert len(rows) == 205
    for row in rows:
        ends = [int(row[f"window_{part}_latest_ns"]) for part in ("lower", "middle", "upper")]
        assert row["good"] and ends == sorted(ends) and int(row["window_lower_earliest_ns"]) < ends[0]
        assert 38e6 / 2 < ends[2] - ends[0] < 42e6 / 2
    picture = tmp_path / "flying.png"
    world.done("job", "plot", "last", "--step", "3", "--out", str(picture))
    assert picture.stat().st_size > 1000
    world.done("job", "retry", "last", "--step", "3", "--from-point", "60", "--yes")
    world.let_pass(20)
    points = json.loads(world.done("job", "points", "last", "--json"))
    assert points[0]["point"] == 42 and points[0]["good"] is True
