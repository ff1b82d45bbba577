"""The journal in a database: what was accepted, decided and done is stored safely before it is reported anywhere.

`SqlJournal` is synchronous; the caller chooses where it runs (`orchestrator.clock.executor`).
"""

from collections.abc import Sequence

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.sql.alarm_tables import AlarmTables
from orchestrator.coordinator.journal.sql.approval_table import ApprovalTable
from orchestrator.coordinator.journal.sql.command_table import CommandTable
from orchestrator.coordinator.journal.sql.database import Database
from orchestrator.coordinator.journal.sql.grouping import run_group
from orchestrator.coordinator.journal.sql.job_changes import JobChanges
from orchestrator.coordinator.journal.sql.leader_values import LeaderValues
from orchestrator.coordinator.journal.sql.learned_table import LearnedTable
from orchestrator.coordinator.journal.sql.manual_tables import ManualTables
from orchestrator.coordinator.journal.sql.point_rows import PointRows
from orchestrator.coordinator.journal.sql.point_store import PointStore
from orchestrator.coordinator.journal.sql.statistics_table import StatisticsTable


class SqlJournal(LeaderValues, JobChanges, ManualTables):
    """`JournalStore` but for `close`: every method that changes something has committed when it returns."""

    def __init__(self, db: Database, points: Database) -> None:
        """points: the database of the points of scans, which may be the same."""
        super().__init__(db)
        self.point_rows = PointRows(db)
        self.alarms = AlarmTables(db)
        self.statistics, self.learned = StatisticsTable(db), LearnedTable(db)
        self.approvals = ApprovalTable(db)
        self.commands = CommandTable(db)
        self.points = PointStore(points)

    def run_group(self, calls: Sequence[JournalCall], epoch: int) -> None:
        self.require_latest_epoch(epoch)
        run_group(self._db, calls)

    def prune_jobs(self, before_utc: str, keep: int) -> int:
        count, digests = self.delete_old_jobs(before_utc, keep)
        for digest in digests:
            self.points.delete_upload(digest)
        return count
