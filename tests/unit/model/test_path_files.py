"""Paths from files of other programs: what they become, and where their mistakes are."""

from math import hypot
from pathlib import Path
from typing import Any

import pytest

from orchestrator.model.jobs.files import FileError, read_document
from orchestrator.model.paths.files.columns import ColumnReader
from orchestrator.model.paths.files.gcode.reader import GcodeReader
from orchestrator.model.paths.files.reading import GcodeStart, read_path_file
from orchestrator.model.paths.files.trajectory import TrajectoryReader

XY = {"X": "gantry.x", "Y": "gantry.y"}


def read_gcode(text: str, axes: dict[str, str] | None = None) -> list[dict[str, Any]]:
    return GcodeReader("part.ngc", axes or XY).read_steps(text.splitlines())


def find_mistakes(text: str) -> list[tuple[int, str, str]]:
    with pytest.raises(FileError) as refused:
        read_gcode(text)
    return [(each.line, each.field, each.text) for each in refused.value.problems]


def test_lines_arcs_corners_and_feeds() -> None:
    steps = read_gcode(
        """%
        (a rounded corner) G21 G90 G17 ; millimetres
        N10 G64 P0.05 F600
        G1 X10 Y0
        X10 Y10
        G61 G2 X20 Y20 I10 J0
        G4 P0.25
        g0x0y0
        %"""
    )
    first, dwell, last = steps
    assert first["axes"] == ["gantry.x", "gantry.y"] and first["start"] == ["0 mm", "0 mm"]
    line, other, arc = first["pieces"]
    assert line == {"piece": "line", "to": ["10 mm", "0 mm"], "corner": {"within": "0.05 mm"}}
    assert first["speed"] == "10 mm/s"
    assert other["to"] == ["10 mm", "10 mm"]
    assert (arc["piece"], arc["direction"], arc["centre"], arc["corner"]) == ("arc", "cw", ["20 mm", "10 mm"], "stop")
    assert arc["plane"] == ["gantry.x", "gantry.y"]
    assert dwell == {"do": "dwell", "duration": "0.25 s"}
    assert last["start"] == ["20 mm", "20 mm"] and "speed" not in last


def test_inches_and_increments() -> None:
    (step,) = read_gcode("G20 G91 F10\nG1 X1\nX1 Y.5\n")
    assert [piece["to"] for piece in step["pieces"]] == [["25.4 mm", "0 mm"], ["50.8 mm", "12.7 mm"]]
    assert step["speed"] == "4.233333333 mm/s"


def test_a_feed_is_the_speed_of_its_pieces() -> None:
    (step,) = read_gcode("G64 P0.1 F600 G1 X1\nX2\nF300 X3\nG0 X4\n")
    assert [piece.get("speed") for piece in step["pieces"]] == ["10 mm/s", "10 mm/s", "5 mm/s", None]
    assert [piece["corner"] == "stop" for piece in step["pieces"]] == [False, False, True, True]
    assert "speed" not in step


@pytest.mark.parametrize(
    ("code", "radius", "centre"), [("G2", 10, (10, 0)), ("G3", 10, (0, 10)), ("G2", -10, (0, 10)), ("G3", -10, (10, 0))]
)
def test_the_centre_of_an_arc_with_a_radius(code: str, radius: int, centre: tuple[int, int]) -> None:
    """From (0, 0) to (10, 10): the shorter arc to the right has its centre at (10, 0)."""
    (step,) = read_gcode(f"F60 {code} X10 Y10 R{radius}\n")
    found = [float(each.removesuffix(" mm")) for each in step["pieces"][0]["centre"]]
    assert found == pytest.approx(centre)
    assert hypot(*found) == pytest.approx(10)


def test_a_full_circle_and_a_helix_are_helices() -> None:
    axes = {**XY, "Z": "gantry.z"}
    (step,) = read_gcode("F60 G3 I5\nG2 X10 Z4 I5 J0\nG18 G2 X20 Z4 I5 K0\n", axes)
    circle, helix, other = step["pieces"]
    assert (circle["piece"], circle["to"]) == ("helix", ["0 mm", "0 mm", "0 mm"])
    assert (helix["piece"], helix["to"]) == ("helix", ["10 mm", "0 mm", "4 mm"])
    assert other["plane"] == ["gantry.z", "gantry.x"] and other["centre"] == ["4 mm", "15 mm"]


