"""Paths in files beside the job: read where the job is submitted, run, and refused by line and column."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from cluster.test_contour import two_gantries
from cluster.test_paths import ALONE, positions, prepare
from cluster.worlds import job, outcome, refusal, run_fleet

from orchestrator.cli.main import main
from orchestrator.model.jobs.files import FileError
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.files.steps import read_path_steps
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.templates.template import load_job
from orchestrator.runtime.virtual.fleet import VirtualFleet

PROGRAM = """\
G21 G90 G64 P0.1
G1 F3000 X10 Y0
X20 Y10
G4 P0.2
G2 X10 Y0 I-10 J0
"""


def write_job(folder: Path, program: str, more: str = "", name: str = "part.ngc") -> Path:
    (folder / name).write_text(program, encoding="utf-8")
    file = folder / "a.job.yaml"
    axes = "{X: gantry.x, Y: gantry.y}" if name.endswith("ngc") else "[gantry.x, gantry.y]"
    step = f"{{do: path, file: {name}, axes: {axes}, tolerance: 100 um{more}}}"
    file.write_text(f"schema: tutti.job/1\nname: part\nsteps:\n  - {{do: dwell, duration: 1 s}}\n  - {step}\n")
    return file


def test_a_program_beside_the_job_becomes_its_steps(tmp_path: Path) -> None:
    loaded = load_job(write_job(tmp_path, PROGRAM, ", name: contour, start: [0, 0]"))
    dwell, read = loaded.steps
    # One step for one that was written: places in messages stay right.
    assert dwell.do == "dwell" and isinstance(read, Repeat) and read.times == 1 and read.name == "contour"
    assert [each.do for each in read.steps] == ["path", "dwell", "path"]
    first = read.steps[0]
    assert isinstance(first, FollowPath)
    assert first.axes == ["gantry.x", "gantry.y"] and first.speed == "50 mm/s" and first.tolerance == "100 um"
    assert first.file is None and len(first.pieces) == 2 and first.name == "contour"


def test_it_runs(tmp_path: Path) -> None:
    loaded = load_job(write_job(tmp_path, PROGRAM))

    async def main(fleet: VirtualFleet) -> None:
        begin = job("[{do: move, to: {gantry.x: 0, gantry.y: 0}}]")
        report = await outcome(fleet, prepare(fleet.fleet, ALONE), begin, loaded)
        assert report.state == "done", report.reason
        assert [step.do for step in report.steps] == ["dwell", "path", "dwell", "path"]
        assert positions(fleet, ALONE) == [10.0, 0.0]

    run_fleet(main, two_gantries())


def test_a_table_of_points_is_one_path_with_the_corners_of_its_step(tmp_path: Path) -> None:
    points = "gantry.x, gantry.y\n0, 0\n10, 0\n10, 10\n"
    (_, path) = load_job(write_job(tmp_path, points, ", corner: {within: 1 mm}, speed: 20 mm/s", "a.csv")).steps
    assert isinstance(path, FollowPath) and path.start == ["0", "0"] and path.speed == "20 mm/s"
    assert path.corner != "stop"


@pytest.mark.parametrize(("speed", "kept"), [("20 mm/s", "20 mm/s"), ("80 mm/s", "50 mm/s"), ("80 um", "80 um")])
def test_the_lower_speed_holds(tmp_path: Path, speed: str, kept: str) -> None:
    (_, read) = load_job(write_job(tmp_path, PROGRAM, f", speed: {speed}")).steps
    assert isinstance(read, Repeat) and isinstance(read.steps[0], FollowPath) and read.steps[0].speed == kept


def test_wrong_lines_are_named_and_nothing_is_submitted(tmp_path: Path) -> None:
    file = write_job(tmp_path, "G1 F100 X1\nG5 X2\nX3 Y;\nX4 Q9\n")
    shown = CliRunner().invoke(main, ["job", "check", str(file)])
    assert shown.exit_code == 2
    for words in ("part.ngc:2: column 1: G5", "part.ngc:3: column 4", "part.ngc:4: column 4: Q9"):
        assert words in shown.output, shown.output
    missing = write_job(tmp_path, "", name="b.ngc").read_text().replace("b.ngc", "c.ngc")
    (tmp_path / "a.job.yaml").write_text(missing)
    shown = CliRunner().invoke(main, ["job", "check", str(file)])
    assert shown.exit_code == 2 and "c.ngc:1" in shown.output and "cannot be read" in shown.output


def test_a_step_of_the_file_that_is_not_valid_names_the_written_step(tmp_path: Path) -> None:
    fleet = tmp_path / "a.fleet.yaml"
    fleet.write_text(json.dumps(two_gantries().to_plain(), default=str))
    file = write_job(tmp_path, PROGRAM.replace("X20 Y10", "X20 Y1000\nX20 Y10"))
    shown = CliRunner().invoke(main, ["job", "check", str(file), "--fleet", str(fleet)])
    assert shown.exit_code == 2 and "a.job.yaml:5" in shown.output and "soft limit" in shown.output, shown.output


def test_a_file_that_was_not_read_is_refused() -> None:
    unread = job("[{do: path, file: part.ngc, axes: {X: gantry.x}, tolerance: 1 mm}]")

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        client = fleet.make_client()

        async def send_nothing(job: Job, _: object = None) -> Job:
            return job

        client.send_points = send_nothing  # type: ignore[method-assign]
        from orchestrator.model.errors import Refusal

        with pytest.raises(Refusal) as caught:
            await client.submit(unread)
        assert caught.value.code == "unread-path" and "where the file is" in caught.value.remedy

    run_fleet(main, two_gantries())


def test_a_client_reads_the_files_of_jobs_from_python(tmp_path: Path) -> None:
    (tmp_path / "part.ngc").write_text("G1 F3000 X10\n")
    step = FollowPath(file=str(tmp_path / "part.ngc"), axes={"X": "gantry.x"}, tolerance="1 mm")
    made = Job(name="a", steps=[step])

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, ALONE))
        found = await refusal(fleet, made)
        assert found.code == "other-start"  # it was read: its axes stand elsewhere

    run_fleet(main, two_gantries())


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("{do: path, axes: [gantry.x], tolerance: 1}", "needs `start` and `pieces`, or `file`"),
        (
            "{do: path, axes: [gantry.x], tolerance: 1, file: a.ngc, pieces: [{piece: line, to: [1]}]}",
            "has `file`, so `pieces` have no meaning",
        ),
        ("{do: path, axes: {X: gantry.x}, tolerance: 1, start: [0], pieces: [{piece: line, to: [1]}]}", "need `file`"),
    ],
)
def test_forms_that_do_not_fit_are_explained(step: str, words: str) -> None:
    with pytest.raises(FileError) as caught:
        job(f"[{step}]")
    assert words in str(caught.value)


def test_more_stops_than_a_repeat_may_have(tmp_path: Path) -> None:
    lines = ["G1 F600 X0.5", *(f"X{k}\nG4 P0.1" for k in range(1, 131))]
    (tmp_path / "part.ngc").write_text("\n".join(lines))
    step = FollowPath(file=str(tmp_path / "part.ngc"), axes={"X": "gantry.x"}, tolerance="1 mm")
    with pytest.raises(FileError, match="stops 260 times; at most 200"):
        read_path_steps(Job(name="a", steps=[step]))


def test_a_long_program_is_one_path(tmp_path: Path) -> None:
    from benches.paths.planning import make_program

    (tmp_path / "part.ngc").write_text("\n".join(make_program(3000)))
    axes = {"X": "gantry.x", "Y": "gantry.y", "Z": "portal.x"}
    step = FollowPath(file=str(tmp_path / "part.ngc"), axes=axes, tolerance="1 mm", start=[60, 0, 0])
    (read,) = read_path_steps(Job(name="a", steps=[step])).steps
    assert isinstance(read, FollowPath) and len(read.pieces) == 2998


# Programs from CAM


def write_fleet(folder: Path) -> Path:
    fleet = folder / "a.fleet.yaml"
    fleet.write_text(json.dumps(two_gantries().to_plain(), default=str))
    return fleet


def invoke(*words: object) -> tuple[int, str]:
    shown = CliRunner().invoke(main, [str(word) for word in words])
    return shown.exit_code, shown.output


CAM = "%\nT1 M6\nS5000 M3\nG90 G40 G80 G54\nG0 X10\nG1 X20 F600\nX30\nM30\n%\n"
AXES = ("--axis", "X=gantry.x", "--axis", "Y=gantry.y")


def test_a_program_from_cam_needs_what_stands_for_its_machine(tmp_path: Path) -> None:
    code, text = invoke("job", "check", write_job(tmp_path, CAM))
    assert code == 2 and "part.ngc:2: column 1: T needs `gcode: {tools: none}`" in text
    code, text = invoke("job", "check", write_job(tmp_path, CAM, ", gcode: {spindle: none, tools: none}"))
    assert code == 0 and "part.ngc: skipped, changes no path and no tool: G40, G80, M30" in " ".join(text.split())
    step = "{do: path, axes: [gantry.x], tolerance: 1, start: [0], pieces: [{piece: line, to: [1]}], gcode: {}}"
    with pytest.raises(FileError, match="has `gcode`, which needs `file`"):
        job(f"[{step}]")


def test_what_the_planner_refuses_is_named_by_file_line_and_column(tmp_path: Path) -> None:
    code, text = invoke("job", "check", write_job(tmp_path, "G0 X1\n  G0 X1000\n"), "--fleet", write_fleet(tmp_path))
    assert code == 2 and "part.ngc:2: column 3: piece 2" in " ".join(text.split()), text


def test_an_imported_job_is_one_that_the_check_takes(tmp_path: Path) -> None:
    (tmp_path / "part.ngc").write_text(CAM)
    target, more = tmp_path / "b.job.yaml", ("--gcode", "spindle=none", "--gcode", "tools=none")
    code, text = invoke("path", "import", tmp_path / "part.ngc", *AXES, *more, "--to", target)
    assert code == 0, text
    lines = target.read_text().splitlines()
    assert [line.strip()[:16] for line in lines if '"piece"' in line] == ['{"piece": "line"'] * 3
    assert invoke("job", "check", target, "--fleet", write_fleet(tmp_path))[0] == 0
    code, text = invoke(
        "path", "import", tmp_path / "part.ngc", *AXES, *more, "--from-line", 7, "--to", target, "--force"
    )
    assert code == 0 and "from line 7: work offset G54, tool 1, spindle M3 S5000, feed 600 mm/min" in " ".join(
        text.split()
    )
    steps = load_job(target).steps
    assert [step.do for step in steps] == ["move", "path"]


@pytest.mark.parametrize(
    ("program", "more", "words"),
    [
        ("G1 F60 X1", ("--gcode", "spindle"), "write ENTRY=VALUE"),
        ("G1 F60 X1", ("--gcode", "spindle=on"), "--gcode: spindle"),
        ("G1 F60 X1", ("--gcode", "offsets={G54: [1]}"), "G54 has 1 values for 2 axes"),
        ("G1 F60 X1000", ("--fleet", "a.fleet.yaml"), "--fleet: part.ngc:1: column 1: piece 1"),
        ("G91 G1 F60\n" + "X0.1\n" * 10_001, (), "10001 pieces are more than a job file holds; keep the program"),
    ],
)
def test_what_an_import_refuses_is_not_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, program: str, more: tuple[str, ...], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    write_fleet(tmp_path)
    (tmp_path / "part.ngc").write_text(program)
    code, text = invoke("path", "import", "part.ngc", *AXES, *more, "--to", "b.job.yaml")
    assert code == 2 and words in " ".join(text.split()), text
    assert not (tmp_path / "b.job.yaml").exists()


def test_tables_with_units_of_time_and_equal_points(tmp_path: Path) -> None:
    (_, timed) = load_job(write_job(tmp_path, "t,gantry.x,gantry.y\n0 ms,0,0\n1500 ms,1,1\n", "", "a.csv")).steps
    assert isinstance(timed, FollowPath) and timed.to_plain()["pieces"][0]["t"] == [0.0, 1.5]
    (_, path) = load_job(write_job(tmp_path, "gantry.x,gantry.y\n0,0\n1,1\n1.0,1 \n2,2\n", "", "a.csv")).steps
    assert isinstance(path, FollowPath) and len(path.pieces) == 2
    for table, words in (("0 mm,0,0", "'0 mm' is no time"), ("1,0,0\n0.5,1,1", "times grow")):
        with pytest.raises(FileError, match=words):
            load_job(write_job(tmp_path, f"t,gantry.x,gantry.y\n{table}\n2,2,2\n", "", "a.csv"))
