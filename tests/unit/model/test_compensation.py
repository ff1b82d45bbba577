"""Tables of errors and play of axes: the maps, and what files may say."""

from fractions import Fraction
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from orchestrator.model.compensation import Correction, Play, TableRow
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet
from orchestrator.model.tables.error_table import ErrorTable

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
LATHE = (EXAMPLES / "lathe.fleet.yaml").read_text()
TABLE = "position mm, error um, uncertainty um\n-1, 0, 0\n100, 15, 1\n201, -15, 0.5\n"


def write_lathe(folder: Path, table: str = TABLE, *changes: tuple[str, str]) -> Path:
    text = LATHE.replace("lathe-z.csv", "z.csv")
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / "z.csv").write_text(table)
    path = folder / "lathe.fleet.yaml"
    path.write_text(text)
    return path


def make_table(interpolation: str = "linear", seed: int = 1) -> ErrorTable:
    draw = np.random.default_rng(seed)
    rows = [
        TableRow(position=Fraction(5 * k), error=Fraction(round(draw.uniform(-20, 20)), 1000)) for k in range(-2, 40)
    ]
    return Correction.model_validate({"points": rows, "interpolation": interpolation}).table


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_the_map_of_a_table_and_its_inverse_agree(interpolation: str) -> None:
    table = make_table(interpolation)
    positions = np.random.default_rng(2).uniform(-30, 220, 300)
    for position in map(Fraction, positions.tolist()):
        motor = table.invert(position)
        assert abs(motor + table.find_error(motor) - position) < 1e-12
    motors, ratios = table.invert_all(positions)
    assert np.abs(motors - [float(table.invert(Fraction(position))) for position in positions.tolist()]).max() < 1e-9
    step = 1e-6
    slopes = (table.invert_all(positions + step)[0] - table.invert_all(positions - step)[0]) / (2 * step)
    assert np.abs(slopes - ratios).max() < 1e-4


@pytest.mark.parametrize("interpolation", ["linear", "cubic"])
def test_a_table_is_monotone_between_rows_and_as_steep_as_it_states(interpolation: str) -> None:
    table = make_table(interpolation)
    x = np.linspace(-10, 195, 40_001)
    errors = table.evaluate(x)
    assert np.abs(np.diff(errors) / np.diff(x)).max() <= table.slope * (1 + 1e-6)
    at_rows = table.evaluate(np.arange(-10, 196, 5.0))
    for number, (first, last) in enumerate(pairwise(at_rows)):
        between = errors[(x >= -10 + 5 * number) & (x <= -5 + 5 * number)]
        assert min(first, last) - 1e-12 <= between.min() and between.max() <= max(first, last) + 1e-12


def test_counts_of_positions_are_those_of_the_motor_and_back(tmp_path: Path) -> None:
    axis = load_fleet(write_lathe(tmp_path)).axis("lathe.z")
    # At 100 mm of the motor the axis is 15 µm farther.
    assert axis.to_position(100_000) == Fraction("100.015")
    assert axis.to_counts(Fraction("100.015")) == 100_000
    assert axis.to_unit(100_000) == pytest.approx(100.015)
    assert axis.to_length(100_000) == 100
    for counts in range(0, 200_000, 777):
        assert axis.to_counts(axis.to_position(counts)) == counts
    # 200 mm is reached by 200.0148 mm of the motor, rounded inwards; the play is taken up on the way down.
    assert axis.soft_limits_counts is not None and axis.motor_limits_counts is not None
    assert axis.to_position(axis.soft_limits_counts[1]) <= 200 < axis.to_position(axis.soft_limits_counts[1] + 1)
    assert axis.motor_limits_counts == (axis.soft_limits_counts[0] - 20, axis.soft_limits_counts[1])


def test_the_rows_are_part_of_the_configuration_and_the_name_of_their_file_is_not(tmp_path: Path) -> None:
    fleet = load_fleet(write_lathe(tmp_path))
    changed_fleet = load_fleet(write_lathe(tmp_path, TABLE.replace("100, 15", "100, 14")))
    assert fleet.controllers["lathe"].digest != changed_fleet.controllers["lathe"].digest
    assert Fleet.model_validate(fleet.to_plain()).controllers["lathe"].digest == fleet.controllers["lathe"].digest
    (tmp_path / "other.csv").write_text(TABLE)
    renamed = write_lathe(tmp_path, TABLE, ("z.csv", "other.csv"))
    assert load_fleet(renamed).controllers["lathe"].digest == fleet.controllers["lathe"].digest


