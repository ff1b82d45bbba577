"""Calls of the journal that are one commit."""

from collections.abc import Sequence
from contextlib import suppress

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sql.database import Database


def run_group(db: Database, calls: Sequence[JournalCall]) -> None:
    """Run the calls that have not been run, as one transaction; if that fails, nothing of it is stored, and each is run
    alone. Raises nothing."""
    new_calls = [call for call in calls if not call.is_done]
    if len(new_calls) > 1:
        with suppress(JournalError):
            with db.transaction():
                for call in new_calls:
                    call.attempt()
                    if not db.in_transaction:
                        raise JournalError(f"{db.name}: the transaction was rolled back as a whole")
            for call in new_calls:
                call.is_done = True
    for call in new_calls:
        call.run()
