"""Tables of text for spreadsheets: CSV (RFC 4180) that none obeys, and that those of other countries read.

A cell that begins with `=`, `+`, `-` or `@` is a formula for spreadsheets: a text from outside, such as the name of a
job, gets an apostrophe before it.
"""

import csv
from collections.abc import Iterable
from typing import Any, NamedTuple, Protocol

FORMULA_SIGNS = ("=", "+", "-", "@", "\t", "\r")


class CsvStyle(NamedTuple):
    """separator: between cells. decimal: the sign before decimals."""

    separator: str = ","
    decimal: str = "."


USUAL_STYLE = CsvStyle()


class TextFile(Protocol):
    """What a table is written to."""

    def write(self, s: str, /) -> object: ...


class CsvTable:
    """Writes rows to a file."""

    def __init__(self, file: TextFile, style: CsvStyle = USUAL_STYLE, line_end: str = "\r\n") -> None:
        self._style = style
        self._writer = csv.writer(file, delimiter=style.separator, lineterminator=line_end)

    def write_row(self, values: Iterable[Any]) -> None:
        """Write one row: no value, and what is no number, are empty cells."""
        self._writer.writerow([self._make_cell(value) for value in values])

    def write_rows(self, rows: Iterable[Iterable[Any]]) -> None:
        """Write rows."""
        for values in rows:
            self.write_row(values)

    def _make_cell(self, value: Any) -> Any:
        if value is None or value != value:  # NaN is not equal to itself
            return ""
        if isinstance(value, bool):
            return str(value).lower()
        if isinstance(value, str):
            return f"'{value}" if value.startswith(FORMULA_SIGNS) else value
        if isinstance(value, float) and self._style.decimal != ".":
            return str(value).replace(".", self._style.decimal)
        return value
