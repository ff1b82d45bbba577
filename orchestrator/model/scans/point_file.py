"""Read the points of a scan from a CSV file, block by block: every wrong line is named, however long the file is.

The first line names the axes; each other line is a point, with a value for each axis: a number in the axis's unit, or
with a unit of its own. Empty lines are skipped.
"""

import csv
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from orchestrator.model.files.yaml_reader import explain_byte, explain_mark
from orchestrator.model.jobs.files import MAX_PROBLEMS, FileError, FileProblem
from orchestrator.model.numbers import MAX_TEXT
from orchestrator.model.scans.point_summary import ROWS_AT_ONCE, Rows
from orchestrator.model.steps.points import MAX_POINTS, MAX_SCAN_AXES, PointAxis
from orchestrator.model.text.separators import find_separator, read_cell
from orchestrator.model.units import MAX_QUANTITY, Unit, UnitError, parse_quantity


class _RowReader(Protocol):
    """A reader of the module `csv`. line_num: lines that were read."""

    @property
    def line_num(self) -> int: ...

    def __iter__(self) -> Iterator[list[str]]: ...

    def __next__(self) -> list[str]: ...


class PointFile:
    """The points in the file at `path`. units: of all axes of the fleet, in the order of its file."""

    def __init__(self, path: Path, units: Mapping[str, Unit]) -> None:
        self._path = path
        self._units = units
        self._problems: list[FileProblem] = []
        self._odd = False
        self._separator = ","
        self.axes: list[PointAxis] = []
        """The columns, once the first block was read."""

    def read_blocks(self) -> Iterator[Rows]:
        """The points, `ROWS_AT_ONCE` at a time. Raises `FileError` with the wrong lines, at most
        `MAX_PROBLEMS`, when it has read the file."""
        try:
            with self._path.open("rb") as raw_file:
                mark = explain_mark(raw_file.read(4))
            if mark:
                raise self._make_error(1, mark)
            with self._path.open(encoding="utf-8-sig", newline="") as file:
                self._separator = find_separator(file.readline())
                file.seek(0)
                reader: _RowReader = csv.reader(self._watch_lines(file), delimiter=self._separator)
                self._read_header(next(reader, list[str]()))
                yield from self._read_rows(reader)
        except OSError as error:
            raise self._make_error(0, f"cannot be read: {error.strerror}") from None
        except UnicodeDecodeError as error:
            raise self._make_error(*self._find_encoding_error(error)) from None
        except (csv.Error, ValueError) as error:
            if isinstance(error, FileError):
                raise
            raise self._make_error(0, f"is no CSV file: {error}") from None
        if self._problems:
            raise FileError(self._problems)

    def _find_encoding_error(self, error: UnicodeDecodeError) -> tuple[int, str]:
        """The line and the words for a byte that is no UTF-8; the decoder knows its place in a block only."""
        with self._path.open("rb") as file:
            for number, line in enumerate(file, 1):
                try:
                    line.decode()
                except UnicodeDecodeError as line_error:
                    return number, explain_byte(line[line_error.start])
        return 0, explain_byte(error.object[error.start])

    def _watch_lines(self, lines: Iterable[str]) -> Iterator[str]:
        for line in lines:
            # Python reads `1_000` and digits of other scripts as numbers; a job file does not.
            self._odd = self._separator != "," or "_" in line or not line.isascii()
            yield line

    def _read_header(self, header: Sequence[str]) -> None:
        names = [name.strip() for name in header]
        if not names or names == [""]:
            raise self._make_error(1, "the first line must name the axes, e.g. gantry.x,stage.u")
        problems = [
            f"the fleet has no axis {name[:MAX_TEXT] or '(empty)'}; its axes are: {', '.join(self._units)}"
            for name in names
            if name not in self._units
        ]
        problems += [f"{name} is named twice" for name in sorted({name for name in names if names.count(name) > 1})]
        if len(names) > MAX_SCAN_AXES:
            problems = [f"names {len(names)} axes; the maximum is {MAX_SCAN_AXES}"]
        if problems:
            raise FileError(FileProblem(str(self._path), 1, "", text) for text in problems)
        self.axes = [PointAxis(axis=name, unit=self._units[name]) for name in names]

    def _read_rows(self, reader: _RowReader) -> Iterator[Rows]:
        width, count = len(self.axes), 0
        rows: list[list[float]] = []
        lines: list[int] = []
        texts: list[list[str]] = []
        for row in reader:
            if not row:
                continue
            try:
                if self._odd or len(row) != width:
                    raise ValueError
                values = [float(cell) for cell in row]
            except ValueError:
                values = self._read_slowly(reader.line_num, row)
            rows.append(values)
            lines.append(reader.line_num)
            texts.append(row)
            if len(rows) == ROWS_AT_ONCE:
                count += len(rows)
                if count > MAX_POINTS:
                    raise self._make_error(reader.line_num, f"has more than {MAX_POINTS} points; use several scans")
                yield self._check_block(rows, lines, texts)
                rows, lines, texts = [], [], []
        if rows:
            yield self._check_block(rows, lines, texts)
        elif not count:
            raise self._make_error(reader.line_num, "has no points; write one line a point below the names")

    def _check_block(self, rows: list[list[float]], lines: list[int], texts: list[list[str]]) -> Rows:
        block = np.array(rows, dtype=np.float64)
        # NaN is not below anything.
        for row, column in np.argwhere(~(np.abs(block) <= MAX_QUANTITY)).tolist():
            text, number = texts[row][column].strip()[:MAX_TEXT], lines[row]
            if number not in {problem.line for problem in self._problems}:
                demand = (
                    "must be finite" if not np.isfinite(block[row, column]) else f"must be within ±{MAX_QUANTITY:g}"
                )
                self._note_problem(number, column, f"found {text!r}; the number {demand}")
        return block

    def _read_slowly(self, line: int, row: Sequence[str]) -> list[float]:
        """The values of a line that is not only plain numbers; what is wrong is a problem."""
        if len(row) != len(self.axes):
            self._note_problem(line, None, f"has {len(row)} values for {len(self.axes)} axes")
            return [0.0] * len(self.axes)
        values: list[float] = []
        for column, (text, axis) in enumerate(zip(row, self.axes, strict=True)):
            try:
                values.append(float(parse_quantity(read_cell(text, self._separator), axis.unit)))
            except (UnitError, OverflowError) as error:
                explanation = (
                    str(error) if text.strip() else f"is empty; write a number, or one with a unit: 12.5 {axis.unit}"
                )
                self._note_problem(line, column, explanation)
                values.append(0.0)
        return values

    def _note_problem(self, line: int, column: int | None, text: str) -> None:
        """Add a mistake. Raises `FileError` when there are many: what follows is usually the same again."""
        name = "" if column is None else f"column {column + 1} ({self.axes[column].axis})"
        self._problems.append(FileProblem(str(self._path), line, name, text))
        if len(self._problems) >= MAX_PROBLEMS:
            raise FileError(self._problems)

    def _make_error(self, line: int, text: str) -> FileError:
        return FileError([FileProblem(str(self._path), line, "", text)])
