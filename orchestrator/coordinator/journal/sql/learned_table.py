"""Learned times in the journal, read one by one: a damaged one is left out, and learned again."""

from collections.abc import Iterable
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.sql.database import JournalPart, make_upsert
from orchestrator.model.operation.learned import LearnedTimes

_STORE = make_upsert("learned", ["controller"], ["body", "crc"])


class LearnedTable(JournalPart):
    """`LearnedStore`: the table of learned times in one database. Every method raises `JournalError`."""

    def save_times(self, times: Iterable[LearnedTimes]) -> None:
        with self._db.transaction():
            for entry in times:
                body = entry.model_dump_json()
                self._db.write(_STORE, (entry.controller, body, crc32(body.encode())))

    def load_times(self) -> list[LearnedTimes]:
        times: list[LearnedTimes] = []
        for body, crc in self._db.select("SELECT body, crc FROM learned ORDER BY controller"):
            try:
                if crc32(body.encode()) == crc:
                    times.append(LearnedTimes.read_stored(body))
            except ValidationError:
                continue
        return times

    def forget_times(self, controllers: Iterable[str]) -> None:
        with self._db.transaction():
            self._db.write_many("DELETE FROM learned WHERE controller = ?", [(name,) for name in controllers])