@pytest.mark.parametrize(
    ("text", "line", "column", "words"),
    [
        ("G1 F60 X1\nM3 S1000\n", 2, "column 4", "S needs `gcode: {spindle: none}`"),
        ("G1 F60 X1\nG43.1 Z1\n", 2, "column 7", "no axis is named for Z"),
        ("G1 F60 X1\n  G28\n", 2, "column 3", "where G28 goes is not known"),
        ("F60 G1 X1 Z3\n", 1, "column 11", "no axis is named for Z"),
        ("F60 G1 X1 X2\n", 1, "column 11", "X stands twice"),
        ("F60 G1 X1 #5\n", 1, "column 12", "the line ends where = is expected"),
        ("F60 G1 X1 [3+4]\n", 1, "column 11", "is no word"),
        ("F60 G1 X--1\n", 1, "column 8", "is no word"),
        ("G1 X1\n", 1, "", "no feed is chosen"),
        ("F60 X1\n", 1, "", "no motion is chosen"),
        ("F0 G1 X1\n", 1, "column 1", "a feed must be above 0"),
        ("F60 G64 Q1 G1 X1\n", 1, "", "G64 needs a tolerance"),
        ("G4\n", 1, "", "G4 needs a time"),
        ("F60 G2 X10 Y0\n", 1, "", "needs its centre"),
        ("F60 G2 X10 Y0 I4\n", 1, "", "the end of the arc is 6 mm from its centre"),
        ("F60 G2 X10 Y0 R2\n", 1, "column 15", "its ends are 10 mm apart"),
        ("F60 G2 X0 Y0 R2\n", 1, "column 14", "a full circle has no radius form"),
        ("F60 G19 G2 X1 Y0 J1\n", 1, "", "needs both as axes"),
        ("(nothing)\n", 1, "", "moves nothing"),
        ("", 1, "", "moves nothing"),
    ],
)
def test_a_mistake_is_named_with_line_and_column(text: str, line: int, column: str, words: str) -> None:
    found = find_mistakes(text)
    assert (found[0][0], found[0][1]) == (line, column), found
    assert words in found[0][2]


def test_all_mistakes_are_named_at_once() -> None:
    assert [line for line, _, _ in find_mistakes("G1 F60 X1\nM3\nG1 X2\nT1\nG41\n")] == [2, 4, 5]


def test_ten_thousand_lines_take_less_than_a_second() -> None:
    import time

    text = "F600 G64 P0.01\n" + "".join(f"G1 X{number % 97}.{number % 10} Y{number % 89}\n" for number in range(10_000))
    begun_s = time.process_time()
    (step,) = read_gcode(text)
    assert len(step["pieces"]) > 9_900
    assert (time.process_time() - begun_s) / 10_000 < 100e-6


# Tables


def read_columns(text: str, **axes: str) -> list[dict[str, Any]]:
    return ColumnReader("points.csv", axes).read_steps(text.splitlines())


def test_points_and_points_with_times() -> None:
    (step,) = read_columns("gantry.x, b\n0, 0\n10, 5 mm\n10, 5 mm\n20, 5\n", b="gantry.y")
    assert step["axes"] == ["gantry.x", "gantry.y"] and step["start"] == ["0", "0"]
    assert [piece["to"] for piece in step["pieces"]] == [["10", "5 mm"], ["20", "5"]]
    (timed,) = read_columns("t, gantry.x\n5, 0\n5.5, 1\n6.25, 3\n")
    assert timed["pieces"] == [{"piece": "table", "t": [0.0, 0.5, 1.25], "positions": [["0"], ["1"], ["3"]]}]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("", 1, "must name the axes"),
        ("t\n0\n1\n", 1, "must name the axes"),
        ("a, a\n0, 0\n1, 1\n", 1, "needs a name of its own"),
        ("a, b\n0, 0\n1\n", 3, "has 1 values"),
        ("a, b\n0, 0\n1, x\n", 3, "'x' is no number"),
        ("a, b\n0, 0\n1, nan\n", 3, "'nan' is no number"),
        ("a, b\n0, 0\n", 2, "at least 2 points"),
    ],
)
def test_a_mistake_in_a_table_is_named(text: str, line: int, words: str) -> None:
    with pytest.raises(FileError) as refused:
        read_columns(text)
    assert refused.value.problems[0].line == line
    assert words in refused.value.problems[0].text


# Trajectories


