"""What the tables of the journal need of a database, in statements that SQLite and PostgreSQL both take.

Such a statement marks values by `?`, and has no other question mark and no percent sign. Rows of a table that has no
number of its own are in the order of `rowid`. Numbers are integers of 64 bits, texts are UTF-8, and are compared by
code points.
"""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from typing import Any, Protocol

Row = Sequence[Any]


class Database(Protocol):
    """A database of one journal, for one thread at a time. Every method raises `JournalError`."""

    @property
    def name(self) -> str:
        """What messages name it by: its file, or its address without the password."""
        ...

    @property
    def in_transaction(self) -> bool:
        """Whether a transaction is open, and can still be committed."""
        ...

    @property
    def known_states(self) -> dict[str, str]:
        """States of jobs, by their ids, that the present transaction has read or written; it may keep none."""
        ...

    def select(self, statement: str, values: Row = ()) -> list[Any]:
        """The rows that a statement returns."""
        ...

    def stream(self, statement: str, values: Row = ()) -> Iterator[Any]:
        """The same, for rows that do not fit into memory together. To be read to its end, or closed."""
        ...

    def write(self, statement: str, values: Row = ()) -> None:
        """Run a statement that returns nothing. Inside of a transaction its error may be raised later, at the latest
        at the end of that."""
        ...

    def write_many(self, statement: str, rows: Iterable[Row]) -> None:
        """The same statement for each row."""
        ...

    def transaction(self, *, copied: bool = False) -> AbstractContextManager[None]:
        """All that is written inside is stored at its end, or nothing is. Inside of another one it is a part of that,
        which is rolled back alone on an error that is not of the database.

        copied: it must be on all machines that the fleet asks for before it counts; what is not may be stored on fewer
        while one of them is missing."""
        ...


class JournalPart:
    """A part of the journal: its tables in one database."""

    def __init__(self, db: Database) -> None:
        self._db = db


def make_upsert(table: str, keys: Sequence[str], columns: Sequence[str]) -> str:
    """The statement that stores a row of `keys` and `columns`, in the place of one with the same keys."""
    names, changes = (*keys, *columns), ", ".join(f"{column} = excluded.{column}" for column in columns)
    return f"{make_insert(table, names)} ON CONFLICT ({', '.join(keys)}) DO UPDATE SET {changes}"


def make_insert(table: str, columns: Sequence[str]) -> str:
    """The statement that stores a new row."""
    return f"INSERT INTO {table} ({', '.join(columns)}) VALUES ({make_marks(len(columns))})"


def make_marks(count: int) -> str:
    """The marks of so many values."""
    return ", ".join("?" * count)
