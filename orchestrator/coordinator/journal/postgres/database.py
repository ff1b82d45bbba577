"""A database on a server: what is written in a transaction is sent with its next read or its end, in one round trip.

The first statement of a transaction holds the leader's row, so that a coordinator whose epoch is over writes nothing.
The last one before its end states a mark: after a commit without an answer, the mark says whether it was done.
"""

import secrets
from collections.abc import Generator, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from orchestrator.coordinator.journal.postgres.errors import AnswerLate, ConnectionLost
from orchestrator.coordinator.journal.postgres.health import BEGINNING, JournalHealth, read_health
from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.coordinator.journal.postgres.transaction import (
    BEGIN,
    EPOCH,
    SNAPSHOT,
    Fence,
    Transaction,
    make_epoch_error,
)
from orchestrator.coordinator.journal.records import CopyMissing, JournalError, UnknownResult
from orchestrator.coordinator.journal.sql.database import Row

ROWS_AT_ONCE = 16  # of many; each may have some megabytes

_COMMIT = Statement("COMMIT")
_LOCAL = Statement("SET LOCAL synchronous_commit TO local")
_MARK = "UPDATE marks SET writer = ?, number = ?"
_FIND_MARK = Statement("SELECT writer, number, epoch, pg_current_wal_flush_lsn()::text FROM marks CROSS JOIN leader")
# A row that no write holds: one that waits for a copy delays no other session.
_CONFIRM = Statement("UPDATE confirmations SET number = number + 1")


