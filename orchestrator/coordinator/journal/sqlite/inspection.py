"""Checks a journal in a file, and the points beside it, without changing them, also while its coordinator runs."""

import sqlite3
from contextlib import closing
from pathlib import Path

from orchestrator.coordinator.journal.records import BRING_BACK, JournalError
from orchestrator.coordinator.journal.sql.inspection import (
    POINTS_AGAIN,
    JournalCheck,
    JournalDamage,
    check_parts,
    check_records,
)
from orchestrator.coordinator.journal.sqlite.database import (
    DATABASE_ERRORS,
    MEMORY,
    SqliteDatabase,
    connect_database,
    make_unusable_error,
    open_read_only,
)
from orchestrator.coordinator.journal.sqlite.points import find_points
from orchestrator.coordinator.journal.sqlite.schema import VERSION, list_statements, read_version

MAX_PROBLEMS = 20  # of SQLite's own check; more are the same again


def check_journal(path: Path) -> JournalCheck:
    """Check a journal, and the points beside it. Raises `JournalError` if it is none, or of a newer Tutti."""
    try:
        with open_read_only(path) as db:
            version = read_version(db.connection, str(path))
            damages = _check_pages(db.connection, path.name)
            if damages:
                return JournalCheck(version, None, {}, damages)
            if version == VERSION:
                return _check_records(db, version, path)
            # An older schema is read as this Tutti migrates it, in a copy.
            with closing(SqliteDatabase(connect_database(MEMORY), str(path))) as copy:
                db.connection.backup(copy.connection)
                copy.connection.executescript(list_statements(version))
                return _check_records(copy, version, path)
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None


def _check_records(db: SqliteDatabase, version: int, path: Path) -> JournalCheck:
    damages = _check_points(path)
    db.connection.execute("BEGIN")  # all records as they are at one instant
    return check_records(db, version, damages)


def _check_pages(db: sqlite3.Connection, name: str) -> list[JournalDamage]:
    """What SQLite finds wrong with a whole file."""
    texts = [problem for (problem,) in db.execute(f"PRAGMA integrity_check({MAX_PROBLEMS})") if problem != "ok"]
    return [JournalDamage(name, problem, BRING_BACK) for problem in texts]


def _check_points(journal: Path) -> list[JournalDamage]:
    """What is damaged in the points of scans."""
    path = find_points(journal)
    if not path.exists():
        return []
    try:
        with open_read_only(path) as db:
            return _check_pages(db.connection, path.name) or list(check_parts(db))
    except DATABASE_ERRORS as error:
        return [JournalDamage(path.name, f"it cannot be read ({error})", POINTS_AGAIN)]
    except JournalError as error:
        return [JournalDamage(path.name, error.text, POINTS_AGAIN)]
