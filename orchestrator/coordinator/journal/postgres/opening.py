"""Opens a journal by the address of its database, where the library for it is installed."""

from importlib.util import find_spec
from typing import TYPE_CHECKING, Literal

from orchestrator.coordinator.journal.records import JournalError

if TYPE_CHECKING:
    from orchestrator.coordinator.journal.postgres.journal import PostgresJournal


def open_journal(
    address: str, fleet: str, *, copies: Literal[1, 2] = 1, coordinator: str = "", is_new: bool = True
) -> "PostgresJournal":
    """Open the journal of a fleet; is_new: create it if it is not there. coordinator: what names this one in the
    database. Raises `JournalError`."""
    if find_spec("psycopg") is None:
        text = "a journal in PostgreSQL needs psycopg, which is not installed"
        raise JournalError(text, "install it: pip install 'tutti[postgres]'")
    from orchestrator.coordinator.journal.postgres.address import read_address
    from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, PostgresJournal

    return PostgresJournal(FleetDatabase(read_address(address), fleet, copies, coordinator), is_new=is_new)
