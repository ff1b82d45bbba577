"""Jobs from their acceptance to their deletion: each change is one transaction."""

from collections.abc import Iterable, Mapping
from typing import get_args

from orchestrator.coordinator.journal.facts import QueueEntryOptions, StepDecision
from orchestrator.coordinator.journal.records import JobHasEnded, JobRecord
from orchestrator.coordinator.journal.sql.database import make_insert, make_marks, make_upsert
from orchestrator.coordinator.journal.sql.job_reads import JobReads
from orchestrator.coordinator.journal.sql.job_states import find_state, insert_transition, is_queued
from orchestrator.coordinator.journal.sql.rows import find_checksum, list_term_values, scope_key
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import dump_long
from orchestrator.model.queue import APPROVAL, WAITS_FOR_APPROVAL
from orchestrator.model.report import FINISHED_STATES, JobReport, JobState, JobTransition, StepRecording
from orchestrator.model.steps.tree import find_digests

MAX_RECORDED_JOBS = 100  # the newest jobs only: recordings are large, and the reports are kept
MAX_RECORDED_STEPS = 10_000  # the newest of a job

_UNFINISHED_STATES = tuple(sorted(set(get_args(JobState)) - FINISHED_STATES))
_DELETED_AT_ONCE = 500  # jobs, in one statement
_TABLES_OF_JOBS = ("recordings", "reports", "decisions", "transitions", "job_points", "point_rows", "approvals")
_STORE_REPORT = make_upsert("reports", ["job_id"], ["body"])
_STORE_RECORDING = make_upsert("recordings", ("job_id", "step"), ["body"])
_STORE_DECISION = make_insert("decisions", ("job_id", *StepDecision._fields, "utc"))
_STORE_DIGEST = make_insert("job_points", ("job_id", "digest"))


