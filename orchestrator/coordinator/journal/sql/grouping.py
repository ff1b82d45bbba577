"""Calls of the journal that are one commit."""

from collections.abc import Sequence

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.records import JournalError, UnknownResult
from orchestrator.coordinator.journal.sql.database import Database


def run_group(db: Database, calls: Sequence[JournalCall]) -> None:
    """Run the calls that have not been run, as one transaction; if that fails, nothing of it is stored, and each is run
    alone. If it is unknown whether it was stored, that is the error of each. Raises nothing."""
    new_calls = [call for call in calls if not call.is_done]
    if len(new_calls) > 1:
        try:
            with db.transaction():
                for call in new_calls:
                    call.attempt()
                    if not db.in_transaction:
                        raise JournalError(f"{db.name}: the transaction was rolled back as a whole")
            for call in new_calls:
                call.is_done = True
        except UnknownResult as error:
            for call in new_calls:
                call.fail(error)
        except JournalError:
            pass
    for call in new_calls:
        call.run()
