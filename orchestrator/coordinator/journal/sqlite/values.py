"""Single values of the journal, such as its epoch: each is kept twice, the second time with a checksum."""

import sqlite3
from zlib import crc32


class StoredValues:
    """The values in one database. Raise `sqlite3.Error`; what is written belongs to the caller's transaction."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self._db = db

    def read(self, key: str, default: str = "") -> str:
        """Return the value: the copy if that is what was written, otherwise the first, which may be damaged."""
        copy = self._db.execute("SELECT value, crc FROM meta_copies WHERE key = ?", (key,)).fetchone()
        if copy is not None and crc32(copy[0].encode()) == copy[1]:
            return copy[0]
        row = self._db.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return default if row is None else row[0]

    def write(self, key: str, value: str) -> None:
        self._db.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))
        self._db.execute("INSERT OR REPLACE INTO meta_copies VALUES (?, ?, ?)", (key, value, crc32(value.encode())))
