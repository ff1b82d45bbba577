"""`tutti job points` while a job runs: lines, JSON, CSV and HDF5; its interrupts, and what is said about bad input."""

import contextlib
import csv
import json
import os
from pathlib import Path
from typing import Any

import h5py
import pytest
from unit.cli.command_world import CommandWorld, open_world

from orchestrator.cli.jobs import foreground
from orchestrator.monitor.export.growing import BROKEN_OFF, COMPLETE

world = pytest.fixture(open_world)

SCAN = "{do: scan, axes: {gantry.x: {from: 0, to: 4, points: 5}}, at_each: [{do: dwell, duration: 1 s}]}"
LINES = (
    "{do: scan, axes: {stage.u: {from: 0, to: 1, points: 2}, gantry.y: {from: 20, to: 30, points: 21, snake: true}},"
    " fly: {duration: 20 ms}}"
)


def submit(world: CommandWorld, folder: Path, *steps: str) -> None:
    """Submit a job that begins at once, and return while it runs."""
    text = "".join(f"  - {step}\n" for step in ("{do: enable, axes: [gantry, stage]}", "{do: home}", *steps))
    (folder / "scan.job.yaml").write_text(f"schema: tutti.job/1\nname: scan\nsteps:\n{text}", encoding="utf-8")
    world.done("submit", str(folder / "scan.job.yaml"))


def interrupt_after(world: CommandWorld, monkeypatch: pytest.MonkeyPatch, duration_s: float) -> None:
    """Interrupt the next command after this time."""
    interrupts = foreground.Interrupts()
    monkeypatch.setattr(foreground, "count_interrupts", lambda: contextlib.nullcontext(interrupts))
    world.loop.call_later(duration_s, interrupts.note_interrupt)


def test_points_are_shown_as_they_come(world: CommandWorld, tmp_path: Path) -> None:
    submit(world, tmp_path, SCAN, LINES)
    lines = world.done("job", "points", "last", "--follow").splitlines()
    assert lines[0].split() == [
        "step",
        "point",
        "target",
        "measured,",
        "or",
        "passed",
        "verdict",
        "start",
        "skew",
        "took",
    ]
    assert len(lines) == 1 + 5 + 1 + 42 and lines[6].split() == lines[0].split()
    assert lines[2].split()[:3] == ["3", "2", "gantry.x=1"] and lines[2].split()[4] == "green"
    assert "T0 + 0." in lines[10] and " ± " in lines[10] and lines[10].split()[0] == "13"
    # Columns stand under each other.
    assert len({line.index("green") for line in lines[2:6]}) == 1 and len({len(line) for line in lines[30:]}) == 1
    rows = [json.loads(line) for line in world.done("job", "points", "last", "--follow", "--json").splitlines()]
    assert rows == json.loads(world.done("job", "points", "last", "--json"))
    assert len(world.done("job", "points", "last", "--follow", "--step", "3").splitlines()) == 6


def test_an_hdf5_file_grows_with_the_job_and_is_complete_at_its_end(world: CommandWorld, tmp_path: Path) -> None:
    submit(world, tmp_path, SCAN, LINES)
    path = tmp_path / "p.h5"
    said = world.done("job", "points", "last", "--hdf5", str(path), "--follow")
    assert said == f"47 points: {path}"
    with h5py.File(path) as file:
        opened: Any = file
        assert (opened["rows"][0], opened["status"][0]) == (47, COMPLETE)
        assert dict(file.attrs).items() >= {"job": "scan", "actor": "anna", "fleet": "demo"}.items()
        assert set(opened["points"]) >= {
            "gantry.x target",
            "gantry.y target",
            "stage.u target",
            "window_upper_latest_ns",
        }
        assert opened["points/gantry.y target"].attrs["units"] == "mm"
        assert list(opened["points/point"]) == [*range(1, 6), *range(1, 43)]
        assert list(opened["points/good"]) == [-1] * 5 + [1] * 42
    # One scan has its own axes only; without --follow it is as far as the job was.
    once = world.done("job", "points", "last", "--hdf5", str(tmp_path / "one.h5"), "--step", "3", "--json")
    assert json.loads(once) == {"points": 5, "file": str(tmp_path / "one.h5")}
    with h5py.File(tmp_path / "one.h5") as file:
        opened = file
        assert "gantry.x target" in opened["points"] and "gantry.y target" not in opened["points"]


