"""A transaction on a server: its statements are kept until a read needs them done, and are sent together then."""

from collections.abc import Generator
from contextlib import contextmanager, suppress
from typing import Any, NamedTuple

from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.coordinator.journal.records import BRING_BACK_DATABASE, CopyMissing, HistoryLost, JournalError
from orchestrator.coordinator.journal.sql.leader_values import make_overtaken_error

SENT_AT_ONCE = 500  # statements
SENT_BYTES = 4_000_000

BEGIN = Statement("BEGIN")
EPOCH = Statement("SELECT epoch FROM leader")
SNAPSHOT = Statement("BEGIN ISOLATION LEVEL REPEATABLE READ READ ONLY")
_LEADER = "SELECT epoch, current_setting('synchronous_standby_names') <> '' FROM leader"


class Fence(NamedTuple):
    """How a transaction holds the leader's row, so that no other coordinator takes an epoch meanwhile. epoch: its own;
    without the row of that epoch nothing is written."""

    statement: Statement
    epoch: int = 0

    @classmethod
    def hold(cls, epoch: int) -> "Fence":
        """Hold it with others, as every write of a leader."""
        return cls(Statement(f"{_LEADER} WHERE epoch = ? FOR SHARE", (epoch,)), epoch)

    @classmethod
    def lock(cls) -> "Fence":
        """Hold it alone, as a take-over."""
        return cls(Statement(f"{_LEADER} FOR UPDATE"))


class Transaction:
    """The statements of a transaction that were not sent yet. fence: None for one that holds no leader's row.

    copied: it has a promise, which has to be on all machines that the fleet asks for."""

    def __init__(
        self, session: Session, fence: Fence | None, begin: Statement = BEGIN, *, copied: bool = False
    ) -> None:
        self._session = session
        self._fence = fence
        self._statements = [begin] if fence is None else [begin, fence.statement]
        self._bytes = 0
        self._has_begun = False
        self._connection: object | None = None
        self._has_standby = False
        self.copied = copied
        self.known_states = dict[str, str]()
        """States of jobs as they are in it: no other session changes one while the leader's row is held."""
        self.is_lost = False
        """It was rolled back as a whole."""

    def send_later(self, statement: Statement) -> None:
        """Send it with the next read, or at the end. Raises `JournalError` of one before it."""
        self._statements.append(statement)
        self._bytes += sum(len(value) for value in statement.values if isinstance(value, str | bytes))
        if len(self._statements) >= SENT_AT_ONCE or self._bytes >= SENT_BYTES:
            self._send()

    def read(self, statement: Statement) -> list[Any]:
        """The rows of a statement, after those before it. Raises `JournalError`."""
        self._statements.append(statement)
        return self._send()[-1]

    def take_last(self, *, needs_standby: bool) -> list[Statement]:
        """What is to be sent with the commit. The leader's row is held then. needs_standby: it is a promise of two
        copies. Raises `CopyMissing`, `EpochOvertaken`, `JournalError`."""
        if not self._has_begun:
            self._send()
        self._require_whole()
        if needs_standby and not self._has_standby:
            raise CopyMissing(
                f"{self._session.name}: commits wait for no copy; no job is accepted",
                "name the standby in synchronous_standby_names on the server",
            )
        return self._take_statements()

    def roll_back(self) -> None:
        """Roll it back, if the server has it."""
        self.is_lost = True
        if self._is_open:
            with suppress(JournalError):  # a connection that is lost has rolled it back
                self._session.run([Statement("ROLLBACK")])

    @contextmanager
    def part(self, *, copied: bool) -> Generator[None]:
        """A part that is rolled back alone on an error that is not of the database."""
        self._require_whole()
        self.copied = self.copied or copied
        self.send_later(Statement("SAVEPOINT part"))
        try:
            yield
        except BaseException:
            self.known_states.clear()
            if not self.is_lost:
                self.send_later(Statement("ROLLBACK TO part"))
                self.send_later(Statement("RELEASE part"))
            raise
        self.send_later(Statement("RELEASE part"))

    @property
    def _is_open(self) -> bool:
        """Whether the server has it, and its connection was not lost since."""
        return self._connection is not None and self._session.connection is self._connection

    def _require_whole(self) -> None:
        if self.is_lost or (self._has_begun and not self._is_open):
            raise JournalError(f"{self._session.name}: the transaction was rolled back as a whole")

    def _take_statements(self) -> list[Statement]:
        statements, self._statements = self._statements, []
        self._bytes = 0
        return statements

    def _send(self) -> list[list[Any]]:
        self._require_whole()
        is_first, self._has_begun = not self._has_begun, True
        try:
            # Nothing is committed yet: what begins a transaction may be sent again.
            run = self._session.run_again if is_first else self._session.run
            results = run(self._take_statements())
            self._connection = self._session.connection
            if is_first and self._fence is not None:
                self._check_leader(results[1], self._fence)
        except BaseException:
            self.is_lost = True
            raise
        return results

    def _check_leader(self, rows: list[Any], fence: Fence) -> None:
        if rows:
            self._has_standby = bool(rows[0][1])
            return
        (rows,) = self._session.run([EPOCH])
        raise make_epoch_error(self._session.name, fence.epoch, rows[0][0])


def make_epoch_error(name: str, epoch: int, last: int) -> JournalError:
    """The error of a coordinator whose epoch is not the database's."""
    if last > epoch:
        return make_overtaken_error(epoch, last)
    return HistoryLost(
        f"{name}: its epoch is {last}, and {epoch} was taken from it: it has lost history", BRING_BACK_DATABASE
    )
