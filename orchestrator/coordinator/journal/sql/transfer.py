"""Copies the records of one database into another one."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from orchestrator.coordinator.journal.sql.database import Database, Row, make_insert
from orchestrator.coordinator.journal.sql.export import stream_table


class RowTarget(Protocol):
    """What takes rows; both databases are such."""

    def write_many(self, statement: str, rows: Iterable[Row]) -> None:
        """The same statement for each row. Raises `JournalError`."""
        ...


def copy_tables(source: Database, target: RowTarget, columns: Mapping[str, Sequence[str]]) -> None:
    """Copy all rows of tables, in the caller's transaction. Raises `JournalError`."""
    for table, names in columns.items():
        target.write_many(make_insert(table, names), stream_table(source, table, names))
