"""Opens a journal by the address of its database, where the library for it is installed."""

from collections.abc import Callable
from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

from orchestrator.coordinator.journal.records import JournalError

if TYPE_CHECKING:
    from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal
    from orchestrator.coordinator.journal.postgres.lease import LeaseRenewal


def find_database(address: str, fleet: str, copies: Literal[1, 2] = 1, coordinator: str = "") -> "FleetDatabase":
    """The journal of a fleet in the database of an address. coordinator: what names this one there. Raises
    `JournalError`."""
    if find_spec("psycopg") is None:
        text = "a journal in PostgreSQL needs psycopg, which is not installed"
        raise JournalError(text, "install it: pip install 'tutti[postgres]'")
    from orchestrator.coordinator.journal.postgres.address import read_address
    from orchestrator.coordinator.journal.postgres.journal import FleetDatabase
    from orchestrator.coordinator.journal.postgres.lines import SeenLine

    return FleetDatabase(read_address(address), fleet, copies, coordinator, seen_line=SeenLine())


def open_leader_journal(database: "FleetDatabase", *, is_new: bool) -> "PostgresJournal":
    """Open a journal; is_new: create it if it is not there. Raises `JournalError`."""
    from orchestrator.coordinator.journal.postgres.journal import PostgresJournal

    return PostgresJournal(database, is_new=is_new)


def open_lease(database: "FleetDatabase", deadline_s: float, is_copy_missing: Callable[[], bool]) -> "LeaseRenewal":
    """The lease of its leader. deadline_s: of each call."""
    from orchestrator.coordinator.journal.postgres.lease import LeaseRenewal

    return LeaseRenewal(database._replace(deadline_s=min(database.deadline_s, deadline_s)), is_copy_missing)


def open_journal(
    address: str, fleet: str, *, copies: Literal[1, 2] = 1, coordinator: str = "", is_new: bool = True
) -> "PostgresJournal":
    """Open the journal of a fleet by its address, as `find_database` and `open_leader_journal`. Raises
    `JournalError`."""
    return open_leader_journal(find_database(address, fleet, copies, coordinator), is_new=is_new)