def test_a_csv_file_is_written_while_the_job_runs(world: CommandWorld, tmp_path: Path) -> None:
    submit(world, tmp_path, SCAN)
    assert world.done("job", "points", "last", "--csv", str(tmp_path / "f.csv"), "--follow").startswith("5 points")
    world.done("job", "points", "last", "--csv", str(tmp_path / "p.csv"))
    assert (tmp_path / "f.csv").read_bytes() == (tmp_path / "p.csv").read_bytes()
    rows = list(csv.DictReader((tmp_path / "p.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["gantry.x target"] for row in rows] == ["0.0", "1.0", "2.0", "3.0", "4.0"]


@pytest.mark.parametrize("kind", ["hdf5", "csv"])
def test_an_interrupt_leaves_a_closed_file_with_the_points_so_far(
    world: CommandWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, kind: str
) -> None:
    submit(world, tmp_path, SCAN)
    while not json.loads(world.done("job", "points", "last", "--json")):
        world.let_pass(0.5)
    interrupt_after(world, monkeypatch, 1.5)
    path = tmp_path / "points"
    stopped = world.run("job", "points", "last", f"--{kind}", str(path), "--follow")
    assert stopped.exit_code == 130 and not stopped.stdout
    assert "interrupted; the first 2 points are in" in " ".join(stopped.stderr.split())
    if kind == "csv":
        assert len(path.read_text(encoding="utf-8").splitlines()) == 3
    else:
        with h5py.File(path) as file:
            opened: Any = file
            assert (opened["rows"][0], opened["status"][0]) == (2, BROKEN_OFF)
    # The job goes on.
    assert len(world.done("job", "points", "last", "--follow").splitlines()) == 6


def test_a_disk_that_is_full_ends_the_file_and_says_what_is_in_it(
    world: CommandWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submit(world, tmp_path, SCAN)
    calls = 0

    def have_no_room(*_: object) -> None:
        nonlocal calls
        calls += 1
        if calls > 3:
            raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "posix_fallocate", have_no_room)
    path = tmp_path / "p.h5"
    full = world.run("job", "points", "last", "--hdf5", str(path), "--follow")
    said = " ".join(full.stderr.split())
    assert full.exit_code == 1 and "Traceback" not in said
    assert "p.h5 cannot be written: No space left on device; the first 2 points are in it" in said
    assert "the points are in the journal of the fleet" in said
    with h5py.File(path) as file:
        opened: Any = file
        assert (opened["rows"][0], opened["status"][0]) == (2, BROKEN_OFF)


def test_what_cannot_be_written_is_explained(
    world: CommandWorld, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    submit(world, tmp_path, SCAN)
    path = tmp_path / "p.h5"
    path.write_text("mine")
    words = ("job", "points", "last", "--hdf5")
    assert "p.h5 exists" in world.refused(2, *words, str(path)) and path.read_text() == "mine"
    assert "--force" in world.refused(2, *words, str(path), "--follow")
    assert "No such file or directory" in world.refused(2, *words, str(tmp_path / "none" / "p.h5"))
    assert "Is a directory" in world.refused(2, *words, str(tmp_path), "--force")
    assert "has no scan" in world.refused(2, *words, str(tmp_path / "q.h5"), "--step", "1")
    assert "has no scan" in world.refused(2, *words, str(tmp_path / "q.h5"), "--step", "99")
    assert "cannot be written" in world.refused(1, "job", "points", "last", "--csv", str(tmp_path / "none" / "p.csv"))
    for options, text in (
        (("--hdf5", "a.h5", "--csv", "a.csv"), "cannot be given together"),
        (("--force",), "--force is for --hdf5"),
        (("--limit", "5", "--follow"), "--limit cannot be given with --follow"),
    ):
        assert text in " ".join(world.refused(2, "job", "points", "last", *options).split())
    assert world.done(*words, str(path), "--force", "--follow").startswith("5 points")
    monkeypatch.setattr("orchestrator.cli.base.extras.find_spec", lambda name: None if name == "h5py" else object())
    missing = world.refused(2, *words, str(tmp_path / "q.h5"))
    assert "not installed: h5py" in missing and "pip install 'tutti[export]'" in missing
    assert sorted(each.name for each in tmp_path.iterdir()) == ["p.h5", "scan.job.yaml"]


def test_points_of_a_live_job_are_followed_too(world: CommandWorld, tmp_path: Path) -> None:
    submit(world, tmp_path)
    world.let_pass(60)

    async def drive() -> None:
        async with world.fleet.make_client("anna").live("gantry.x") as live:
            for position in (1, 2, 3):
                await live.move({"gantry.x": position})

    world.wait(drive())
    path = tmp_path / "live.h5"
    assert world.done("job", "points", "last", "--hdf5", str(path), "--follow").startswith("3 points")
    with h5py.File(path) as file:
        opened: Any = file
        assert list(opened["points/gantry.x target"]) == [1, 2, 3]
