"""The journal in SQLite: what was accepted, decided and done is on disk before it is reported anywhere."""

import sqlite3
from pathlib import Path

from orchestrator.coordinator.journal.facts import QueueEntryOptions
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sql.journal import SqlJournal
from orchestrator.coordinator.journal.sqlite.database import (
    DATABASE_ERRORS,
    MEMORY,
    SqliteDatabase,
    connect_database,
    create_private_file,
    find_file_identity,
    make_unusable_error,
)
from orchestrator.coordinator.journal.sqlite.points import open_points
from orchestrator.coordinator.journal.sqlite.schema import VERSION, list_statements, read_version
from orchestrator.model.jobs.job import Job


class SqliteJournal(SqlJournal):
    """`JournalStore` in a file."""

    def __init__(self, path: str | Path) -> None:
        """Open or create the journal at `path` (`:memory:` for tests). Raises `JournalError`."""
        self._path = str(path)
        self.database = _open_journal(self._path)
        """The database, for what looks at it, or damages it, from outside."""
        self._identity = find_file_identity(self._path)
        self.point_database = open_points(self._path if self._path == MEMORY else f"{self._path}-points")
        super().__init__(self.database, self.point_database)

    def accept_job(
        self, job_id: str, client_key: str, job: Job, utc: str, entry: QueueEntryOptions | None = None
    ) -> tuple[str, bool]:
        self._require_same_file()
        return super().accept_job(job_id, client_key, job, utc, entry)

    def _require_same_file(self) -> None:
        """Raises `JournalError` if the file that is open is no longer the one at its path: what is written to a deleted
        file is lost with this process."""
        if find_file_identity(self._path) != self._identity:
            raise JournalError(
                f"{self._path}: the journal was deleted or replaced while it was in use; no job is accepted",
                "end the fleet (`tutti down`), put the state folder back or begin a new journal: "
                "`tutti up FILE --new-journal`",
            )

    def close(self) -> None:
        self.point_database.close()
        self.database.close()


def _open_journal(path: str) -> SqliteDatabase:
    try:
        if path != MEMORY:
            create_private_file(Path(path))
        connection = connect_database(path, check_same_thread=False)
        db = SqliteDatabase(connection, path)
        version = read_version(connection, path)
        damage = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if damage != "ok":
            raise sqlite3.DatabaseError(damage)
        connection.execute("PRAGMA journal_mode=WAL")
        connection.execute("PRAGMA synchronous=FULL")
        connection.execute("PRAGMA foreign_keys=ON")
        steps = list_statements(version)
        if steps:
            connection.executescript(f"BEGIN; {steps} PRAGMA user_version={VERSION}; COMMIT;")
    except (*DATABASE_ERRORS, OSError) as error:
        raise make_unusable_error(path, error) from None
    return db


def require_journal(path: Path) -> None:
    """Raises `JournalError` if a fleet that had a journal has none: its jobs, and what they did, would be forgotten
    without a word."""
    if not path.exists():
        raise JournalError(
            f"{path}: the journal of this fleet is missing",
            "put it back; or begin a new one, without the jobs of before: `tutti up FILE --new-journal`",
        )
