"""A database of the journal in a file: transactions, private files, and errors in words."""

import os
import sqlite3
import weakref
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sql.database import Row
from orchestrator.model.files.private_files import UnsafePath, make_private_folder, open_private_file, refuse_link

# A message of SQLite about a damaged file has bytes of it, which are no text.
DATABASE_ERRORS = (sqlite3.Error, UnicodeDecodeError)
MEMORY = ":memory:"


class SqliteDatabase:
    """`Database` in a file, or in memory."""

    def __init__(self, connection: sqlite3.Connection, name: str) -> None:
        """name: the path that messages state."""
        self.connection = connection
        self._name = name
        # A journal that is dropped, like that of a virtual fleet, closes its database.
        self.close = weakref.finalize(self, connection.close)

    @property
    def name(self) -> str:
        return self._name

    @property
    def in_transaction(self) -> bool:
        return self.connection.in_transaction

    @property
    def known_states(self) -> dict[str, str]:
        return {}  # reading costs nothing

    def select(self, statement: str, values: Row = ()) -> list[Any]:
        try:
            return self.connection.execute(statement, values).fetchall()
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._name, error) from None

    def stream(self, statement: str, values: Row = ()) -> Iterator[Any]:
        try:
            yield from self.connection.execute(statement, values)
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._name, error) from None

    def write(self, statement: str, values: Row = ()) -> None:
        try:
            self.connection.execute(statement, values)
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._name, error) from None

    def write_many(self, statement: str, rows: Iterable[Row]) -> None:
        try:
            self.connection.executemany(statement, rows)
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._name, error) from None

    @contextmanager
    def transaction(self, *, copied: bool = False) -> Generator[None]:
        """BEGIN IMMEDIATE … COMMIT, or ROLLBACK on an error; inside of another one it is a savepoint of that."""
        is_inner = self.in_transaction
        self.write("SAVEPOINT part" if is_inner else "BEGIN IMMEDIATE")
        try:
            yield
            self.write("RELEASE part" if is_inner else "COMMIT")
        except BaseException:
            # SQLite has rolled back already, the whole transaction, when the disk is full.
            if self.in_transaction:
                for statement in ("ROLLBACK TO part", "RELEASE part") if is_inner else ("ROLLBACK",):
                    self.connection.execute(statement)
            raise

    def end_log(self) -> None:
        """Have everything in the one file, which can be copied once it is closed. Raises `JournalError`."""
        self.write("PRAGMA journal_mode=DELETE")

    def list_columns(self) -> dict[str, list[str]]:
        """The columns of each table that the file has, in the order in which the tables were made: a record comes after
        those that it names. Raises `JournalError`."""
        query = "SELECT name FROM sqlite_master WHERE type = 'table' AND name NOT LIKE 'sqlite_%' ORDER BY rowid"
        names = [name for (name,) in self.select(query)]
        return {name: [row[1] for row in self.select(f"PRAGMA table_info({name})")] for name in names}


def connect_database(path: Path | str, *, uri: bool = False, check_same_thread: bool = True) -> sqlite3.Connection:
    """A connection whose transactions are explicit. Raises `sqlite3.Error`."""
    db = sqlite3.connect(path, isolation_level=None, uri=uri, check_same_thread=check_same_thread)
    db.text_factory = decode_text
    return db


def decode_text(text: bytes) -> str:
    """A damaged text makes its own record unreadable, not the whole query: its checksum is wrong then."""
    return text.decode("utf-8", "replace")


def find_file_identity(path: str) -> tuple[int, int] | None:
    """Device and number of the file at `path`; None without one, or in memory."""
    try:
        status = None if path == MEMORY else os.lstat(path)
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


@contextmanager
def open_read_only(path: Path) -> Generator[SqliteDatabase]:
    """Open a database that another process may be using, to read it alone. Raises `JournalError`."""
    # On a disk that is mounted for reading only SQLite cannot create the index that its readers share.
    options = "mode=ro" if os.access(path.parent, os.W_OK) else "immutable=1"
    try:
        connection = connect_database(f"{path.absolute().as_uri()}?{options}", uri=True)
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None
    with closing(SqliteDatabase(connection, str(path))) as db:
        yield db


def copy_database(source: Path, copy: Path) -> None:
    """Copy a database that another process may be using into a new file. Raises `JournalError`."""
    try:
        with open_read_only(source) as db, closing(sqlite3.connect(copy)) as target:
            db.connection.backup(target)
            target.execute("PRAGMA journal_mode=DELETE")
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(source), error) from None
