"""Tables of points: a line of names, then one line a point. With a first column `t` (s) the table has its own times."""

import csv
from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isfinite
from typing import Any

from orchestrator.model.paths.files.imported import ImportProblems, format_number
from orchestrator.model.paths.pieces import MAX_ROWS

TIME = "t"


class ColumnReader:
    """Reads one table. axes: by name of a column, the axis of the fleet; a column that is not named is an axis itself.

    Numbers are in the unit of their axis, or have their own: `12.5 mm`.
    """

    def __init__(self, name: str, axes: Mapping[str, str]) -> None:
        self._given = axes
        self._problems = ImportProblems(name)

    def read_steps(self, lines: Sequence[str]) -> list[dict[str, Any]]:
        """The step of a job. Raises `FileError` with every mistake."""
        rows = csv.reader(lines, skipinitialspace=True)
        header = next(rows, list[str]())
        names = [title.strip() for title in header]
        has_times = bool(names) and names[0] == TIME
        columns = names[has_times:]
        self._check_header(names, columns)
        points: list[list[str]] = []
        times: list[float] = []
        for row in rows:
            if not row or all(not cell.strip() for cell in row):
                continue
            point = self._read_row(rows.line_num, row, len(names))
            if point is not None:
                times += [float(point[0])] if has_times else []
                points.append(point[has_times:])
        if not self._problems.found and len(points) < 2:
            self._problems.add(
                max(1, rows.line_num), 0, f"a path needs at least 2 points, this table has {len(points)}"
            )
        if len(points) > MAX_ROWS:
            self._problems.add(1, 0, f"the table has {len(points)} points; the maximum is {MAX_ROWS}")
        self._problems.raise_any()
        axes = [self._given.get(column, column) for column in columns]
        return [{"do": "path", "axes": axes, "start": points[0], "pieces": _make_pieces(points, times)}]

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
        wrong = [number for number, value in enumerate(values, 1) if not _is_quantity(value)]
        for number in wrong:
            self._problems.add(line, number, f"{values[number - 1][:40]!r} is no number, nor a number with a unit")
        return None if wrong else values


def _is_quantity(text: str) -> bool:
    number = text.partition(" ")[0]
    try:
        return isfinite(float(number))
    except ValueError:
        return False


def _make_pieces(points: Sequence[list[str]], times: Sequence[float]) -> list[dict[str, Any]]:
    if times:
        begin = times[0]
        return [{"piece": "table", "t": [float(format_number(at - begin)) for at in times], "positions": list(points)}]
    return [{"piece": "line", "to": point} for point_before, point in pairwise(points) if point != point_before]
