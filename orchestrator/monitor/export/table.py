"""A table of an export: named columns of equal length, with units and further metadata."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeAlias

if TYPE_CHECKING:
    from numpy.typing import NDArray

Column: TypeAlias = "Sequence[Any] | NDArray[Any]"
"""Integers, floats (NaN: no value), texts or booleans; None where a row has no value."""


@dataclass(frozen=True, slots=True)
class DataTable:
    """A table. columns: by name, in order. units: of columns that have one. metadata: texts, or JSON texts."""

    name: str
    columns: Mapping[str, Column]
    units: Mapping[str, str] = field(default_factory=dict[str, str])
    metadata: Mapping[str, str] = field(default_factory=dict[str, str])

    @property
    def row_count(self) -> int:
        return len(next(iter(self.columns.values()), ()))


def make_table(
    name: str, rows: Sequence[Mapping[str, Any]], columns: Sequence[str], units: Mapping[str, str] | None = None
) -> DataTable:
    """A table from rows. columns: their names, in order, also without any row."""
    return DataTable(name, {column: [row.get(column) for row in rows] for column in columns}, units or {})
