"""One session with the server, whose deadlines are kept here: a server that is suspended keeps none of its own."""

import logging
from collections.abc import Sequence
from functools import lru_cache
from time import monotonic
from typing import Any, NamedTuple, TypeVar

import psycopg
from psycopg.abc import PQGen
from psycopg.rows import TupleRow

from orchestrator.coordinator.journal.postgres.address import JournalAddress
from orchestrator.coordinator.journal.postgres.errors import (
    AnswerLate,
    ConnectionLost,
    make_failed_error,
    make_late_error,
    make_lost_error,
    make_refused_error,
)
from orchestrator.coordinator.journal.postgres.lines import SeenLine, ServerLine
from orchestrator.coordinator.journal.postgres.reach import put_living_first
from orchestrator.coordinator.journal.records import JournalError

RV = TypeVar("RV")

# Its warnings are of errors that it raises as well.
logging.getLogger("psycopg").setLevel(logging.ERROR)

DEADLINE_S = 2.0  # of the statements that are sent together
OLDEST = 14  # `pg_terminate_backend` waits, from this version on
ANSWER_S = 0.5  # for each host to take a connection
END_MS = 1000  # for a session of before to end


class Statement(NamedTuple):
    """A statement with `?` for each of its values."""

    text: str
    values: Sequence[Any] = ()


class _Connection(psycopg.Connection[TupleRow]):
    """A connection each of whose waits ends at `deadline` (monotonic); it is closed then."""

    deadline = 0.0

    def wait(self, gen: PQGen[RV], interval: float = 0.1, timeout: float | None = None) -> RV:
        try:
            return super().wait(gen, interval, max(0.0, self.deadline - monotonic()))
        except psycopg.OperationalError:
            if monotonic() >= self.deadline:
                self.pgconn.finish()
            raise


