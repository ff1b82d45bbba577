"""The ends of jobs in the campaign, by their records."""

from collections.abc import Callable

from orchestrator.campaign.stages.flown_scans import find_flown_scan
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import FINISHED_STATES, JobReport

MOST_ROWS = 1000
MOST_COMMANDS = 10_000
AddViolation = Callable[[str, str], None]
"""Called with the invariant and a text."""


def check_end(journal: SqliteJournal, row: JobRecord, report: JobReport, job: Job, add_violation: AddViolation) -> None:
    """Check invariant 6: a job has ended once, and no step was decided twice for one motion. A step that was held on
    its way, or got other targets, is decided again for what is left of it. A scan that flies is begun again as often as
    chunks come too late, with a move and a flight: its rows show what was flown."""
    ends = sum(change.state in FINISHED_STATES for change in report.transitions)
    decisions = [step for step, _ in journal.list_decisions(row.id)]
    commands = journal.commands.list_commands(MOST_COMMANDS)
    parts = sum(command.verb == "retarget" and command.subject.startswith(row.id) for command in commands)
    parts += sum(change.state == "paused" for change in report.transitions)
    is_repeated = len(decisions) - len(set(decisions)) > parts and find_flown_scan(job) is None
    if ends != 1 or is_repeated:
        add_violation("6", f"job {row.name} ended {ends} times; decisions for its steps: {decisions}")


def check_live_job(journal: SqliteJournal, row: JobRecord, add_violation: AddViolation) -> None:
    """Check invariant 3 of a live job that has ended, by its rows and its decisions. The step that was loaded behind
    the failed one may have been decided before."""
    rows = journal.point_rows.load_points(row.id, (-1, 0), MOST_ROWS)
    failed_row = next((point for point in rows if point.state != "done" and point.t0_fleet_ns is not None), None)
    if failed_row is None:
        return
    if row.state == "done":
        add_violation("3", f"live job {row.name} is done, although move {failed_row.point} is {failed_row.state}")
    later_steps = sorted(step for step, _ in journal.list_decisions(row.id) if step >= failed_row.point)
    if len(later_steps) > 1:
        add_violation(
            "3", f"live job {row.name} went on to {later_steps} behind move {failed_row.point}, {failed_row.state}"
        )
