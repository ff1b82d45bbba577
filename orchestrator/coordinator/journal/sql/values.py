"""Single values of the journal, such as its epoch: each is kept twice, the second time with a checksum."""

from zlib import crc32

from orchestrator.coordinator.journal.sql.database import JournalPart, make_upsert

_READ = "SELECT value, crc FROM meta_copies WHERE key = ? UNION ALL SELECT value, NULL FROM meta WHERE key = ?"
_WRITE = make_upsert("meta", ["key"], ["value"])
_WRITE_COPY = make_upsert("meta_copies", ["key"], ["value", "crc"])


class StoredValues(JournalPart):
    """The values in one database. Every method raises `JournalError`; what is written belongs to the caller's
    transaction."""

    def read(self, key: str, default: str = "") -> str:
        """Return the value: the copy if that is what was written, otherwise the first, which may be damaged."""
        stored_value = default
        for value, crc in self._db.select(_READ, (key, key)):
            if crc is None:
                stored_value = value
            elif crc32(value.encode()) == crc:
                return value
        return stored_value

    def write(self, key: str, value: str) -> None:
        self._db.write(_WRITE, (key, value))
        self._db.write(_WRITE_COPY, (key, value, crc32(value.encode())))
