"""Live jobs of the campaign: nothing follows a step that has failed in motion."""

from collections.abc import Callable

from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal

MOST_ROWS = 1000


def check_live_job(journal: SqliteJournal, row: JobRecord, add_violation: Callable[[str, str], None]) -> None:
    """Check invariant 3 of a live job that has ended, by its rows and its decisions. The step that was loaded behind
    the failed one may have been decided before."""
    rows = journal.point_rows.load_points(row.id, (-1, 0), MOST_ROWS)
    failed = next((point for point in rows if point.state != "done" and point.t0_fleet_ns is not None), None)
    if failed is None:
        return
    if row.state == "done":
        add_violation("3", f"live job {row.name} is done, although move {failed.point} is {failed.state}")
    later_steps = sorted(step for step, _ in journal.list_decisions(row.id) if step >= failed.point)
    if len(later_steps) > 1:
        add_violation("3", f"live job {row.name} went on to {later_steps} behind move {failed.point}, {failed.state}")
