"""Calls of the journal in virtual time: those that write fail while the disk is full."""

from collections.abc import Callable
from typing import Any, TypeVar

from orchestrator.clock.executor import Executor
from orchestrator.coordinator.jobs.intake.client_keys import digest_request
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.sqlite.alarm_tables import AlarmTables
from orchestrator.coordinator.journal.sqlite.approval_table import ApprovalTable
from orchestrator.coordinator.journal.sqlite.command_table import CommandTable
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.coordinator.journal.sqlite.learned_table import LearnedTable
from orchestrator.coordinator.journal.sqlite.point_rows import PointRows
from orchestrator.coordinator.journal.sqlite.point_store import PointStore
from orchestrator.coordinator.journal.sqlite.statistics_table import StatisticsTable
from orchestrator.model.jobs.parts import dump_long
from orchestrator.runtime.virtual.disk import VirtualDisk

T = TypeVar("T")
READ_ONLY_JOURNAL_CALLS = frozenset(
    decision.__name__
    for decision in (
        SqliteJournal.list_decisions,
        SqliteJournal.find_jobs,
        SqliteJournal.find_referenced_jobs,
        SqliteJournal.load_job,
        SqliteJournal.load_job_body,
        digest_request,
        dump_long,
        SqliteJournal.find_keyed_job,
        SqliteJournal.load_recording,
        SqliteJournal.load_report,
        SqliteJournal.list_named_points,
        SqliteJournal.require_latest_epoch,
        PointRows.load_points,
        AlarmTables.load_alarms,
        AlarmTables.load_history,
        AlarmTables.load_notices,
        ApprovalTable.load_approval,
        CommandTable.list_commands,
        StatisticsTable.read_rows,
        LearnedTable.load_times,
        PointStore.read_rows,
        SqliteJournal.list_reservations,
        SqliteJournal.list_positions,
        SqliteJournal.load_record,
        SqliteJournal.list_transitions,
        SqliteJournal.list_unfinished,
    )
)


class JournalCalls:
    """The calls of the coordinators of one fleet. writes: how many have changed the journal, a commit each."""

    def __init__(self, disk: VirtualDisk) -> None:
        self.writes = 0
        self._disk = disk

    def make_executor(self) -> Executor:
        """Make the executor of a coordinator."""
        execute = self._disk.make_executor()

        async def run_journal_call(function: Callable[..., T], *values: Any) -> T:
            is_write = function.__name__ not in READ_ONLY_JOURNAL_CALLS
            self.writes += is_write

            def call() -> T:
                if self._disk.full and is_write:
                    text = "the journal cannot be used (database or disk is full)"
                    raise JournalError(text, "free space on its disk")
                return function(*values)

            return await execute(call)

        return run_journal_call