def read_trajectory(text: str, **axes: str) -> list[dict[str, Any]]:
    return TrajectoryReader(read_document(text, "arm.yaml"), axes).read_steps()


def test_a_trajectory_of_joints() -> None:
    text = """joint_names: [j1, arm.b]
points:
  - {positions: [0, 1], time_from_start: 0}
  - {positions: [0.5, 2], time_from_start: {sec: 1, nanosec: 500000000}}
"""
    (step,) = read_trajectory(text, j1="arm.a")
    assert step["axes"] == ["arm.a", "arm.b"] and step["start"] == [0.0, 1.0]
    assert step["pieces"] == [{"piece": "table", "t": [0.0, 1.5], "positions": [[0.0, 1.0], [0.5, 2.0]]}]


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("points: []\n", 1, "must be a list of names"),
        ("joint_names: [a]\npoints: 5\n", 2, "at least 2 points"),
        (
            "joint_names: [a]\npoints:\n  - {positions: [1], time_from_start: 0}\n  - {positions: [1, 2]}\n",
            4,
            "list of 1 numbers",
        ),
        (
            "joint_names: [a]\npoints:\n  - {positions: [1], time_from_start: x}\n  - {positions: [1]}\n",
            3,
            "must be seconds",
        ),
        ("[]\n", 1, "must be a list of names"),
    ],
)
def test_a_mistake_in_a_trajectory_is_named(text: str, line: int, words: str) -> None:
    with pytest.raises(FileError) as refused:
        read_trajectory(text)
    found = [each for each in refused.value.problems if words in each.text]
    assert found and found[0].line == line


# Files


def test_a_file_is_read_by_its_kind(tmp_path: Path) -> None:
    (tmp_path / "a.NGC").write_text("F60 G1 X1\n")
    assert read_path_file(tmp_path / "a.NGC", XY, GcodeStart({"Y": 3.0})).steps[0]["start"] == ["0 mm", "3 mm"]
    (tmp_path / "a.csv").write_text("gantry.x\n0\n1\n")
    assert len(read_path_file(tmp_path / "a.csv", {}, GcodeStart()).steps) == 1
    (tmp_path / "bad.csv").write_bytes(b"a\n\xff\n")
    for name, words in (
        ("a.dxf", "no known kind"),
        ("none.csv", "cannot be read"),
        ("bad.csv", "is not UTF-8 text; save the file as UTF-8"),
    ):
        with pytest.raises(FileError) as refused:
            read_path_file(tmp_path / name, {}, GcodeStart())
        assert words in refused.value.problems[0].text


def test_a_trajectory_that_begins_later_waits() -> None:
    text = "joint_names: [a]\npoints:\n  - {positions: [0], time_from_start: 1.25, velocities: [0]}\n"
    wait, step = read_trajectory(f"{text}  - {{positions: [2], time_from_start: 3}}\n", a="arm.a")
    assert wait == {"do": "dwell", "duration": "1.25 s"}
    assert step["pieces"][0]["t"] == [0.0, 1.75]


@pytest.mark.parametrize("name", ["velocities", "accelerations", "effort"])
def test_what_a_path_does_not_follow_is_refused(name: str) -> None:
    text = f"joint_names: [a]\npoints:\n  - {{positions: [0], time_from_start: 0}}\n  - {{positions: [2], {name}: [0.5], time_from_start: 1}}\n"
    with pytest.raises(FileError, match=f"{name}: are not followed") as refused:
        read_trajectory(text)
    assert refused.value.problems[0].line == 4


@pytest.mark.parametrize("separator", [";", "\t"])
def test_a_table_of_another_country(separator: str) -> None:
    lines = [
        separator.join(row) for row in (["t", "arm.a", "arm.b"], ["0", "0,5", "-1,25 mm"], ["500 ms", "1", "1e-3"])
    ]
    (step,) = ColumnReader("p.csv", {}).read_steps(lines)
    assert step["start"] == ["0.5", "-1.25 mm"]
    assert step["pieces"][0]["positions"] == [["0.5", "-1.25 mm"], ["1", "1e-3"]]


@pytest.mark.parametrize("cell", ["1_0", "1,000,000", "1.000,5", "nan", "inf", "١"])
def test_a_number_that_programs_read_differently_is_refused(cell: str) -> None:
    with pytest.raises(FileError, match="is no number"):
        ColumnReader("p.csv", {}).read_steps(["arm.a;arm.b", "0;0", f"{cell};1"])
