"""Tables of errors of axes in CSV files beside a fleet file: their rows are put in the place of the name of the file.

The first line names the columns with their units, `position mm, error um` and perhaps `uncertainty um`, in a table by
other axes their names in the place of `position`; each other line is a row. Empty lines are skipped. What is wrong with
a row is reported with its line there.
"""

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from orchestrator.model.files.yaml_reader import explain_mark
from orchestrator.model.numbers import MAX_TEXT
from orchestrator.model.problems import Problem
from orchestrator.model.text.separators import find_separator, read_cell
from orchestrator.model.units import Unit, UnitError, parse_quantity

ERRORS = ("error", "uncertainty")
MAX_BYTES = 1_000_000
Place = tuple[str | int, ...]
PLACE_PARTS = (5, 4)  # of a table: controllers, name, axes, name, correction; virtual, name, tables, name


@dataclass(frozen=True, slots=True)
class TableProblem:
    """A mistake in a table. line: counts from 1; 0: the whole file."""

    file: str
    line: int
    text: str


@dataclass(frozen=True, slots=True)
class TableFile:
    """A table that was read: rows in the unit of its axis, as exact numbers, with their lines."""

    name: str
    rows: list[list[str]] = field(default_factory=list[list[str]])
    lines: list[int] = field(default_factory=list[int])
    problems: list[TableProblem] = field(default_factory=list[TableProblem])

    def fill(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """The options that name it, with its rows in the place of the name."""
        return {**{key: entry for key, entry in options.items() if key != "file"}, "points": self.rows}

    def note(self, line: int, text: str) -> None:
        """Add a mistake."""
        self.problems.append(TableProblem(self.name, line, text))


@dataclass(frozen=True, slots=True)
class FleetTables:
    """The tables of a fleet file. value: the file with their rows in it. tables: by their place there."""

    value: Mapping[str, Any]
    tables: Mapping[tuple[str | int, ...], TableFile]

    @property
    def problems(self) -> list[TableProblem]:
        """All mistakes that reading them has shown."""
        return [problem for table in self.tables.values() for problem in table.problems]

    def is_known(self, problem: Problem) -> bool:
        """Whether a mistake of the fleet is only that a table could not be read, which is one of `problems`."""
        table = self.tables.get(problem.place[:-1])
        return table is not None and bool(table.problems) and problem.place[-1] == "file"

    def locate(self, problem: Problem) -> TableProblem | None:
        """A mistake of the fleet that is in a row of a table, with its line there; None for another one."""
        count = next((count for count in PLACE_PARTS if problem.place[:count] in self.tables), 0)
        table, path = self.tables.get(problem.place[:count]), problem.place[count:]
        if table is None or path[:1] != ("points",):
            return None
        number = path[1] if len(path) > 1 else None
        return TableProblem(table.name, table.lines[number] if isinstance(number, int) else 1, problem.text)


def read_tables(value: Mapping[str, Any], find_folder: Callable[[Place], Path]) -> FleetTables:
    """Read all tables that a fleet file names. find_folder: where the table of a place is looked for.

    A table of an axis that has mistakes is left out of the value; one of a group keeps the name of its file, see
    `is_known`.
    """
    tables: dict[Place, TableFile] = {}
    controllers: dict[str, Any] = dict(_read_mapping(value, "controllers"))
    for name in controllers:
        axes = dict(_read_mapping(controllers[name], "axes"))
        for axis, fields in axes.items():
            correction = _read_mapping(fields, "correction")
            table_place = ("controllers", name, "axes", axis, "correction")
            table = _read_named(find_folder(table_place), correction, ("position",), fields)
            if table is None:
                continue
            tables[table_place] = table
            other_fields = {key: entry for key, entry in fields.items() if key != "correction"}
            axes[axis] = other_fields if table.problems else {**other_fields, "correction": table.fill(correction)}
        controllers[name] = {**controllers[name], "axes": axes} if axes else controllers[name]
    groups: dict[str, Any] = dict(_read_mapping(value, "virtual"))
    for name, group in groups.items():
        filled_tables = dict(_read_mapping(group, "tables"))
        for key, options in list(filled_tables.items()):
            axis = _read_mapping(_read_mapping(group, "axes"), _read_text(options, "axis"))
            table_place = ("virtual", name, "tables", key)
            table = _read_named(find_folder(table_place), options, _read_by(options), axis)
            if table is None:
                continue
            tables[table_place] = table
            filled_tables[key] = options if table.problems else table.fill(options)
        groups[name] = {**group, "tables": filled_tables} if filled_tables else group
    return FleetTables({**value, "controllers": controllers, "virtual": groups} if tables else value, tables)


def _read_named(folder: Path, options: Any, by: Sequence[str], axis: Any) -> TableFile | None:
    """The table of a file that options name; None where they name none. by: the names of its positions. axis: whose
    unit it has."""
    file = _read_text(options, "file")
    is_named = bool(file and by) and "points" not in options
    unit = cast(Mapping[str, Any], axis).get("unit") if isinstance(axis, Mapping) else None
    return _read_table(folder / file, by, unit) if is_named else None


def _read_text(value: Any, key: str) -> str:
    """A text in a mapping; empty where there is none."""
    text = cast(Mapping[str, Any], value).get(key) if isinstance(value, Mapping) else None
    return text if isinstance(text, str) else ""


def _read_by(options: Any) -> list[str]:
    """The axes by whose positions a table is; none where that is wrong, which the model reports."""
    names = cast(Mapping[str, Any], options).get("by") if isinstance(options, Mapping) else None
    names = [names] if isinstance(names, str) else names
    return [str(name) for name in cast(list[Any], names)] if isinstance(names, list) else []


def _read_mapping(value: Any, key: str) -> Mapping[str, Any]:
    """A mapping in a mapping; empty where either is something else, which the model reports."""
    inner = cast(Mapping[str, Any], value).get(key) if isinstance(value, Mapping) else None
    return cast(Mapping[str, Any], inner) if isinstance(inner, Mapping) else {}


def _read_table(path: Path, by: Sequence[str], unit_name: Any) -> TableFile:
    table = TableFile(str(path))
    try:
        unit = Unit(unit_name)
    except ValueError:
        unit = Unit.MM  # the wrong unit is reported by its own field
    try:
        data = path.read_bytes() if path.stat().st_size <= MAX_BYTES else b""
    except (OSError, ValueError) as error:
        text = error.strerror if isinstance(error, OSError) else str(error)
        table.note(0, f"cannot be read: {text}; correct `file`, which is looked for beside the fleet file")
        return table
    mark = explain_mark(data[:4])
    if mark or not data.strip():
        text = f"is empty, or larger than {MAX_BYTES} bytes; its first line is e.g. `{_make_header(by)}`"
        table.note(1, mark or text)
        return table
    try:
        lines = data.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        table.note(0, "is no text in UTF-8; save it as CSV in UTF-8")
        return table
    separator = find_separator(lines[0])
    columns = (*by, *ERRORS)
    units = _read_header(table, next(csv.reader(lines[:1], delimiter=separator)), by, unit)
    for number, line in enumerate(lines[1:], 2):
        if line.strip() and units:
            cells = [read_cell(cell, separator) for cell in next(csv.reader([line], delimiter=separator))]
            _read_row(table, number, cells, dict(zip(columns, units, strict=False)), unit)
    return table


def _make_header(by: Sequence[str]) -> str:
    return ", ".join([*(f"{name} mm" for name in by), *(f"{name} um" for name in ERRORS)])


def _read_header(table: TableFile, cells: Sequence[str], by: Sequence[str], unit: Unit) -> list[str]:
    """The units of the columns; none with a mistake."""
    parts = [cell.split() for cell in cells]
    names = tuple(words[0] if words else "" for words in parts)
    columns = (*by, *ERRORS)
    if names not in (columns, columns[:-1]) or any(len(words) != 2 for words in parts):
        header, count = ", ".join(cells)[:MAX_TEXT], "two or three" if len(by) == 1 else "three or four"
        text = f"the first line is `{header}`; name {count} columns with their units: `{_make_header(by)}`"
        table.note(1, text)
        return []
    units = [words[1] for words in parts]
    for cell, cell_unit in zip(cells, units, strict=True):
        try:
            parse_quantity(f"0 {cell_unit}", unit)
        except UnitError as error:
            table.note(1, f"column `{cell.strip()}`: {error}")
            return []
    return units


def _read_row(table: TableFile, line: int, cells: Sequence[str], units: Mapping[str, str], unit: Unit) -> None:
    if len(cells) != len(units):
        table.note(line, f"has {len(cells)} values for {len(units)} columns; write one for each")
        return
    row: list[str] = []
    for cell, (name, cell_unit) in zip(cells, units.items(), strict=True):
        try:
            row.append(str(parse_quantity(f"{cell.strip()} {cell_unit}", unit)))
        except UnitError as error:
            table.note(line, f"{name} {cell.strip()[:MAX_TEXT]!r}: {error}")
            return
    table.rows.append(row)
    table.lines.append(line)
