"""Opens the journal of a coordinator process: a file of this computer, or a database that others reach too."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from orchestrator.clock.executor import Executor, ThreadExecutor
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal, require_journal
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.environment import JournalServer
from orchestrator.coordinator.leadership.lease import LeaseTerms
from orchestrator.model.queue import JournalPolicy

SCHEME = "postgresql://"


def is_address(journal: str) -> bool:
    """Whether a journal is one in a database."""
    return journal.startswith(SCHEME)


@dataclass(frozen=True, slots=True)
class JournalWish:
    """The journal of a fleet. place: a file, or the address of a database. existing: refuse a missing one.
    coordinator: what names this process in the database."""

    place: str
    fleet: str
    policy: JournalPolicy
    existing: bool = False
    coordinator: str = ""


@dataclass(frozen=True, slots=True)
class OpenedJournal:
    """A journal, and its server, if it is in a database. close: closes both."""

    journal: JournalStore
    server: JournalServer | None
    close: Callable[[], None]


def open_journal_of(wish: JournalWish) -> OpenedJournal:
    """Open it, in the thread that will call it. Raises `JournalError`."""
    if not is_address(wish.place):
        path = Path(wish.place)
        if wish.existing:
            require_journal(path)
        journal = SqliteJournal(path)
        return OpenedJournal(journal, None, journal.close)
    from orchestrator.coordinator.journal.postgres.opening import find_database, open_leader_journal, open_lease

    database = find_database(wish.place, wish.fleet, wish.policy.copies, wish.coordinator)
    journal = open_leader_journal(database, is_new=not wish.existing)
    # Two thirds of the lease have to have room for two tries.
    lease = open_lease(database, wish.policy.lease / 3e9, lambda: journal.database.is_copy_missing)

    def close() -> None:
        lease.close()
        journal.close()

    return OpenedJournal(journal, JournalServer(lease, ThreadExecutor("lease"), journal.read_health), close)


def open_lease_of(wish: JournalWish, run: Executor) -> tuple[LeaseTerms, Callable[[], None]] | None:
    """The lease that a standby waits for, and what closes it; None: the journal is a file. Raises `JournalError`."""
    if not is_address(wish.place):
        return None
    opened_journal = open_journal_of(wish)
    assert opened_journal.server is not None
    return LeaseTerms(opened_journal.server.lease, run, wish.policy.lease), opened_journal.close
