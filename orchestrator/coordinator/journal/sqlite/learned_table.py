"""Learned times in the journal, read one by one: a damaged one is left out, and learned again."""

import sqlite3
from collections.abc import Iterable
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.sqlite.transaction import DATABASE_ERRORS, Transaction, make_unusable_error
from orchestrator.model.operation.learned import LearnedTimes


class LearnedTable:
    """`LearnedStore`: the table of learned times in one database. Every method raises `JournalError`."""

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._db = db
        self._path = path

    def save_times(self, times: Iterable[LearnedTimes]) -> None:
        with Transaction(self._db, self._path):
            for entry in times:
                body = entry.model_dump_json()
                values = (entry.controller, body, crc32(body.encode()))
                self._db.execute("INSERT OR REPLACE INTO learned VALUES (?, ?, ?)", values)

    def load_times(self) -> list[LearnedTimes]:
        try:
            rows = self._db.execute("SELECT body, crc FROM learned ORDER BY controller").fetchall()
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None
        times: list[LearnedTimes] = []
        for body, crc in rows:
            try:
                if crc32(body.encode()) == crc:
                    times.append(LearnedTimes.read_stored(body))
            except ValidationError:
                continue
        return times

    def forget_times(self, controllers: Iterable[str]) -> None:
        with Transaction(self._db, self._path):
            for controller in controllers:
                self._db.execute("DELETE FROM learned WHERE controller = ?", (controller,))
