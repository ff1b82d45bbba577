"""Tables of other countries: `;` or a tab between cells, and a comma before decimals.

A comma is a decimal sign only where the line of names says that it separates nothing.
"""

import re

_DECIMAL_COMMA = re.compile(r"(\s*[-+]?\d+),(\d+(?:[eE][-+]?\d{1,2})?(?:\s*[^\d\s,;]\S*)?\s*)", re.ASCII)


def find_separator(header: str) -> str:
    """What separates the cells of a table, by its line of names."""
    if "," in header:
        return ","
    return next((separator for separator in (";", "\t") if separator in header), ",")


def read_cell(cell: str, separator: str) -> str:
    """A cell whose decimal comma, if it can have one, is a point."""
    match = None if separator == "," else _DECIMAL_COMMA.fullmatch(cell)
    return cell if match is None else f"{match[1]}.{match[2]}"
