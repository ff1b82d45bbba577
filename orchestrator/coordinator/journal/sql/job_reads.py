"""Jobs as they are read: their records, bodies, transitions, decisions and reports."""

from typing import Any, TypeVar

from pydantic import ValidationError

from orchestrator.coordinator.journal.facts import KeyedJob
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.coordinator.journal.sql.database import JournalPart, make_marks
from orchestrator.coordinator.journal.sql.rows import (
    BODY,
    COLUMNS,
    FIND_KEY,
    SELECT_JOB,
    is_whole,
    make_damaged_error,
    make_record,
    read_body,
    scope_key,
)
from orchestrator.model.base import Model
from orchestrator.model.jobs.job import Job
from orchestrator.model.problems import first_error_text
from orchestrator.model.report import FINISHED_STATES, JobReport, JobState, JobTransition, StepRecording

M = TypeVar("M", bound=Model)

LAST_CHARACTER = "\U0010ffff"  # after all others in the order of ids


class JobReads(JournalPart):
    """The methods of `JournalStore` that read jobs."""

    def find_keyed_job(self, owner: str, client_key: str) -> KeyedJob | None:
        rows = self._db.select(FIND_KEY, (scope_key(owner, client_key), client_key))
        return KeyedJob(*rows[0]) if rows else None

    def list_decisions(self, job_id: str) -> list[tuple[int, int]]:
        query = "SELECT step, t0_fleet_ns FROM decisions WHERE job_id = ? ORDER BY rowid"
        return [(step, t0_fleet_ns) for step, t0_fleet_ns in self._db.select(query, (job_id,))]

    def load_job_body(self, job_id: str) -> str | None:
        rows = self._db.select(SELECT_JOB, (job_id,))
        if rows and not is_whole(rows[0]):
            raise make_damaged_error(self._db.name, "the Job", job_id, "its checksum is wrong")
        return rows[0][BODY] if rows else None

    def load_job(self, job_id: str) -> Job | None:
        body = self.load_job_body(job_id)
        return None if body is None else read_body(self._db.name, Job, body, job_id)

    def load_record(self, job_id: str) -> JobRecord | None:
        records = self._select_records("WHERE id = ?", (job_id,))
        return records[0] if records else None

    def list_unfinished(self) -> list[JobRecord]:
        finished_states = tuple(sorted(FINISHED_STATES))
        condition = f"WHERE state NOT IN ({make_marks(len(finished_states))})"
        return self._select_records(f"{condition} ORDER BY priority DESC, place", finished_states)

    def find_jobs(
        self, limit: int, state: JobState | None = None, name: str = "", since_utc: str = "", before_id: str = ""
    ) -> tuple[list[JobRecord], int]:
        wishes = (
            (state, "state = ?"),
            (name, "replace(name, ?, '') <> name"),  # it contains that
            (since_utc, "submitted_utc >= ?"),
            (before_id, "number < (SELECT number FROM jobs WHERE id = ?)"),
        )
        values = tuple(value for value, _ in wishes if value)
        condition = " AND ".join(["WHERE number > 0", *(text for value, text in wishes if value)])
        total = self._db.select(f"SELECT count(*) FROM jobs {condition}", values)[0][0]
        return self._select_records(f"{condition} ORDER BY number DESC LIMIT ?", (*values, limit)), total

    def find_referenced_jobs(self, reference: str, limit: int = 5) -> list[JobRecord]:
        for clause, values in (
            ("WHERE id = ?", (reference,)),
            ("WHERE id >= ? AND id < ?", (reference, reference + LAST_CHARACTER)),
            ("WHERE name = ?", (reference,)),
        ):
            jobs = self._select_records(f"{clause} ORDER BY number DESC LIMIT ?", (*values, limit))
            if jobs:
                return jobs
        return []

    def list_transitions(self, job_id: str) -> list[JobTransition]:
        query = "SELECT state, reason, actor, utc, fleet_ns FROM transitions WHERE job_id = ? ORDER BY rowid"
        rows = self._db.select(query, (job_id,))
        try:
            return [JobTransition(state=s, reason=r, actor=a, utc=u, fleet_ns=f) for s, r, a, u, f in rows]
        except ValidationError as error:
            raise make_damaged_error(self._db.name, "a transition", job_id, first_error_text(error)) from None

    def load_report(self, job_id: str) -> JobReport | None:
        return self._select_body(JobReport, "SELECT body FROM reports WHERE job_id = ?", (job_id,))

    def list_named_points(self) -> set[str]:
        return {digest for (digest,) in self._db.select("SELECT DISTINCT digest FROM job_points")}

    def load_recording(self, job_id: str, step: int) -> StepRecording | None:
        values = (job_id, step)
        return self._select_body(StepRecording, "SELECT body FROM recordings WHERE job_id = ? AND step = ?", values)

    def _select_records(self, clause: str, values: tuple[Any, ...]) -> list[JobRecord]:
        return [make_record(row) for row in self._db.select(f"SELECT {COLUMNS} FROM jobs {clause}", values)]

    def _select_body(self, model: type[M], query: str, values: tuple[Any, ...]) -> M | None:
        rows = self._db.select(query, values)
        return read_body(self._db.name, model, rows[0][0], values[0]) if rows else None
