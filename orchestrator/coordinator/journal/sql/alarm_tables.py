"""The alarms in the journal: their present states, the history of their changes, and the notices that are pending."""

from collections.abc import Iterable, Sequence
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.facts import AlarmChange, AlarmNotice
from orchestrator.coordinator.journal.sql.database import JournalPart, make_upsert
from orchestrator.model.operation.alarms import MAX_HISTORY, AlarmRecord

_STORE_ALARM = make_upsert("alarms", ["id"], ["body", "crc"])
_STORE_NOTICE = make_upsert("alarm_notices", ["change"], ["body", "crc", "tries"])
# Numbers without gaps: what is rolled back takes none.
_STORE_CHANGE = "INSERT INTO alarm_history (number, body) SELECT coalesce(max(number), 0) + 1, ? FROM alarm_history"


class AlarmTables(JournalPart):
    """`AlarmJournal`: the tables of alarms in one database. Every method raises `JournalError`."""

    def store_changes(self, changes: Sequence[AlarmChange], forgotten: Iterable[str] = ()) -> None:
        with self._db.transaction():
            for record, notify in changes:
                body = record.model_dump_json()
                crc = crc32(body.encode())
                self._db.write(_STORE_ALARM, (record.id, body, crc))
                self._db.write(_STORE_CHANGE, (body,))
                if notify:
                    self._db.write(_STORE_NOTICE, (record.change, body, crc, 0))
            self._db.write_many("DELETE FROM alarms WHERE id = ?", [(alarm_id,) for alarm_id in forgotten])
            newest = "(SELECT max(number) FROM alarm_history)"
            self._db.write(f"DELETE FROM alarm_history WHERE number <= {newest} - ?", (MAX_HISTORY,))

    def store_tries(self, change: str, tries: int) -> None:
        with self._db.transaction():
            self._db.write("UPDATE alarm_notices SET tries = ? WHERE change = ?", (tries, change))

    def delete_notice(self, change: str) -> None:
        with self._db.transaction():
            self._db.write("DELETE FROM alarm_notices WHERE change = ?", (change,))

    def load_alarms(self) -> tuple[list[AlarmRecord], list[str]]:
        records: list[AlarmRecord] = []
        damaged_names: list[str] = []
        for name, body, crc in self._db.select("SELECT id, body, crc FROM alarms ORDER BY id"):
            record = _read_record(body, crc)
            if record is not None and record.id == name:
                records.append(record)
            else:
                damaged_names.append(name)
        return records, damaged_names

    def load_notices(self) -> list[AlarmNotice]:
        rows = self._db.select("SELECT body, crc, tries FROM alarm_notices ORDER BY rowid")
        records = [(_read_record(body, crc), tries) for body, crc, tries in rows]
        return [AlarmNotice(record, tries) for record, tries in records if record is not None]

    def load_history(self, limit: int) -> list[AlarmRecord]:
        rows = self._db.select("SELECT body FROM alarm_history ORDER BY number DESC LIMIT ?", (limit,))
        return [record for (body,) in rows if (record := _read_record(body)) is not None]


def _read_record(body: str, crc: int | None = None) -> AlarmRecord | None:
    """The alarm of a row; None if it is damaged."""
    if crc is not None and crc32(body.encode()) != crc:
        return None
    try:
        return AlarmRecord.read_stored(body)
    except ValidationError:
        return None
