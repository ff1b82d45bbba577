"""Groups with errors by the position of other axes: their maps, and what files may say of their tables."""

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from orchestrator.model.compensation import CrossTable
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet
from orchestrator.model.linear_map import CorrectedMap

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
STAGE = (EXAMPLES / "stage.fleet.yaml").read_text()
TABLE = "x mm, error um, uncertainty um\n0, 0, 0.2\n100, 15, 0.5\n200, -15, 0.2\n"
GRID = "x mm, y mm, error um\n0, -1, 0\n0, 150, 5\n200, -1, 10\n200, 150, 30\n"


def write_stage(folder: Path, table: str = TABLE, *changes: tuple[str, str]) -> Path:
    text = STAGE.replace("stage-y-by-x.csv", "y.csv")
    for old, new in changes:
        assert old in text, old
        text = text.replace(old, new)
    (folder / "y.csv").write_text(table)
    path = folder / "stage.fleet.yaml"
    path.write_text(text)
    return path


def make_map(folder: Path, table: str = TABLE, *changes: tuple[str, str]) -> CorrectedMap:
    corrected = load_fleet(write_stage(folder, table, *changes)).virtual_axes.maps["stage"]
    assert isinstance(corrected, CorrectedMap)
    return corrected


BY_PLANE = ("by: x,", "by: [x, y],")
CUBIC = ("file: y.csv", "file: y.csv, interpolation: cubic")


@pytest.mark.parametrize(("table", "change"), [(TABLE, CUBIC), (TABLE, CUBIC[:1] * 2), (GRID, BY_PLANE)])
def test_a_map_and_its_inverse_and_derivative_agree(tmp_path: Path, table: str, change: tuple[str, str]) -> None:
    corrected = make_map(tmp_path, table, change)
    places = np.random.default_rng(1).uniform((-5, -5), (205, 155), (200, 2))
    straight = corrected.straighten(places)
    assert np.abs(corrected.turn(straight) - places).max() < 1e-12
    for place in places.tolist():
        virtual = corrected.to_virtual(list(map(Fraction, place)))
        assert (
            max(abs(float(value) - end) for value, end in zip(corrected.to_real(virtual), place, strict=True)) < 1e-12
        )
        assert np.allclose(corrected.observe(place), list(map(float, virtual)), atol=1e-12, rtol=0)
        errors, slopes = corrected.errors.find_at(place)
        row = np.array([place])
        assert np.allclose(corrected.errors.evaluate(row)[0], errors, atol=1e-15, rtol=0)
        assert np.allclose(corrected.errors.find_slopes_at(row)[0], slopes, atol=1e-15, rtol=0)
        step = 1e-5
        for column in range(2):
            ends = [[end + sign * step * (number == column) for number, end in enumerate(place)] for sign in (-1, 1)]
            low, high = (np.array(corrected.observe(end)) for end in ends)
            assert np.allclose((high - low) / (2 * step), np.array(corrected.find_rows(place))[:, column], atol=1e-6)


@pytest.mark.parametrize(("table", "change"), [(TABLE, CUBIC), (GRID, BY_PLANE)])
def test_ranges_and_slopes_hold_everywhere(tmp_path: Path, table: str, change: tuple[str, str]) -> None:
    errors = make_map(tmp_path, table, change).errors
    draw = np.random.default_rng(2)
    for _ in range(20):
        corners = np.sort(draw.uniform((0, 0), (200, 150), (2, 2)), axis=0)
        box = [(float(low), float(high)) for low, high in corners.T]
        values = errors.evaluate(draw.uniform(corners[0], corners[1], (500, 2)))[:, 1]
        low, high = errors.find_ranges(box)[1]
        assert low - 1e-15 <= values.min() and values.max() <= high + 1e-15
        assert errors.find_spans(box, [0])[1] == pytest.approx(high - low)
        at_extremes = [
            errors.evaluate(np.array([[x, y]]))[0, 1]
            for x in errors.list_extremes(0, box)
            for y in (*errors.list_extremes(1, box), box[1][0])
        ]
        assert min(at_extremes) == pytest.approx(low) and max(at_extremes) == pytest.approx(high)
    slopes = np.abs(errors.find_slopes_at(draw.uniform((-10, -10), (210, 160), (2000, 2))))
    assert (slopes.max(axis=0) <= errors.steepest + 1e-15).all() and slopes.max() > 0.5 * errors.steepest.max()


