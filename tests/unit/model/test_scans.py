"""Scans and repeats in job files, their order by arithmetic, and files of points."""

from fractions import Fraction
from itertools import pairwise, product
from pathlib import Path

import numpy as np
import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError, parse_document
from orchestrator.model.jobs.job import Job
from orchestrator.model.positions.resolve import names_positions
from orchestrator.model.scans.point_file import PointFile
from orchestrator.model.scans.point_summary import ColumnSummary
from orchestrator.model.scans.spec_points import SpecPoints
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.order import StepOrder, count_reports
from orchestrator.model.steps.points import GridPoints, PointAxis
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.steps.scan import Scan
from orchestrator.model.templates.template import load_job
from orchestrator.model.units import Unit, UnitError

UNITS = {"gantry.x": Unit.MM, "stage.u": Unit.MM, "stage.r": Unit.DEG}


def steps(text: str) -> list[Step]:
    return parse_document(f"schema: tutti.job/1\nname: test\nsteps: {text}\n", Job, "test").steps


def problem(text: str) -> str:
    with pytest.raises(FileError) as wrong:
        steps(text)
    (found,) = wrong.value.problems
    return f"{found.field}: {found.text}"


def grid(axes: str) -> list[tuple[Fraction, ...]]:
    (scan,) = steps(f"[{{do: scan, axes: {axes}}}]")
    assert isinstance(scan, Scan)
    points = GridPoints(scan.axes)
    return [tuple(points.find_position(k, [UNITS[name] for name in scan.axes])) for k in range(points.count)]


def test_the_last_axis_moves_fastest_and_a_snake_turns_at_the_end_of_each_pass() -> None:
    x, u, r = "gantry.x: {from: 0, to: 2, points: 3}", "stage.u: {from: 0, to: 1, step: 0.5", "stage.r: {values: [5, 7]"
    assert grid(f"{{{x}, {u}}}, {r}}}}}") == list(product((0, 1, 2), (0, Fraction(1, 2), 1), (5, 7)))
    snake = grid(f"{{{x}, {u}, snake: true}}, {r}, snake: true}}}}")
    assert sorted(snake) == list(product((0, 1, 2), (0, Fraction(1, 2), 1), (5, 7)))
    # One axis by one position at a time: no way back anywhere.
    for before, after in pairwise(snake):
        assert sum(a != b for a, b in zip(before, after, strict=True)) == 1


def test_positions_are_exact_whatever_their_unit() -> None:
    assert grid("{gantry.x: {from: 0, to: 1, points: 11}}")[1] == (Fraction(1, 10),)
    assert grid('{gantry.x: {from: 0, to: "1 in", points: 3}}')[1] == (Fraction("12.7"),)
    assert grid('{gantry.x: {from: "0 um", to: "30 um", step: "10 um"}}')[-1] == (Fraction("0.03"),)


def test_names_of_positions_stand_where_positions_do_and_are_no_positions_themselves() -> None:
    text = "axes: {gantry.x: {from: sample, to: 1, points: 3}, stage.u: {values: [0, sample]}}"
    (scan,) = steps(f"[{{do: scan, {text}}}]")
    assert isinstance(scan, Scan) and scan.point_count == 6 and names_positions(Repeat(times=2, steps=[scan]))
    with pytest.raises(UnitError):
        GridPoints(scan.axes).find_position(0, [Unit.MM, Unit.MM])
    (table,) = steps("[{do: scan, points: {axes: [gantry.x], rows: [[0], [sample]]}}]")
    assert isinstance(table, Scan) and names_positions(table)
    assert list(table.iterate_targets()) == [("gantry.x", 0), ("gantry.x", "sample")]
    (inside,) = steps("[{do: scan, axes: {gantry.x: {values: [0]}}, at_each: [{do: move, to: sample}]}]")
    assert names_positions(inside)
    (plain,) = steps('[{do: scan, axes: {gantry.x: {from: "1 mm", to: 0, points: 3}}}]')
    assert not names_positions(plain)


