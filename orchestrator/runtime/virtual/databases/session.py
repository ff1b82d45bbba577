"""A session of the product with a database of virtual time: what the journal of PostgreSQL sends is answered by SQLite.

Calls of a session are done at one instant, and count how long they would have taken: `take_spent_ns`.
"""

import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from typing import Any, NamedTuple

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.journal.postgres.address import CONNECT_S, JournalAddress
from orchestrator.coordinator.journal.postgres.errors import make_late_error, make_lost_error
from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.runtime.virtual.databases.site import DatabaseSite

ADDRESS = JournalAddress("", "postgresql://tutti@virtual/journal")
_LOCAL = "SET LOCAL synchronous_commit TO local"
_LOCAL_SETTING = "synchronous_commit TO local"
# What SQLite does not know, and has no meaning with one transaction at a time.
_LEFT_OUT = re.compile(r"::text| FOR (SHARE|UPDATE)$")


class SessionOrigin(NamedTuple):
    """The process that sessions are of. is_alive: whether it is; a dead one does nothing any more."""

    site: DatabaseSite
    computer: str
    is_alive: Callable[[], bool]


class VirtualSession(Session):
    """A session of a process."""

    def __init__(self, origin: SessionOrigin, application: str, settings: str, deadline_s: float) -> None:
        super().__init__(ADDRESS, application, settings, deadline_s)
        self._site, self._computer, self._is_alive = origin
        self._is_one_copy = _LOCAL_SETTING in settings
        self._is_local = False
        self._spent_ns = 0
        self._machine = ""

    def take_spent_ns(self) -> int:
        """How long the calls since the last question took, ns."""
        spent_ns, self._spent_ns = self._spent_ns, 0
        return spent_ns

    def lose_connection(self) -> None:
        """The server, or its machine, has ended it."""
        self._machine = ""
        if self in self._site.sessions:
            self._site.sessions.remove(self)

    def _connect(self) -> Any:
        """Connect with the first machine that takes writes, in the order of the address."""
        for machine in self._site.machines:
            if self._site.is_cut(machine, self._computer):
                self._spent_ns += CONNECT_S * NS_PER_S
                continue
            self._spent_ns += self._site.call_ns
            if self._site.answers(machine, self._computer) and machine == self._site.primary:
                self._machine = machine
                self._site.sessions.append(self)
                self._connection: Any = object()
                return self._connection
        raise make_lost_error(self.name)

    def _drop(self) -> None:
        self._connection = None
        self.lose_connection()

    def _run(self, connection: Any, statements: Sequence[Statement]) -> list[list[Any]]:
        begun_ns = self._spent_ns
        self._spent_ns += self._site.call_ns
        results: list[list[Any]] = []
        try:
            self._require_answers()
            for statement in statements:
                results.append(self._answer(statement))
                if self._spent_ns - begun_ns > self.deadline_s * NS_PER_S:
                    self._raise_late(begun_ns)
        except JournalError:
            self._end_transaction()
            raise
        return results

    def _answer(self, statement: Statement) -> list[Any]:
        text = _LEFT_OUT.sub("", statement.text)
        match text.split("(")[0]:
            case str() as first_words if first_words.startswith("BEGIN"):
                self._begin()
                return []
            case "COMMIT":
                self._commit()
                return []
            case "SELECT pg_terminate_backend":
                return [(True,)] * self._site.end_sessions(statement.values[0], self)
            case str() if text == _LOCAL:
                self._is_local = True
                return []
            case str() if "pg_control_system" in text:
                return [self._describe_server()]
            case str() if "pg_stat_replication" in text:
                return [(name, True) for name in self._site.standbys]
            case _:
                return self._run_alone(text, statement.values)

    def _run_alone(self, text: str, values: Sequence[Any]) -> list[Any]:
        """A statement that SQLite knows; outside of a transaction one that writes is one of its own."""
        db = self._site.journal.database
        is_whole = not db.in_transaction and not text.startswith(("SELECT", "WITH"))
        if is_whole:
            self._begin()
        rows = db.select(text, values)
        if is_whole:
            self._commit()
        return rows

    def _begin(self) -> None:
        # What dies before the commit does so here: the contents can be copied.
        self._site.on_commit("before", self._computer)
        self._require_answers()
        self._is_local = False
        self._site.journal.database.write("BEGIN")

    def _commit(self) -> None:
        site, begun_ns = self._site, self._spent_ns
        site.journal.database.write("COMMIT")
        site.position += 1
        has_copy = bool(site.standbys)
        site.on_commit("during", self._computer)
        self._require_answers()
        self._spent_ns += site.commit_ns
        if not (self._is_local or self._is_one_copy or has_copy) and len(site.machines) > 1:
            self._raise_late(begun_ns)
        site.on_commit("after", self._computer)

    def _require_answers(self) -> None:
        """Raises `JournalError` if its machine cannot be reached any more."""
        if not self._is_alive() or not self._machine:
            self._drop()
            raise make_lost_error(self.name)
        if self._site.is_cut(self._machine, self._computer):
            self._raise_late(self._spent_ns)
        if not self._site.answers(self._machine, self._computer):
            self._drop()
            raise make_lost_error(self.name)

    def _raise_late(self, begun_ns: int) -> None:
        self._spent_ns = begun_ns + round(self.deadline_s * NS_PER_S)
        self._drop()
        raise make_late_error(self.name, self.deadline_s)

    def _end_transaction(self) -> None:
        db = self._site.journal.database
        if db.in_transaction and self._connection is None:
            db.write("ROLLBACK")

    def _describe_server(self) -> tuple[Any, ...]:
        site = self._site
        names, commit = ("ANY 1 (*)" if len(site.machines) > 1 else ""), "local" if self._is_one_copy else "on"
        now_s = datetime.now(UTC).timestamp()
        return ("18.0", "on", commit, "on", False, names, "1", f"{site.timeline:08X}", now_s, True)
