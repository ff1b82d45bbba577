"""Tables of points: a line of names, then one line a point. With a first column `t` (s) the table has its own times."""

import csv
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

from orchestrator.model.numbers import SECONDS, split_number
from orchestrator.model.paths.files.base.imported import ImportedSteps, format_number
from orchestrator.model.paths.files.base.problems import ImportProblems
from orchestrator.model.paths.origin import Place
from orchestrator.model.paths.pieces import MAX_ROWS
from orchestrator.model.text.separators import find_separator, read_cell
from orchestrator.model.units import check_quantity

TIME = "t"


class ColumnReader:
    """Reads one table. axes: by name of a column, the axis of the fleet; a column that is not named is an axis itself.

    Numbers are in the unit of their axis, or have their own: `12.5 mm`; times in s, or in theirs: `500 ms`.
    """

    def __init__(self, name: str, axes: Mapping[str, str]) -> None:
        self._given = axes
        self._problems = ImportProblems(name)
        self._has_times = False

    def read_steps(self, lines: Sequence[str]) -> list[dict[str, Any]]:
        """The step of a job. Raises `FileError` with every mistake."""
        return self.read_all(lines).steps

    def read_all(self, lines: Sequence[str]) -> ImportedSteps:
        """The same, with the lines of its points. Raises `FileError` with every mistake."""
        separator = find_separator(lines[0] if lines else "")
        rows = csv.reader(lines, delimiter=separator, skipinitialspace=True)
        header = next(rows, list[str]())
        names = [title.strip() for title in header]
        self._has_times = bool(names) and names[0] == TIME
        columns = names[self._has_times :]
        self._check_header(names, columns)
        points: list[list[str]] = []
        places: list[Place] = []
        for row in rows:
            if not row or all(not cell.strip() for cell in row):
                continue
            point = self._read_row(rows.line_num, [read_cell(cell, separator) for cell in row], len(names))
            if point is not None:
                points.append(point)
                places.append(Place(rows.line_num))
        if not self._problems.found and len(points) < 2:
            self._problems.add(
                max(1, rows.line_num), 0, f"a path needs at least 2 points, this table has {len(points)}"
            )
        if len(points) > MAX_ROWS:
            self._problems.add(1, 0, f"the table has {len(points)} points; the maximum is {MAX_ROWS}")
        self._problems.raise_any()
        axes = [self._given.get(column, column) for column in columns]
        pieces, places = self._make_pieces(points, places)
        self._problems.raise_any()
        step = {"do": "path", "axes": axes, "start": points[0][self._has_times :], "pieces": pieces}
        return ImportedSteps(self._problems.file, [step], [places])

    def _check_header(self, names: Sequence[str], columns: Sequence[str]) -> None:
        if not columns:
            self._problems.add(
                1, 0, "the first line must name the axes, e.g. gantry.x, gantry.y; or t, gantry.x for times"
            )
        for number, name in enumerate(names, 1):
            if not name or names.index(name) != number - 1:
                self._problems.add(1, number, f"column {number} needs a name of its own, found {name!r}")
        unused_columns = sorted(self._given.keys() - set(columns))
        if unused_columns:
            self._problems.add(
                1, 0, f"no column is named {unused_columns[0]}; there are: {', '.join(columns) or 'none'}"
            )

    def _read_row(self, line: int, row: Sequence[str], width: int) -> list[str] | None:
        if len(row) != width:
            self._problems.add(line, 0, f"has {len(row)} values, and the first line {width} names")
            return None
        values = [cell.strip() for cell in row]
        first = 1 + self._has_times
        texts = {number: _explain_cell(value) for number, value in enumerate(values[first - 1 :], first)}
        if self._has_times:
            texts[1] = "" if _read_seconds(values[0]) is not None else f"is no time; units: {', '.join(SECONDS)}"
        for number in sorted(number for number, text in texts.items() if text):
            self._problems.add(line, number, f"{values[number - 1][:40]!r} {texts[number]}")
        return None if any(texts.values()) else values

    def _make_pieces(
        self, points: Sequence[list[str]], places: list[Place]
    ) -> tuple[list[dict[str, Any]], list[Place]]:
        if not self._has_times:
            numbers = [number for number in range(1, len(points)) if not _is_same(points[number - 1], points[number])]
            if not numbers:
                self._problems.add(1, 0, "all points of the table are the same: it moves nothing")
            return [{"piece": "line", "to": points[number]} for number in numbers], [places[k] for k in numbers]
        times = [_read_seconds(point[0]) or Fraction(0) for point in points]
        instants = [float(format_number(float(at - times[0]))) for at in times]
        for k in range(1, len(instants)):
            if not instants[k] > instants[k - 1]:
                self._problems.add(places[k].line, 1, f"{points[k][0]!r} is not after {points[k - 1][0]!r}: times grow")
        return [{"piece": "table", "t": instants, "positions": [point[1:] for point in points]}], places[:1]


def _explain_cell(text: str) -> str:
    """What is wrong with a cell; empty: it is a number, perhaps with a unit."""
    try:
        check_quantity(text)
    except ValueError:
        return "is no number, nor a number with a unit"
    return ""


def _read_seconds(text: str) -> Fraction | None:
    """A time, s; None: it is none."""
    parts = split_number(text)
    size = None if parts is None else SECONDS.get(parts[1] or "s")
    return None if parts is None or size is None else Fraction(parts[0]) * size


def _is_same(point: Sequence[str], other: Sequence[str]) -> bool:
    """Whether two points are the same, however their numbers are written."""
    return point == other or all(map(_is_equal, point, other))


def _is_equal(value: str, other: str) -> bool:
    first, second = split_number(value), split_number(other)
    if first is None or second is None:
        return value == other
    return Fraction(first[0]) == Fraction(second[0]) and first[1] == second[1]