@pytest.mark.parametrize(
    ("scan", "text"),
    [
        ("axes: {gantry.x: {from: 0, to: 1}}", "steps[0].axes.gantry.x: needs either `points`"),
        (
            "axes: {gantry.x: {from: 0, to: 1, step: 0.3}}",
            "does not divide the way from `from` to `to`; write `points`",
        ),
        ("axes: {gantry.x: {from: 0, to: 1, step: -0.5}}", "must lead from `from` towards `to`"),
        ("axes: {gantry.x: {from: 0, to: 1 mm, step: 0.5}}", "either all as numbers or all with a unit"),
        ("axes: {gantry.x: {values: [0], points: 3}}", "has `values`, so"),
        ("axes: {gantry.x: {from: sample, to: 1, step: 0.5}}", "with the name of a position write `points`"),
        ("axes: {gantry.x: {from: Sample, to: 1, points: 3}}", "'Sample' is not a quantity"),
        ("axes: {gantry.x: {from: 0, to: .nan, points: 3}}", "steps[0].axes.gantry.x.to: "),
        ("axes: {gantry.x: {from: 0, to: 1e300, points: 3}}", "out of range"),
        ("points: {axes: [gantry.x], rows: [[0], [1, 2]]}", "point 2 has 2 values for 1 axes"),
        ("points: {axes: [gantry.x], rows: [[0], [.inf]]}", "steps[0].points.rows[1][0]: "),
        ("points: {rows: [[0]]}", "give both or neither"),
        ("points: {}", "needs one of `file`, `rows` (with `axes`) and `digest`"),
        ("speed: 0.5", "a scan needs one of `axes`, `points` and `scanspec`"),
        (
            "axes: {gantry.x: {values: [0]}}, at_each: [{do: home}]",
            "steps[0].at_each: at_each[0]: `do: home` cannot stand in `at_each`: it would take the reference away",
        ),
        (
            "axes: {gantry.x: {values: [0]}}, at_each: [{do: move, by: {gantry.x: 1}}]",
            "at_each[0] moves gantry.x, which the scan positions; move other axes there",
        ),
        ("axes: {gantry.x: {from: 0, to: 1, points: 9000000}, stage.u: {values: [1, 2]}}", "has 18000000 points; the"),
        (
            "axes: {gantry.x: {values: [0]}}, at_each: [{do: output, output: a.b, value: true, pulse: 0 s}]",
            "longer than 0",
        ),
    ],
)
def test_wrong_scans_are_named_with_their_place(scan: str, text: str) -> None:
    assert text in problem(f"[{{do: scan, {scan}}}]")


def test_repeats_have_a_depth_and_a_size() -> None:
    inner = "{do: dwell, duration: 1 ms}"
    for _ in range(4):
        inner = f"{{do: repeat, times: 2, steps: [{inner}]}}"
    assert "nested more than 3 deep" in problem(f"[{inner}]")
    many = ", ".join(["{do: dwell, duration: 1 ms}"] * 201)
    assert "at most 200" in problem(f"[{{do: repeat, times: 2, steps: [{many}]}}]")


MIXED = (
    "[{do: home}, {do: repeat, times: 3, steps: [{do: dwell, duration: 1 ms}, {do: repeat, times: 2, steps:"
    " [{do: scan, axes: {gantry.x: {values: [0, 1]}}, at_each: [{do: dwell, duration: 2 ms}]}]}]},"
    " {do: dwell, duration: 3 ms}]"
)


def written_out(given: list[Step]) -> list[tuple[str, int | None, int]]:
    """The steps one after the other: kind, point, part."""
    found: list[tuple[str, int | None, int]] = []
    for step in given:
        if isinstance(step, Repeat):
            found += written_out(step.steps) * step.times
        elif isinstance(step, Scan):
            found += [
                (kind, point, part)
                for point in range(step.point_count)
                for part, kind in enumerate(["move", *(each.do for each in step.at_each)])
            ]
        else:
            found.append((step.do, None, 0))
    return found


def test_numbers_of_steps_are_those_of_the_written_out_job() -> None:
    given = steps(MIXED)
    order = StepOrder(given, 2)
    expected = written_out(given) * 2
    places = [order.locate(index) for index in range(len(order))]
    assert [(each.kind, each.point, each.part) for each in places] == expected
    assert places[6].passes == ((1, 3), (2, 2)) and places[6].first == 6
    assert places[9].describe() == "step 7 (scan), point 2 of 2 (dwell), pass 1 of 3, pass 2 of 2"
    assert count_reports(given) == 1 + 3 * 3 + 1
    with pytest.raises(IndexError):
        order.locate(len(order))


