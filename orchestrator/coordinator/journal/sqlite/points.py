"""Points of scans in a file of their own beside the journal.

The journal is checked as a whole at each start, and points may be half a gigabyte.
"""

from pathlib import Path

from orchestrator.coordinator.journal.sqlite.database import (
    DATABASE_ERRORS,
    MEMORY,
    SqliteDatabase,
    connect_database,
    create_private_file,
    make_unusable_error,
)

_SCHEMA = """
CREATE TABLE IF NOT EXISTS uploads (
  digest TEXT PRIMARY KEY, header TEXT NOT NULL, size INTEGER NOT NULL, received INTEGER NOT NULL,
  columns TEXT, used_utc TEXT NOT NULL
) STRICT;
CREATE TABLE IF NOT EXISTS parts (
  digest TEXT NOT NULL REFERENCES uploads (digest) ON DELETE CASCADE, begin INTEGER NOT NULL, data BLOB NOT NULL,
  crc INTEGER NOT NULL, PRIMARY KEY (digest, begin)
) STRICT;
"""


def find_points(journal: Path) -> Path:
    """The file of the points beside a journal."""
    return journal.with_name(f"{journal.name}-points")


def open_points(path: str) -> SqliteDatabase:
    """Open or create the points at `path` (`:memory:` for tests). Raises `JournalError`."""
    try:
        if path != MEMORY:
            create_private_file(Path(path))
        connection = connect_database(path, check_same_thread=False)
        for setting in ("auto_vacuum=FULL", "journal_mode=WAL", "synchronous=FULL", "foreign_keys=ON"):
            connection.execute(f"PRAGMA {setting}")
        connection.executescript(_SCHEMA)
    except (*DATABASE_ERRORS, OSError) as error:
        raise make_unusable_error(path, error) from None
    return SqliteDatabase(connection, path)