class JobChanges(JobReads):
    """The methods of `JournalStore` that change jobs."""

    def accept_job(
        self, job_id: str, client_key: str, job: Job, utc: str, entry: QueueEntryOptions | None = None
    ) -> tuple[str, bool]:
        terms, origin, owner, digest = entry or QueueEntryOptions()
        with self._db.transaction(copied=True):
            first_job = self.find_keyed_job(owner, client_key)
            if first_job is not None:
                return first_job.job_id, False
            reason = WAITS_FOR_APPROVAL if terms.proposed else "submitted"
            values = {
                "id": job_id,
                "client_key": scope_key(owner, client_key),
                "name": job.name,
                "actor": job.actor,
                "body": dump_long(job).decode(),
                "state": "queued",
                "reason": reason,
                "submitted_utc": utc,
                **list_term_values(terms),
                "held_by": APPROVAL if terms.proposed else job.actor if terms.held else "",
                "origin": origin.origin if origin else None,
                "from_step": origin.from_step if origin else 0,
                "request_digest": digest,
            }
            values["crc"] = find_checksum(values)
            self._db.write(make_insert("jobs", tuple(values)), tuple(values.values()))
            self._db.write("UPDATE jobs SET place = number WHERE id = ?", (job_id,))
            self._db.write_many(_STORE_DIGEST, [(job_id, digest) for digest in find_digests(job.steps)])
            insert_transition(self._db, job_id, JobTransition(state="queued", reason=reason, actor=job.actor, utc=utc))
        return job_id, True

    def record_transition(self, job_id: str, transition: JobTransition) -> None:
        with self._db.transaction():
            self._require_unended(job_id)
            insert_transition(self._db, job_id, transition)

    def record_end(self, job_id: str, transition: JobTransition, report: JobReport) -> JobReport:
        with self._db.transaction():
            self._require_unended(job_id)
            transitions = [*self.list_transitions(job_id), transition]
            report = report.model_copy(update={"transitions": transitions})
            insert_transition(self._db, job_id, transition)
            self._db.write(_STORE_REPORT, (job_id, report.model_dump_json()))
        return report

    def hold_jobs(self, job_ids: Iterable[str], held_by: str, transition: JobTransition) -> None:
        with self._db.transaction():
            for job_id in job_ids:
                if is_queued(self._db, job_id):
                    self._db.write("UPDATE jobs SET held_by = ? WHERE id = ?", (held_by, job_id))
                    insert_transition(self._db, job_id, transition)

    def mark_due(self, job_id: str, transition: JobTransition) -> None:
        with self._db.transaction():
            if is_queued(self._db, job_id):
                self._db.write("UPDATE jobs SET due = 1 WHERE id = ?", (job_id,))
                insert_transition(self._db, job_id, transition)

    def reorder_jobs(self, job_id: str, priority: int, places: Mapping[str, int], transition: JobTransition) -> None:
        with self._db.transaction():
            if is_queued(self._db, job_id):
                moved_places = [(number, name) for name, number in places.items()]
                self._db.write_many("UPDATE jobs SET place = ? WHERE id = ?", moved_places)
                self._db.write("UPDATE jobs SET priority = ? WHERE id = ?", (priority, job_id))
                insert_transition(self._db, job_id, transition)

    def _require_unended(self, job_id: str) -> None:
        state = find_state(self._db, job_id)
        if state in FINISHED_STATES:
            raise JobHasEnded(f"job {job_id} is {state} already: another coordinator has ended it")

    def record_decision(self, job_id: str, decision: StepDecision, utc: str) -> None:
        with self._db.transaction():
            self._require_unended(job_id)
            self._db.write(_STORE_DECISION, (job_id, *decision, utc))

    def withdraw_decision(self, job_id: str, step: int, t0_fleet_ns: int) -> None:
        with self._db.transaction():
            self._require_unended(job_id)
            self._db.write(
                "DELETE FROM decisions WHERE job_id = ? AND step = ? AND t0_fleet_ns = ?", (job_id, step, t0_fleet_ns)
            )

    def fail_damaged(self, job: JobRecord, transition: JobTransition, report: JobReport) -> None:
        with self._db.transaction():
            if self._db.select("SELECT 1 FROM jobs WHERE id = ?", (job.id,)):
                insert_transition(self._db, job.id, transition)
                self._db.write(_STORE_REPORT, (job.id, report.model_dump_json()))

    def store_recording(self, job_id: str, recording: StepRecording) -> None:
        with self._db.transaction():
            self._db.write(_STORE_RECORDING, (job_id, recording.step, recording.model_dump_json()))
            self._db.write(
                "DELETE FROM recordings WHERE job_id NOT IN (SELECT id FROM jobs ORDER BY number DESC LIMIT ?)",
                (MAX_RECORDED_JOBS,),
            )
            self._db.write(
                "DELETE FROM recordings WHERE job_id = ? AND step <="
                " (SELECT step FROM recordings WHERE job_id = ? ORDER BY step DESC LIMIT 1 OFFSET ?)",
                (job_id, job_id, MAX_RECORDED_STEPS),
            )

    def delete_old_jobs(self, before_utc: str, keep: int) -> tuple[int, set[str]]:
        """Delete the jobs of `prune_jobs`: (how many, digests of points that they named and no other job does)."""
        marks = make_marks(len(_UNFINISHED_STATES))
        query = (
            f"SELECT id FROM jobs WHERE submitted_utc < ? AND state NOT IN ({marks})"
            " AND number NOT IN (SELECT number FROM jobs ORDER BY number DESC LIMIT ?)"
            f" AND id NOT IN (SELECT after_job FROM jobs WHERE after_job IS NOT NULL AND state IN ({marks}))"
        )
        digests = set[str]()
        with self._db.transaction():
            rows = self._db.select(query, (before_utc, *_UNFINISHED_STATES, keep, *_UNFINISHED_STATES))
            for begin in range(0, len(rows), _DELETED_AT_ONCE):
                digests |= self._delete_jobs([job_id for (job_id,) in rows[begin : begin + _DELETED_AT_ONCE]])
        return len(rows), digests - self.list_named_points()

    def _delete_jobs(self, job_ids: list[str]) -> set[str]:
        """Delete jobs; return the digests of the points that they named."""
        marks = make_marks(len(job_ids))
        digests = self._db.select(f"SELECT digest FROM job_points WHERE job_id IN ({marks})", job_ids)
        for table in _TABLES_OF_JOBS:
            self._db.write(f"DELETE FROM {table} WHERE job_id IN ({marks})", job_ids)
        self._db.write(f"DELETE FROM jobs WHERE id IN ({marks})", job_ids)
        return {digest for (digest,) in digests}