def test_squareness_leans_the_second_axis_towards_the_first(tmp_path: Path) -> None:
    corrected = make_map(tmp_path, TABLE, ("squareness: 0.05 mrad", "squareness: 1 mrad"))
    x, y = corrected.observe([0.0, 100.0])
    assert x == pytest.approx(0.1, abs=1e-6) and y == pytest.approx(100 - 5e-5, abs=1e-7)
    assert corrected.errors.uncertainties == [0.0, 0.0005]


@pytest.mark.parametrize(
    ("table", "line", "text"),
    [
        ("x mm, error um\n0, 0\n", 1, "has 1 rows; a table needs at least 2"),
        ("x mm, error um\n0, 0\n100, 5\n50, 3\n200, 0\n", 4, "position 50 is not above the one before it, 100"),
        (
            "x mm, error um\n0, 0\n100, 5\n200, 3000\n",
            4,
            "the slope from the row before is 0.03, above max_slope 0.01",
        ),
        (
            "x mm, error um\n1, 0\n200, 0\n",
            2,
            "the table ends at x 1 mm, and the soft limits of its real axis reach to 0",
        ),
        ("x mm, error um\n0, 0\n199, 0\n", 3, "the table ends at x 199 mm"),
        ("x mm, error um\n0, nan\n200, 0\n", 2, "error 'nan'"),
        ("x mm, error um\n0, 0\n200\n", 3, "has 1 values for 2 columns"),
        ("x mm, error um, uncertainty um\n0, 0, -1\n200, 0, 0\n", 2, "is below 0"),
        ("position mm, error um\n0, 0\n200, 0\n", 1, "name two or three columns with their units: `x mm, error um"),
        ("x mm, error deg\n0, 0\n200, 0\n", 1, "deg"),
        ("", 1, "is empty"),
    ],
)
def test_a_wrong_table_is_reported_with_its_line(tmp_path: Path, table: str, line: int, text: str) -> None:
    with pytest.raises(FileError) as caught:
        load_fleet(write_stage(tmp_path, table))
    (problem,) = caught.value.problems
    assert (Path(problem.file).name, problem.line) == ("y.csv", line), problem
    assert text in problem.text


@pytest.mark.parametrize(
    ("table", "line", "text"),
    [
        ("x mm, y mm, error um\n0, -1, 0\n0, 150, 5\n200, -1, 10\n", 4, "the rows end, where 200, 150 would be next"),
        (
            "x mm, y mm, error um\n0, -1, 0\n0, 150, 5\n200, -1, 10\n200, 149, 3\n",
            5,
            "x and y 200, 149, where 200, 150",
        ),
        (f"{GRID}200, 150, 30\n", 6, "the grid is not rectangular"),
        ("x mm, y mm, error um\n0, -1, 0\n200, -1, 5\n", 2, "the grid needs two or more rising values of y"),
        ("x mm, y mm, error um\n0, 150, 0\n0, -1, 5\n200, 150, 10\n200, -1, 3\n", 2, "sort the rows by x, then by y"),
        (
            "x mm, y mm, error um\n0, -1, 0\n0, 150, 3000\n200, -1, 0\n200, 150, 0\n",
            3,
            "the slope along y from the row",
        ),
        ("x mm, y mm, error um\n0, 0, 0\n0, 150, 5\n200, 0, 10\n200, 150, 0\n", 2, "the table ends at y 0 mm"),
        ("x mm, error um\n0, 0\n200, 5\n", 1, "name three or four columns with their units: `x mm, y mm, error um"),
    ],
)
def test_a_wrong_grid_is_reported_with_its_line(tmp_path: Path, table: str, line: int, text: str) -> None:
    with pytest.raises(FileError) as caught:
        load_fleet(write_stage(tmp_path, table, BY_PLANE))
    assert text in caught.value.problems[0].text, caught.value.problems
    assert (Path(caught.value.problems[0].file).name, caught.value.problems[0].line) == ("y.csv", line)


