"""Parts that the files of the journal share: transactions, private files, and errors in words."""

import os
import sqlite3
from collections.abc import Sequence
from contextlib import closing, suppress
from pathlib import Path

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.files.private_files import UnsafePath, make_private_folder, open_private_file, refuse_link

# A message of SQLite about a damaged file has bytes of it, which are no text.
DATABASE_ERRORS = (sqlite3.Error, UnicodeDecodeError)


def decode_text(text: bytes) -> str:
    """A damaged text makes its own record unreadable, not the whole query: its checksum is wrong then."""
    return text.decode("utf-8", "replace")


def connect_database(path: Path | str, *, uri: bool = False, check_same_thread: bool = True) -> sqlite3.Connection:
    """A connection whose transactions are explicit. Raises `sqlite3.Error`."""
    db = sqlite3.connect(path, isolation_level=None, uri=uri, check_same_thread=check_same_thread)
    db.text_factory = decode_text
    return db


class Transaction:
    """BEGIN IMMEDIATE … COMMIT, or ROLLBACK on an error; inside of another one it is a savepoint of that. A database
    error becomes a `JournalError`."""

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._db = db
        self._path = path
        self._is_inner = db.in_transaction

    def __enter__(self) -> None:
        try:
            self._db.execute("SAVEPOINT part" if self._is_inner else "BEGIN IMMEDIATE")
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                self._db.execute("RELEASE part" if self._is_inner else "COMMIT")
        except DATABASE_ERRORS as failure:
            kind, error = type(failure), failure
        # SQLite has rolled back already, the whole transaction, when the disk is full.
        if kind is not None and self._db.in_transaction:
            for statement in ("ROLLBACK TO part", "RELEASE part") if self._is_inner else ("ROLLBACK",):
                self._db.execute(statement)
        if isinstance(error, DATABASE_ERRORS):
            raise make_unusable_error(self._path, error) from None


def run_group(db: sqlite3.Connection, path: str, calls: Sequence[JournalCall]) -> None:
    """Run the calls that have not been run, as one transaction; if that fails, nothing of it is stored, and each is run
    alone. Raises nothing."""
    new_calls = [call for call in calls if not call.is_done]
    if len(new_calls) > 1:
        with suppress(JournalError):
            with Transaction(db, path):
                for call in new_calls:
                    call.attempt()
                    if not db.in_transaction:
                        raise JournalError(f"{path}: the transaction was rolled back as a whole")
            for call in new_calls:
                call.is_done = True
    for call in new_calls:
        call.run()


def find_file_identity(path: str) -> tuple[int, int] | None:
    """Device and number of the file at `path`; None without one, or in memory."""
    try:
        status = None if path == ":memory:" else os.lstat(path)
    except OSError:
        return None
    return None if status is None else (status.st_dev, status.st_ino)


def create_private_file(path: Path) -> None:
    """Create a file for this user alone, unless it is there. Raises `UnsafePath` for a symbolic link, and `OSError`."""
    make_private_folder(path.parent)
    try:
        os.close(open_private_file(path, os.O_RDWR | os.O_CREAT | os.O_EXCL))
    except FileExistsError:
        refuse_link(path)


def make_unusable_error(path: str, error: Exception) -> JournalError:
    """Describe what is wrong with the journal at `path`, and the remedy."""
    if isinstance(error, UnsafePath):
        return JournalError(str(error))
    return JournalError(
        f"{path}: the journal cannot be used ({error})",
        "free space on its disk, repair it, or move it away to start with a new one",
    )


def open_read_only(path: Path) -> sqlite3.Connection:
    """Open a database that another process may be using, to read it alone. Raises `sqlite3.Error`."""
    # On a disk that is mounted for reading only SQLite cannot create the index that its readers share.
    options = "mode=ro" if os.access(path.parent, os.W_OK) else "immutable=1"
    return connect_database(f"{path.absolute().as_uri()}?{options}", uri=True)


def copy_database(source: Path, copy: Path) -> None:
    """Copy a database that another process may be using into a new file. Raises `JournalError`."""
    try:
        with closing(open_read_only(source)) as db, closing(sqlite3.connect(copy)) as target:
            db.backup(target)
            target.execute("PRAGMA journal_mode=DELETE")
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(source), error) from None