def test_what_remains_from_each_step_on() -> None:
    given = steps(MIXED)
    order, whole = StepOrder(given, 2), written_out(given) * 2
    for index in range(len(order)):
        rest = written_out([each.step for each in order.list_remaining(index)])
        place = order.locate(index)
        # A scan that has begun is whole again.
        assert rest == whole[index - (index - place.first if place.point is not None else 0) :], index
        assert order.list_remaining(index)[0].first == index
    assert order.list_remaining(len(order)) == []


def test_a_hundred_million_steps_take_no_time() -> None:
    order = StepOrder(steps("[{do: repeat, times: 10000000, steps: [{do: scan, axes: {gantry.x: {values: [0, 1]}}}]}]"))
    assert len(order) == 20_000_000 and order.locate(19_999_999).passes == ((10_000_000, 10_000_000),)
    assert isinstance(order.list_remaining(19_999_998)[0].step, Repeat)


def test_a_point_is_a_move_with_the_options_of_the_scan() -> None:
    (scan,) = steps("[{do: scan, axes: {gantry.x: {values: [0]}}, speed: 50%, sync: phase, max_start_skew: 5 ms}]")
    assert isinstance(scan, Scan)
    made = scan.make_move({"gantry.x": 0.1})
    assert made == Move(to={"gantry.x": 0.1}, speed=0.5, sync="phase", max_start_skew="5 ms")


# Files of points


