"""Calls of the journal in virtual time: those that write fail while the disk is full."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from orchestrator.clock.executor import Executor
from orchestrator.coordinator.jobs.intake.client_keys import digest_request
from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.reads import READS
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.jobs.parts import dump_long
from orchestrator.runtime.virtual.disk import VirtualDisk

T = TypeVar("T")


class JournalCalls:
    """The calls of the coordinators of one fleet. writes: how many commits have changed the journal."""

    def __init__(self, disk: VirtualDisk) -> None:
        self.writes = 0
        self._disk = disk

    def make_executor(self) -> Executor:
        """Make the executor of a coordinator."""
        execute = self._disk.make_executor()

        async def run_journal_call(function: Callable[..., T], *values: Any) -> T:
            calls: Sequence[JournalCall] = values[0] if function.__name__ == SqliteJournal.run_group.__name__ else ()
            names = [call.name for call in calls] or [function.__name__]
            is_write = any(map(_is_write, names))
            self.writes += is_write

            def call_journal() -> T:
                if self._disk.full and is_write:
                    text = "the journal cannot be used (database or disk is full)"
                    error = JournalError(text, "free space on its disk")
                    if not calls:
                        raise error
                    for call in calls:
                        if _is_write(call.name):
                            call.fail(error)
                return function(*values)

            return await execute(call_journal)

        return run_journal_call


def _is_write(name: str) -> bool:
    return name not in READS and name not in {digest_request.__name__, dump_long.__name__}
