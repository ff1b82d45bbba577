"""Journals of one engine, for tests of what both do."""

from contextlib import ExitStack, closing
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from orchestrator.coordinator.journal.sql.database import Database
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.points import open_points
from orchestrator.coordinator.journal.store import JournalStore

if TYPE_CHECKING:
    from unit.journal.servers import PostgresServer

    from orchestrator.coordinator.journal.postgres.journal import PostgresJournal


class OpenJournal(JournalStore, Protocol):
    """A journal, with the database that tests damage."""

    @property
    def database(self) -> Database: ...

    def set_epoch(self, epoch: int) -> None: ...


class Engine(Protocol):
    """Opens journals. Each name is a journal of its own; one may be opened several times."""

    def open(self, name: str = "lab") -> OpenJournal: ...

    def open_points(self) -> Database:
        """The database of the points of scans of the journal."""
        ...


class SqliteEngine:
    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self._folder = folder
        self._stack = stack

    def open(self, name: str = "lab") -> SqliteJournal:
        return self._stack.enter_context(closing(SqliteJournal(self._folder / name / "journal.db")))

    def open_points(self) -> Database:
        return self._stack.enter_context(closing(open_points(str(self._folder / "lab" / "journal.db-points"))))


class PostgresEngine:
    """Each journal is a fleet of its own in one database. number: makes their names differ from those of other tests."""

    def __init__(self, server: "PostgresServer", number: int, stack: ExitStack) -> None:
        self._server = server
        self._number = number
        self._stack = stack

    def open(self, name: str = "lab") -> "PostgresJournal":
        from orchestrator.coordinator.journal.postgres.opening import open_journal

        journal = open_journal(self._server.make_address("journal"), f"{name}{self._number}")
        return self._stack.enter_context(closing(journal))

    def open_points(self) -> Database:
        return self.open().database
