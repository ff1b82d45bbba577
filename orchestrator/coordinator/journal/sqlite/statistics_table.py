"""The statistics in the journal: figures by day, kind and subject, to which only increments are added."""

import sqlite3
from collections.abc import Iterable

from orchestrator.coordinator.journal.facts import WORST, StatisticsRow
from orchestrator.coordinator.journal.sqlite.transaction import DATABASE_ERRORS, Transaction, make_unusable_error


class StatisticsTable:
    """`StatisticsStore`: the table of statistics in one database. Every method raises `JournalError`."""

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._db = db
        self._path = path

    def add_rows(self, rows: Iterable[StatisticsRow]) -> None:
        add = "INSERT INTO statistics VALUES (?, ?, ?, ?, ?) ON CONFLICT DO UPDATE SET value = "
        summed_string, worst = f"{add} value + excluded.value", f"{add} max(value, excluded.value)"
        with Transaction(self._db, self._path):
            for row in rows:
                self._db.execute(worst if row.figure.startswith(WORST) else summed_string, row)

    def read_rows(self, since_day: str) -> list[StatisticsRow]:
        query = "SELECT * FROM statistics WHERE day >= ? ORDER BY day, kind, subject, figure"
        try:
            return [StatisticsRow(*row) for row in self._db.execute(query, (since_day,)).fetchall()]
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None
