"""The journal of one virtual coordinator in the databases of its fleet, with its lease."""

import asyncio
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.postgres.address import JournalAddress
from orchestrator.coordinator.journal.postgres.database import PostgresDatabase
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal, open_session
from orchestrator.coordinator.journal.postgres.lease import LeaseRenewal
from orchestrator.coordinator.journal.postgres.names import STANDBY
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sql.journal import SqlJournal
from orchestrator.coordinator.leadership.environment import JournalServer
from orchestrator.coordinator.leadership.lease import LeaseTerms
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.databases.session import ADDRESS, SessionOrigin, VirtualSession
from orchestrator.runtime.virtual.databases.site import DatabaseSite

T = TypeVar("T")


class _ConnectingJournal(PostgresJournal):
    """A journal that connects with its first call, and has the schema of its site."""

    def __init__(self, place: FleetDatabase) -> None:
        self._place = place
        self.database = PostgresDatabase(open_session(place, STANDBY), place.copies)
        SqlJournal.__init__(self, self.database, self.database)


class JournalClient:
    """What one coordinator has of the databases: made as `orchestrator.coordinator.opening` makes it, but that it
    connects with its first call. computer: its own."""

    def __init__(
        self, site: DatabaseSite, fleet: Fleet, clock: Clock, computer: str, is_alive: Callable[[], bool]
    ) -> None:
        self._site = site
        self._clock = clock
        self._origin = SessionOrigin(site, computer, is_alive)
        self._sessions: list[VirtualSession] = []
        database = FleetDatabase(ADDRESS, fleet.fleet, fleet.journal.copies, computer, make_session=self._make_session)
        self.journal = _ConnectingJournal(database)
        deadline_s = min(database.deadline_s, fleet.journal.lease / 3 / NS_PER_S)
        lease = LeaseRenewal(database._replace(deadline_s=deadline_s), lambda: self.journal.database.is_copy_missing)
        journal_session, lease_session = self._sessions
        self.execute = self._make_executor(journal_session)
        run_lease = self._make_executor(lease_session)
        self.server = JournalServer(lease, run_lease, self.journal.read_health)
        self.terms = LeaseTerms(lease, run_lease, fleet.journal.lease)

    def _make_session(self, _: JournalAddress, application: str, settings: str, deadline_s: float) -> VirtualSession:
        session = VirtualSession(self._origin, application, settings, deadline_s)
        self._sessions.append(session)
        return session

    def _make_executor(self, session: VirtualSession) -> Executor:
        """Make the executor of the calls of one session, in their order."""
        lock = asyncio.Lock()

        async def run_call(function: Callable[..., T], *values: Any) -> T:
            async with lock:
                await sleep_ns(self._clock, self._site.call_ns // 2)
                self._site.facts = _name_facts(function, values)
                try:
                    result: T | JournalError = function(*values)
                except JournalError as error:
                    result = error
                # The process may have died in the call: nothing of it goes on then.
                await sleep_ns(self._clock, max(1, session.take_spent_ns() - self._site.call_ns // 2))
                if isinstance(result, JournalError):
                    raise result
                return result

        return run_call


def _name_facts(function: Callable[..., object], values: Sequence[Any]) -> tuple[str, ...]:
    calls: Sequence[JournalCall] = values[0] if function.__name__ == PostgresJournal.run_group.__name__ else ()
    return tuple(call.name for call in calls) or (function.__name__,)