class PostgresDatabase:
    """`Database` of one fleet on a server. copies: the machines on which a promise has to be before it counts, 1 or 2.

    epoch: that of the leader that writes here; 0 until it has taken one, and then only a journal that has had no leader
    is written to."""

    def __init__(self, session: Session, copies: int = 1) -> None:
        self.session = session
        self.copies = copies
        self.epoch = 0
        self.is_copy_missing = False
        """With two copies: what is no promise is committed on this machine alone, and promises are refused."""
        self._transaction: Transaction | None = None
        self._required_epoch: int | None = None
        self._awaited = BEGINNING
        """The place in the log that a standby must have before it counts again."""
        self._writer = secrets.token_hex(8)
        self._number = 0

    @property
    def name(self) -> str:
        return self.session.name

    @property
    def in_transaction(self) -> bool:
        return self._transaction is not None and not self._transaction.is_lost

    def close(self) -> None:
        self.session.close()

    def select(self, statement: str, values: Row = ()) -> list[Any]:
        if self._transaction is None:
            return self._read_alone(Statement(statement, values))
        return self._transaction.read(Statement(statement, values))

    def stream(self, statement: str, values: Row = ()) -> Iterator[Any]:
        """Only in a transaction, and one at a time."""
        self.select(f"DECLARE rows NO SCROLL CURSOR FOR {statement}", values)
        try:
            while rows := self.select(f"FETCH {ROWS_AT_ONCE} FROM rows"):
                yield from rows
        finally:
            if self.in_transaction:
                self.write("CLOSE rows")

    def write(self, statement: str, values: Row = ()) -> None:
        self.write_many(statement, [values])

    def write_many(self, statement: str, rows: Iterable[Row]) -> None:
        if self._transaction is None:
            with self.transaction():
                self.write_many(statement, rows)
            return
        for row in rows:
            self._transaction.send_later(Statement(statement, row))

    @contextmanager
    def transaction(self, *, copied: bool = False) -> Generator[None]:
        if self._transaction is not None:
            with self._transaction.part(copied=copied):
                yield
            return
        with self._run_transaction(Fence.hold(self.epoch), copied=copied):
            yield

    @contextmanager
    def lock_leader(self) -> Generator[None]:
        """A transaction that holds the leader's row alone, whatever its epoch is: its result is a promise."""
        with self._run_transaction(Fence.lock(), copied=True):
            yield

    def require_epoch(self, epoch: int) -> None:
        """Raises `EpochOvertaken` if a later epoch has been taken, and `HistoryLost` if only earlier ones have."""
        self._require_last(self.session.run_again([EPOCH])[0], epoch)

    @contextmanager
    def under_epoch(self, epoch: int) -> Generator[None]:
        """What is read inside, and is no part of a transaction, raises `EpochOvertaken` once a later one has been
        taken."""
        self._required_epoch = epoch
        try:
            yield
        finally:
            self._required_epoch = None

    @property
    def known_states(self) -> dict[str, str]:
        return {} if self._transaction is None else self._transaction.known_states

    @contextmanager
    def unfenced(self) -> Generator[None]:
        """A transaction that holds no leader's row: of a schema that is made in it."""
        transaction = self._transaction = Transaction(self.session, None, BEGIN)
        try:
            yield
            self._transaction = None
            self.session.run([*transaction.take_last(needs_standby=False), _COMMIT])
        except BaseException:
            self._transaction = None
            transaction.roll_back()
            raise

    @contextmanager
    def snapshot(self) -> Generator[None]:
        """All that is read inside is as it was at one instant; nothing is written."""
        transaction = self._transaction = Transaction(self.session, None, SNAPSHOT)
        try:
            yield
        finally:
            self._transaction = None
            transaction.roll_back()

    def require_copies(self) -> None:
        """Raises `CopyMissing` if commits are not confirmed by as many machines as the fleet asks for."""
        if self.copies > 1:
            self.read_health()
            self._refuse_promise(copied=True)
            try:
                self.session.run([_CONFIRM])
            except AnswerLate:
                self.is_copy_missing = True
                self._refuse_promise(copied=True)

    def read_health(self) -> JournalHealth:
        """Ask the server, and note whether a copy is missing. Raises `JournalError`."""
        health = read_health(self.session, self.copies, self._awaited)
        self.is_copy_missing = health.mode == "waits for a copy"
        return health

    def _read_alone(self, statement: Statement) -> list[Any]:
        if self._required_epoch is None:
            return self.session.run_again([statement])[0]
        epoch_rows, rows = self.session.run_again([EPOCH, statement])
        self._require_last(epoch_rows, self._required_epoch)
        return rows

    def _require_last(self, rows: list[Any], epoch: int) -> None:
        ((last,),) = rows
        if last != epoch:
            raise make_epoch_error(self.name, epoch, last)

    @contextmanager
    def _run_transaction(self, fence: Fence, *, copied: bool) -> Generator[None]:
        self._refuse_promise(copied=copied)
        transaction = self._transaction = Transaction(self.session, fence, copied=copied)
        try:
            yield
            self._transaction = None
            self._commit(transaction)
        except BaseException:
            self._transaction = None
            transaction.roll_back()
            raise

    def _refuse_promise(self, *, copied: bool) -> None:
        if copied and self.copies > 1 and self.is_copy_missing:
            raise CopyMissing(
                f"{self.name}: the copy of the journal on a second machine is missing; no job is accepted",
                "look at the standby server, and at pg_stat_replication on the primary",
            )

    def _commit(self, transaction: Transaction) -> None:
        self._refuse_promise(copied=transaction.copied)
        statements = transaction.take_last(needs_standby=transaction.copied and self.copies > 1)
        self._number += 1
        is_local = self.copies > 1 and self.is_copy_missing
        statements += [Statement(_MARK, (self._writer, self._number)), *([_LOCAL] if is_local else []), _COMMIT]
        try:
            self.session.run(statements)
        except ConnectionLost as error:
            if not self._find_result(is_promise=transaction.copied, is_late=isinstance(error, AnswerLate)):
                raise error from None

    def _find_result(self, *, is_promise: bool, is_late: bool) -> bool:
        """Whether a commit without an answer was done. is_late: it has waited for one, perhaps for a standby. Raises
        `UnknownResult` where that cannot be found out."""
        try:
            (((writer, number, epoch, log_place),),) = self.session.run([_FIND_MARK])
            is_stored = (writer, number) == (self._writer, self._number)
            if is_stored and self.copies > 1:
                self._awaited = log_place if is_late else self._awaited
                self._confirm(is_promise=is_promise)
        except JournalError:
            raise self._make_unknown_error() from None
        if not is_stored and (epoch, writer) != (self.epoch, self._writer):
            raise self._make_unknown_error()  # another leader has written its mark over it, or may have
        return is_stored

    def _confirm(self, *, is_promise: bool) -> None:
        """Visible is not copied: have a later commit confirmed, which confirms all before it. What is no promise counts
        without, while a copy is missing."""
        if self.read_health().mode == "two copies":
            self.session.run([_CONFIRM])
        elif is_promise:
            raise self._make_unknown_error()

    def _make_unknown_error(self) -> UnknownResult:
        text = f"{self.name}: there was no answer whether it was stored"
        return UnknownResult(text, "ask for it again, with the same key: nothing is stored twice")