HEADER = "position mm, error um\n"


@pytest.mark.parametrize(
    ("table", "line", "text"),
    [
        (HEADER + "-1, 0\n50, 1\n50, 2\n201, 0\n", 4, "position 50 is not above the one before it, 50; sort"),
        (HEADER + "-1, 0\n50, 1\n40, 2\n201, 0\n", 4, "position 40 is not above the one before it, 50; sort"),
        (HEADER + "-1, 0\n50, 0\n50.1, 2\n201, 0\n", 4, "slope from the row before is 0.02, above max_slope 0.01"),
        (HEADER + "-1, 0\n\n50, 900\n201, 0\n", 4, "error 0.9 at 50: the slope from the row before is 0.0176"),
        (HEADER + "-1, 0\n150, 2\n", 3, "the table ends at 150 mm, and the soft limits reach to 200 mm; measure"),
        (HEADER + "10, 0\n201, 2\n", 2, "the table ends at 10 mm, and the soft limits reach to 0 mm; measure"),
        (HEADER + "-1, 0\n50, nan\n201, 0\n", 3, "error 'nan': 'nan um' is not a quantity; write a number"),
        (HEADER + "-1, 0\n50, \n201, 0\n", 3, "error '': "),
        (HEADER + "-1, 0\n50\n201, 0\n", 3, "has 1 values for 2 columns; write one for each"),
        ("position mm, error deg\n-1, 0\n201, 0\n", 1, "column `error deg`: deg is a unit of angle"),
        ("position, error\n-1, 0\n201, 0\n", 1, "name two or three columns with their units"),
        ("error um, position mm\n0, -1\n", 1, "name two or three columns with their units"),
        ("position mm, error um, uncertainty um\n-1, 0, 0\n201, 0, -1\n", 3, "uncertainty -0.001 is below 0"),
        (HEADER + "-1, 0\n", 1, "has 1 rows; a table needs at least 2"),
        ("", 1, "is empty"),
    ],
)
def test_mistakes_in_tables_have_their_line_there(tmp_path: Path, table: str, line: int, text: str) -> None:
    with pytest.raises(FileError) as caught:
        load_fleet(write_lathe(tmp_path, table))
    (problem,) = caught.value.problems
    assert problem.file == str(tmp_path / "z.csv") and problem.line == line
    assert text in problem.text, problem.text


@pytest.mark.parametrize(
    ("old", "new", "text"),
    [
        ("{file: z.csv}", "{file: none.csv}", "cannot be read: No such file or directory; correct `file`"),
        ("{file: z.csv}", "{file: z.csv, max_slope: 0.5}", "max_slope: "),
        ("backlash: {amount: 20 um}", "backlash: {amount: 20 deg}", "deg is a unit of angle"),
        (
            "backlash: {amount: 20 um}",
            "backlash: {amount: 20 um, speed: 2 m/s}",
            "backlash.speed (2000) is above limits.velocity (100)",
        ),
        ("backlash: {amount: 20 um}", "backlash: {amount: 20 um, overrun: 10 um}", "would not take up the play"),
        ("        soft_limits: {min: 0, max: 200}\n", "", "needs soft_limits, which the table must cover"),
    ],
)
def test_other_mistakes_are_named_with_a_remedy(tmp_path: Path, old: str, new: str, text: str) -> None:
    with pytest.raises(FileError, match=r"\S") as caught:
        load_fleet(write_lathe(tmp_path, TABLE, (old, new)))
    assert text in str(caught.value)


def test_play_is_followed_and_taken_up() -> None:
    """By a model of two stops, for all ways of a motor."""
    whole = Play(least=0, most=20)
    draw = np.random.default_rng(3)
    axis, motor, play = 7.0, 0, whole
    for _ in range(2000):
        target = int(draw.integers(-60, 60))
        end = play.find_target(motor, target, whole)
        play = play.follow(end - motor, whole)
        axis, motor = min(max(axis, end), end + 20), end
        assert motor + play.least <= axis <= motor + play.most
        if play.least == play.most:
            assert axis == target
    assert play.least == play.most