class Session:
    """A session that connects again after its connection was lost. For one thread at a time.

    name: what messages name the database by. settings: of each connection, as statements. application: names the
    session on the server; changed, there as well, by what takes an epoch or renews its lease."""

    def __init__(
        self, address: JournalAddress, application: str, settings: str, deadline_s: float = DEADLINE_S
    ) -> None:
        self.name = address.text
        self.application = application
        self.deadline_s = deadline_s
        self._conninfo = address.conninfo
        self._settings = settings
        self._connection: _Connection | None = None
        self._backend: tuple[int, str] | None = None
        """Process and begin of the session on the server, also of one whose connection was lost."""
        self.seen_line = SeenLine()
        """The newest line of history that it has been connected to; several sessions may share it."""
        self.line: ServerLine | None = None
        """Of the server that was connected to last."""
        self._is_closed = False

    @property
    def connection(self) -> object | None:
        """What is connected at present; another object after it was lost."""
        return self._connection

    def run(self, statements: Sequence[Statement]) -> list[list[Any]]:
        """Send statements together; return the rows of each.

        Raises `ConnectionLost` if the connection ended, or no answer came before the deadline: it is closed then, and
        what was sent may have been done. Raises `JournalError` with what the server refused; the rest was not done.
        """
        connection = self._require_connection()
        return self._run(connection, statements)

    def run_again(self, statements: Sequence[Statement]) -> list[list[Any]]:
        """The same for statements that change nothing yet: once more on a new connection if the present one has
        ended. Not after a deadline, which would be another one."""
        if self._connection is not None:
            try:
                return self._run(self._connection, statements)
            except AnswerLate:
                raise
            except ConnectionLost:
                pass
        return self.run(statements)

    def close(self) -> None:
        """Close it for good."""
        self._is_closed = True
        self._drop()

    def _run(self, connection: _Connection, statements: Sequence[Statement]) -> list[list[Any]]:
        connection.deadline = monotonic() + self.deadline_s
        try:
            cursors = self._send(connection, statements)
            return [cursor.fetchall() if cursor.description else [] for cursor in cursors]
        except (psycopg.Error, UnicodeError) as error:
            raise self._translate_error(connection, error, is_together=len(statements) > 1) from None

    def _translate_error(self, connection: _Connection, error: Exception, *, is_together: bool) -> JournalError:
        """The error of the journal for one of the connection, which is dropped if it cannot be used any more."""
        if connection.closed:
            is_late = monotonic() >= connection.deadline
            self._drop()
            return make_late_error(self.name, self.deadline_s) if is_late else make_lost_error(self.name)
        if is_together:
            # psycopg counts statements as prepared that the server has skipped after the error.
            self._drop()
        return make_failed_error(self.name, error)

    @staticmethod
    def _send(connection: _Connection, statements: Sequence[Statement]) -> list[psycopg.Cursor[TupleRow]]:
        if len(statements) == 1:
            return [connection.execute(*_translate(statements[0]))]
        with connection.pipeline():
            return [connection.execute(*_translate(statement)) for statement in statements]

    def _require_connection(self) -> _Connection:
        if self._is_closed:
            raise JournalError(f"{self.name}: the journal is closed")
        if self._connection is None:
            self._connection = self._connect()
        return self._connection

    def _connect(self) -> _Connection:
        try:
            conninfo = put_living_first(self._conninfo, min(ANSWER_S, self.deadline_s / 2))
            connection = _Connection.connect(conninfo, autocommit=True, application_name=self.application)
        except (psycopg.Error, UnicodeError) as error:  # the latter of the name of a host
            raise make_refused_error(self.name, error, self._conninfo) from None
        self._connection = connection
        try:
            self._require_usable(connection)
            self._end_backend()
            ((pid, begin, system, timeline),) = self._run(connection, [Statement(_BACKEND)])[-1]
            self._backend = (pid, begin)
            line = ServerLine(f"{connection.info.host}:{connection.info.port}", system, int(timeline, 16))
            self.seen_line.take_line(line)
            self.line = line
        except JournalError:
            self._drop()
            raise
        return connection

    def _require_usable(self, connection: _Connection) -> None:
        version, encoding = connection.info.server_version, connection.info.parameter_status("server_encoding")
        if version < OLDEST * 10_000:
            text = f"{self.name}: PostgreSQL {version // 10_000} is too old"
            raise JournalError(text, f"use {OLDEST} or newer")
        if encoding != "UTF8":
            text = f"{self.name}: its encoding is {encoding}, and the journal needs UTF8"
            raise JournalError(text, "create another database: `createdb -E UTF8 -T template0 DATABASE`")
        self._run(connection, [Statement(self._settings)])

    def _end_backend(self) -> None:
        """End the session of before on the server, so that it holds no lock, and does not commit any more. Raises
        `ConnectionLost` if it does not end."""
        if self._backend is not None and self._connection is not None:
            (ends,) = self._run(self._connection, [Statement(_END, self._backend)])
            if ends == [(False,)]:
                raise make_lost_error(self.name)

    def _drop(self) -> None:
        connection, self._connection = self._connection, None
        if connection is not None:
            connection.pgconn.finish()
            connection.close()


_BACKEND = (
    "SELECT pid, backend_start::text, (SELECT system_identifier::text FROM pg_control_system()),"
    " CASE WHEN pg_is_in_recovery() THEN '0' ELSE left(pg_walfile_name(pg_current_wal_lsn()), 8) END"
    " FROM pg_stat_activity WHERE pid = pg_backend_pid()"
)
_END = (
    f"SELECT pg_terminate_backend(pid, {END_MS}) FROM pg_stat_activity"
    " WHERE pid = ? AND backend_start = CAST(? AS timestamptz)"
)


def _translate(statement: Statement) -> tuple[bytes, Sequence[Any] | None]:
    """A statement with psycopg's marks, and its values."""
    return _set_marks(statement.text), statement.values or None


@lru_cache(maxsize=1000)
def _set_marks(text: str) -> bytes:
    return text.replace("?", "%s").encode()
