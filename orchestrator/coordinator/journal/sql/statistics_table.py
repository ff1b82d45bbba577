"""The statistics in the journal: figures by day, kind and subject, to which only increments are added."""

from collections.abc import Iterable

from orchestrator.coordinator.journal.facts import WORST, StatisticsRow
from orchestrator.coordinator.journal.sql.database import JournalPart, make_insert

_INSERT = f"{make_insert('statistics', StatisticsRow._fields)} ON CONFLICT (day, kind, subject, figure) DO UPDATE"
_ADD = f"{_INSERT} SET value = statistics.value + excluded.value"
_KEEP_WORST = f"{_INSERT} SET value = excluded.value WHERE excluded.value > statistics.value"


class StatisticsTable(JournalPart):
    """`StatisticsStore`: the table of statistics in one database. Every method raises `JournalError`."""

    def add_rows(self, rows: Iterable[StatisticsRow]) -> None:
        with self._db.transaction():
            for row in rows:
                self._db.write(_KEEP_WORST if row.figure.startswith(WORST) else _ADD, row)

    def read_rows(self, since_day: str) -> list[StatisticsRow]:
        names = ", ".join(StatisticsRow._fields)
        query = f"SELECT {names} FROM statistics WHERE day >= ? ORDER BY day, kind, subject, figure"
        return [StatisticsRow(*row) for row in self._db.select(query, (since_day,))]