@pytest.mark.parametrize(
    ("change", "text"),
    [
        (("file: y.csv", "file: z.csv"), "cannot be read: No such file"),
        (("by: x,", "by: z,"), "tables.straightness names z, which is none of its axes: x, y"),
        (("by: x,", "by: y,"), "errors of y by its own position are the `correction` of its real axis"),
        (("by: x,", "by: [x, x],"), "`by` names x twice"),
        (("squareness: 0.05 mrad", "squareness: 3 deg"), "squareness is 3 deg, at most 10 mrad"),
        (("squareness: 0.05 mrad", "squareness: 3 mm"), "mm is a unit of length"),
        (("      y: {unit: mm}", "      y: {unit: um}"), "y is in um, and bench.x in mm"),
        (("of: [bench.x, bench.y]", "of: [bench.x]"), "2 virtual axes of 1 real ones"),
        (("        soft_limits: {min: 0, max: 200}\n", ""), "the real axis of x needs soft_limits"),
        (("        soft_limits: {min: -1, max: 150}\n", ""), "bench.y needs soft_limits"),
        (("kind: corrected", "kind: linear"), "`kind: linear` needs `matrix`"),
        (("file: y.csv}", "file: y.csv, max_slope: 0.2}"), "max_slope"),
    ],
)
def test_a_wrong_group_is_reported(tmp_path: Path, change: tuple[str, str], text: str) -> None:
    with pytest.raises(FileError) as caught:
        load_fleet(write_stage(tmp_path, TABLE, change))
    assert text in str(caught.value), caught.value


def make_fleet(folder: Path, **tables: dict[str, Any]) -> Fleet:
    plain = load_fleet(write_stage(folder)).to_plain()
    plain["virtual"]["stage"]["tables"] |= tables
    return Fleet.model_validate(plain)


def test_tables_that_are_too_steep_together_are_refused(tmp_path: Path) -> None:
    steep = {"axis": "y", "by": "x", "points": [[0, 0], [200, 12]], "max_slope": 0.1}
    make_fleet(tmp_path, first=steep)
    with pytest.raises(ValidationError, match=r"the tables of y change its error by 0\.12 of what the others move"):
        make_fleet(tmp_path, first=steep, second=steep)


def test_a_table_that_was_not_read_is_refused() -> None:
    table = CrossTable.model_validate({"axis": "y", "by": "x", "file": "y.csv"})
    (problem,) = table.find_problems([[Fraction(0), Fraction(1)]], "mm")
    assert "was not read with the fleet" in problem.text


def test_corrected_axes_are_no_axes_of_other_groups(tmp_path: Path) -> None:
    plain = load_fleet(write_stage(tmp_path)).to_plain()
    turned = {
        "kind": "rotation",
        "angle": 30,
        "of": ["stage.x", "stage.y"],
        "axes": {"u": {"unit": "mm"}, "v": {"unit": "mm"}},
    }
    with pytest.raises(ValidationError, match="which is corrected; name real axes"):
        Fleet.model_validate({**plain, "virtual": {**plain["virtual"], "turned": turned}})


def test_tables_are_a_part_of_the_configuration_of_their_controllers(tmp_path: Path) -> None:
    digests = {
        load_fleet(write_stage(tmp_path, TABLE, *changes)).controllers["bench"].digest
        for changes in ([], [("0.05 mrad", "0.06 mrad")], [CUBIC])
    }
    other = load_fleet(write_stage(tmp_path, TABLE.replace("15, 0.5", "14, 0.5"))).controllers["bench"].digest
    assert len(digests | {other}) == 4
    fleet = load_fleet(write_stage(tmp_path))
    again = Fleet.model_validate(fleet.to_plain())
    assert again.controllers["bench"].digest == fleet.controllers["bench"].digest
    assert type(fleet.controllers["bench"]).model_validate(fleet.controllers["bench"].to_plain()).digest in digests