def test_a_file_is_read_in_blocks_in_the_units_of_the_axes(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    rows = [f"{k / 10}, {k} um, {k} arcmin" for k in range(5000)]
    path.write_text("\ufeffgantry.x,stage.u, stage.r\n\n" + "\n".join(rows), encoding="utf-8")
    file = PointFile(path, UNITS)
    blocks = list(file.read_blocks())
    assert [len(each) for each in blocks] == [4096, 904]
    assert [each.axis for each in file.axes] == ["gantry.x", "stage.u", "stage.r"]
    assert blocks[0][3].tolist() == [0.3, 0.003, 0.05]


def test_a_file_of_another_country_has_commas_as_decimal_signs(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("gantry.x;stage.u\n0,5;-1,25 um\n2;1e-3\n", encoding="utf-8")
    (block,) = PointFile(path, UNITS).read_blocks()
    assert block.tolist() == [[0.5, -0.00125], [2.0, 0.001]]


@pytest.mark.parametrize(
    ("lines", "wrong_line"), [(50_000, 31_204), pytest.param(1_000_000, 731_204, marks=pytest.mark.nightly)]
)
def test_the_wrong_line_of_many_is_named(tmp_path: Path, lines: int, wrong_line: int) -> None:
    path = tmp_path / "p.csv"
    with path.open("w", encoding="utf-8") as file:
        file.write("gantry.x,stage.u\n")
        for line in range(2, lines + 2):
            file.write("1.25,0,5\n" if line == wrong_line else "1.25,0.5\n")
    read = 0
    with pytest.raises(FileError) as wrong:
        for block in PointFile(path, UNITS).read_blocks():
            read += len(block)
    assert str(wrong.value) == f"{path}:{wrong_line}: has 3 values for 2 axes" and read == lines


def test_many_wrong_lines_end_the_reading(tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_text("gantry.x\n" + "x\n" * 10_000, encoding="utf-8")
    with pytest.raises(FileError) as wrong:
        list(PointFile(path, UNITS).read_blocks())
    assert len(wrong.value.problems) == 50


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", ":1: the first line must name the axes"),
        (b"gantry.x\n", "has no points"),
        (b"gantry.x,gantry.x\n1,2\n", ":1: gantry.x is named twice"),
        (b"gantry.x:stage.u\n1:2\n", ":1: the fleet has no axis gantry.x:stage.u; its axes are: gantry.x, stage.u"),
        (b"gantry.x;stage.u\n1,5,0;2\n", ":2: column 1 (gantry.x): '1,5,0' is not a quantity"),
        (b"gantry.x\n1\n5 \xb5m\n", ":3: byte 0xb5 is not UTF-8 text; save the file as UTF-8"),
        ("gantry.x\n1\n".encode("utf-16"), ":1: is UTF-16 text; save it as UTF-8"),
        (b"gantry.x\n1,5\n", ":2: has 2 values for 1 axes"),
        (b'gantry.x\n"1,5"\n', ":2: column 1 (gantry.x): '1,5' is not a quantity; write the number with a point: 1.5"),
        (b"gantry.x\n1e16\n", ":2: column 1 (gantry.x): found '1e16'; the number must be within"),
        (b"gantry.x\n1e400\n", ":2: column 1 (gantry.x): found '1e400'; the number must be finite"),
        ("gantry.x\n١\n".encode(), ":2: column 1 (gantry.x): '١' is not a quantity"),
    ],
)
def test_wrong_files_are_explained(content: bytes, text: str, tmp_path: Path) -> None:
    path = tmp_path / "p.csv"
    path.write_bytes(content)
    with pytest.raises(FileError) as wrong:
        list(PointFile(path, UNITS).read_blocks())
    assert text in str(wrong.value)


def test_a_file_of_points_stands_beside_the_job_file(tmp_path: Path) -> None:
    path = tmp_path / "scan.job.yaml"
    scan = "{do: repeat, times: 2, steps: [{do: scan, points: {file: p.csv}}]}"
    path.write_text(f"schema: tutti.job/1\nname: a\nsteps: [{scan}]\n", encoding="utf-8")
    (outer,) = load_job(path).steps
    assert isinstance(outer, Repeat) and isinstance(outer.steps[0], Scan) and outer.steps[0].points is not None
    assert outer.steps[0].points.file == str(tmp_path / "p.csv")


def test_extremes_are_the_same_however_the_points_are_divided() -> None:
    axes = [PointAxis(axis="gantry.x", unit=Unit.MM), PointAxis(axis="stage.u", unit=Unit.MM)]
    rows = np.array([[0, 5], [3, 5], [1, 4], [3, 9], [0, 9.5]], dtype=np.float64)
    found = []
    for size in (1, 2, 5):
        summary = ColumnSummary(axes)
        for begin in range(0, len(rows), size):
            summary.add_rows(rows[begin : begin + size])
        found.append(summary.make_columns())
    assert found[0] == found[1] == found[2]
    x, u = found[0]
    assert (x.least, x.least_at, x.most, x.most_at, x.first, x.last) == (0, 1, 3, 2, 0, 0)
    assert (x.least_step, x.most_step, u.least_step, u.most_step) == (2, 3, 0, 5)
    with pytest.raises(Refusal, match=r"point 6: the position of stage.u is inf, which is not finite"):
        summary.add_rows(np.array([[0, np.inf]]))


# scanspec


def test_without_scanspec_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "scanspec.core", None)
    with pytest.raises(Refusal, match=r"pip install 'tutti\[scanspec\]'") as refused:
        SpecPoints({"type": "Line"}, UNITS)
    assert refused.value.code == "no-scanspec"


def test_a_scanspec_gives_its_midpoints() -> None:
    pytest.importorskip("scanspec")
    line = {"type": "Linspace", "axis": "gantry.x", "start": 0.0, "stop": 2.0, "num": 3}
    inner = {"type": "Snake", "spec": {"type": "Linspace", "axis": "stage.u", "start": 0.0, "stop": 1.0, "num": 2}}
    points = SpecPoints({"type": "Product", "outer": line, "inner": inner}, UNITS)
    assert [each.axis for each in points.axes] == ["gantry.x", "stage.u"]
    assert np.vstack(list(points.read_blocks())).tolist() == [[0, 0], [0, 1], [1, 1], [1, 0], [2, 0], [2, 1]]
    with pytest.raises(Refusal, match=r"has no axis gantry.q"):
        SpecPoints(line | {"axis": "gantry.q"}, UNITS)
    with pytest.raises(Refusal, match="scanspec cannot read the spec"):
        SpecPoints({"type": "Nothing"}, UNITS)
    with pytest.raises(Refusal, match="durations without `Fly`"):
        SpecPoints({"type": "ConstantDuration", "constant_duration": 0.1, "spec": line}, UNITS)
    with pytest.raises(Refusal, match="`Fly`, and points alone are stepped"):
        SpecPoints({"type": "Fly", "spec": line}, UNITS)
