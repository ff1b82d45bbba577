"""The alarms in the journal: their present states, the history of their changes, and the notices that are pending."""

import sqlite3
from collections.abc import Iterable, Sequence
from typing import Any
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.facts import AlarmChange, AlarmNotice
from orchestrator.coordinator.journal.sqlite.transaction import DATABASE_ERRORS, Transaction, make_unusable_error
from orchestrator.model.operation.alarms import MAX_HISTORY, AlarmRecord


class AlarmTables:
    """`AlarmJournal`: the tables of alarms in one database. Every method raises `JournalError`."""

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._db = db
        self._path = path

    def store_changes(self, changes: Sequence[AlarmChange], forgotten: Iterable[str] = ()) -> None:
        with Transaction(self._db, self._path):
            for record, notify in changes:
                body = record.model_dump_json()
                crc = crc32(body.encode())
                self._db.execute("INSERT OR REPLACE INTO alarms VALUES (?, ?, ?)", (record.id, body, crc))
                self._db.execute("INSERT INTO alarm_history (body) VALUES (?)", (body,))
                if notify:
                    values = (record.change, body, crc)
                    self._db.execute("INSERT OR REPLACE INTO alarm_notices VALUES (?, ?, ?, 0)", values)
            self._db.executemany("DELETE FROM alarms WHERE id = ?", [(alarm_id,) for alarm_id in forgotten])
            newest = "(SELECT max(number) FROM alarm_history)"
            self._db.execute(f"DELETE FROM alarm_history WHERE number <= {newest} - ?", (MAX_HISTORY,))

    def store_tries(self, change: str, tries: int) -> None:
        with Transaction(self._db, self._path):
            self._db.execute("UPDATE alarm_notices SET tries = ? WHERE change = ?", (tries, change))

    def delete_notice(self, change: str) -> None:
        with Transaction(self._db, self._path):
            self._db.execute("DELETE FROM alarm_notices WHERE change = ?", (change,))

    def load_alarms(self) -> tuple[list[AlarmRecord], list[str]]:
        records: list[AlarmRecord] = []
        damaged_names: list[str] = []
        for name, body, crc in self._select_rows("SELECT id, body, crc FROM alarms ORDER BY id"):
            record = _read_record(body, crc)
            if record is not None and record.id == name:
                records.append(record)
            else:
                damaged_names.append(name)
        return records, damaged_names

    def load_notices(self) -> list[AlarmNotice]:
        rows = self._select_rows("SELECT body, crc, tries FROM alarm_notices ORDER BY rowid")
        records = [(_read_record(body, crc), tries) for body, crc, tries in rows]
        return [AlarmNotice(record, tries) for record, tries in records if record is not None]

    def load_history(self, limit: int) -> list[AlarmRecord]:
        rows = self._select_rows("SELECT body FROM alarm_history ORDER BY number DESC LIMIT ?", (limit,))
        return [record for (body,) in rows if (record := _read_record(body)) is not None]

    def _select_rows(self, query: str, values: tuple[Any, ...] = ()) -> list[Any]:
        try:
            return self._db.execute(query, values).fetchall()
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None


def _read_record(body: str, crc: int | None = None) -> AlarmRecord | None:
    """The alarm of a row; None if it is damaged."""
    if crc is not None and crc32(body.encode()) != crc:
        return None
    try:
        return AlarmRecord.read_stored(body)
    except ValidationError:
        return None
