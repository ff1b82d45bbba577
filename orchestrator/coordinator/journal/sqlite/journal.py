"""The journal in SQLite: what was accepted, decided and done is on disk before it is reported anywhere.

`SqliteJournal` is synchronous; the caller chooses where it runs (`orchestrator.clock.executor`).
"""

import json
import re
import sqlite3
import weakref
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar, get_args
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.facts import KeyedJob, QueueEntryOptions, Reservation, StepDecision
from orchestrator.coordinator.journal.records import (
    UNREADABLE_TIME,
    EpochOvertaken,
    JobHasEnded,
    JobRecord,
    JournalError,
)
from orchestrator.coordinator.journal.sqlite.alarm_tables import AlarmTables
from orchestrator.coordinator.journal.sqlite.approval_table import ApprovalTable
from orchestrator.coordinator.journal.sqlite.command_table import CommandTable
from orchestrator.coordinator.journal.sqlite.job_states import insert_transition, is_queued
from orchestrator.coordinator.journal.sqlite.learned_table import LearnedTable
from orchestrator.coordinator.journal.sqlite.point_rows import PointRows
from orchestrator.coordinator.journal.sqlite.point_store import PointStore
from orchestrator.coordinator.journal.sqlite.rows import (
    BODY,
    COLUMNS,
    FIND_KEY,
    SELECT_JOB,
    find_checksum,
    is_whole,
    list_term_values,
    make_damaged_error,
    make_record,
    read_body,
    scope_key,
)
from orchestrator.coordinator.journal.sqlite.saved_positions import read_positions
from orchestrator.coordinator.journal.sqlite.schema import VERSION, list_statements, read_version
from orchestrator.coordinator.journal.sqlite.statistics_table import StatisticsTable
from orchestrator.coordinator.journal.sqlite.transaction import (
    DATABASE_ERRORS,
    Transaction,
    connect_database,
    create_private_file,
    find_file_identity,
    make_unusable_error,
    run_group,
)
from orchestrator.coordinator.journal.sqlite.values import StoredValues
from orchestrator.model.base import Model
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import dump_long
from orchestrator.model.messages import MAX_EPOCH, MAX_EPOCH_STEP
from orchestrator.model.positions.entries import SavedPosition
from orchestrator.model.problems import first_error_text
from orchestrator.model.queue import APPROVAL, WAITS_FOR_APPROVAL, QueueStop
from orchestrator.model.report import FINISHED_STATES, JobReport, JobState, JobTransition, StepRecording
from orchestrator.model.steps.tree import find_digests

T = TypeVar("T")
M = TypeVar("M", bound=Model)
MAX_RECORDED_JOBS = 100  # the newest jobs only: recordings are large, and the reports are kept
MAX_RECORDED_STEPS = 10_000  # the newest of a job

LAST_CHARACTER = "\U0010ffff"  # after all others in the order of ids
_UNFINISHED_STATES = tuple(sorted(set(get_args(JobState)) - FINISHED_STATES))


class SqliteJournal:
    """`JournalStore` in a database: every method that changes something has committed to disk when it returns."""

    def __init__(self, path: str | Path) -> None:
        """Open or create the journal at `path` (`:memory:` for tests). Raises `JournalError`."""
        self._path = str(path)
        try:
            if self._path != ":memory:":
                create_private_file(Path(path))
            self._db = connect_database(self._path, check_same_thread=False)
            # A journal that is dropped, like that of a virtual fleet, closes its database.
            self._close = weakref.finalize(self, self._db.close)
            version = self._check_file()
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute("PRAGMA foreign_keys=ON")
            steps = list_statements(version)
            if steps:
                self._db.executescript(f"BEGIN; {steps} PRAGMA user_version={VERSION}; COMMIT;")
            self._identity = find_file_identity(self._path)
            self._values = StoredValues(self._db)
            self.point_rows = PointRows(self._db, self._path)
            self.alarms = AlarmTables(self._db, self._path)
            self.statistics, self.learned = StatisticsTable(self._db, self._path), LearnedTable(self._db, self._path)
            self.approvals = ApprovalTable(self._db, self._path)
            self.commands = CommandTable(self._db, self._path)
            self.points = PointStore(self._path if self._path == ":memory:" else f"{self._path}-points")
        except (*DATABASE_ERRORS, OSError) as error:
            raise make_unusable_error(self._path, error) from None

    def _check_file(self) -> int:
        """The schema version of the file, 0 for a new one. Raises `JournalError`, and `sqlite3.Error` if the file
        must not be written."""
        version = read_version(self._db, self._path)
        damage = self._db.execute("PRAGMA quick_check(1)").fetchone()[0]
        if damage != "ok":
            raise sqlite3.DatabaseError(damage)
        return version

    def _require_same_file(self) -> None:
        """Raises `JournalError` if the file that is open is no longer the one at its path: what is written to a deleted
        file is lost with this process."""
        if find_file_identity(self._path) != self._identity:
            raise JournalError(
                f"{self._path}: the journal was deleted or replaced while it was in use; no job is accepted",
                "end the fleet (`tutti down`), put the state folder back or begin a new journal: "
                "`tutti up FILE --new-journal`",
            )

    @property
    def database(self) -> sqlite3.Connection:
        """The database, for what looks at it, or damages it, from outside."""
        return self._db

    def close(self) -> None:
        self.points.close()
        self._close()

    def run_group(self, calls: Sequence[JournalCall]) -> None:
        run_group(self._db, self._path, calls)

    # Leadership

    def take_epoch(self, seen: int) -> int:
        with self._transaction():
            last = self._read_epoch()
            epoch = max(last, seen if seen <= last + MAX_EPOCH_STEP else 0) + 1
            self._values.write("epoch", str(epoch))
        return epoch

    def require_latest_epoch(self, epoch: int) -> None:
        last = self._read_epoch()
        if last > epoch:
            raise EpochOvertaken(f"epoch {epoch} is over: a coordinator leads with epoch {last}")

    def _read_epoch(self) -> int:
        epoch_text = self._read_value("epoch", "0")
        if not epoch_text.isdecimal() or int(epoch_text) > MAX_EPOCH:
            raise make_unusable_error(self._path, ValueError(f"its epoch {epoch_text!r} is damaged"))
        return int(epoch_text)

    def fleet_time_scale(self, kernel_id: str, now_ns: int, scale_id: str) -> tuple[str, int]:
        with self._transaction():
            origin = self._values.read("origin_host_ns")
            if self._values.read("kernel_id") == kernel_id and re.fullmatch(r"-?\d+", origin):
                return self._values.read("scale_id"), int(origin)
            self._values.write("kernel_id", kernel_id)
            self._values.write("scale_id", scale_id)
            self._values.write("origin_host_ns", str(now_ns))
        return scale_id, now_ns

    # The queue as a whole

    def load_queue_stop(self) -> QueueStop | None:
        text = self._read_value("queue_stop")
        try:
            return QueueStop.read_stored(text) if text else None
        except ValidationError:
            # Stopped is the safe reading.
            return QueueStop(reason="its state in the journal is damaged", actor="coordinator", utc=UNREADABLE_TIME)

    def store_queue_stop(self, stop: QueueStop | None) -> None:
        with self._transaction():
            self._values.write("queue_stop", "" if stop is None else stop.model_dump_json())

    def load_instances(self) -> dict[str, str]:
        try:
            instances: dict[str, str] = json.loads(self._read_value("instances", "{}"))
        except ValueError:
            return {}  # every adapter then counts as started again
        return instances

    def store_instances(self, instances: Mapping[str, str]) -> None:
        with self._transaction():
            self._values.write("instances", json.dumps(dict(instances)))

    # Jobs

    def accept_job(
        self, job_id: str, client_key: str, job: Job, utc: str, entry: QueueEntryOptions | None = None
    ) -> tuple[str, bool]:
        terms, origin, owner, digest = entry or QueueEntryOptions()
        self._require_same_file()
        with self._transaction():
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
            marks = ", ".join("?" * len(values))
            cursor = self._db.execute(f"INSERT INTO jobs ({', '.join(values)}) VALUES ({marks})", (*values.values(),))
            self._db.execute("UPDATE jobs SET place = number WHERE number = ?", (cursor.lastrowid,))
            digests = [(job_id, digest) for digest in find_digests(job.steps)]
            self._db.executemany("INSERT INTO job_points VALUES (?, ?)", digests)
            fields = (job_id, reason, job.actor, utc)
            self._db.execute("INSERT INTO transitions VALUES (?, 'queued', ?, ?, ?, NULL)", fields)
        return job_id, True

    def find_keyed_job(self, owner: str, client_key: str) -> KeyedJob | None:
        rows = self._select_rows(FIND_KEY, (scope_key(owner, client_key), client_key))
        return KeyedJob(*rows[0]) if rows else None

    def record_transition(self, job_id: str, transition: JobTransition) -> None:
        with self._transaction():
            self._require_unended(job_id)
            insert_transition(self._db, job_id, transition)

    def record_end(self, job_id: str, transition: JobTransition, report: JobReport) -> JobReport:
        with self._transaction():
            self._require_unended(job_id)
            transitions = [*self.list_transitions(job_id), transition]
            report = report.model_copy(update={"transitions": transitions})
            insert_transition(self._db, job_id, transition)
            self._db.execute("INSERT OR REPLACE INTO reports VALUES (?, ?)", (job_id, report.model_dump_json()))
        return report

    def hold_jobs(self, job_ids: Iterable[str], held_by: str, transition: JobTransition) -> None:
        with self._transaction():
            for job_id in job_ids:
                if is_queued(self._db, job_id):
                    self._db.execute("UPDATE jobs SET held_by = ? WHERE id = ?", (held_by, job_id))
                    insert_transition(self._db, job_id, transition)

    def mark_due(self, job_id: str, transition: JobTransition) -> None:
        with self._transaction():
            if is_queued(self._db, job_id):
                self._db.execute("UPDATE jobs SET due = 1 WHERE id = ?", (job_id,))
                insert_transition(self._db, job_id, transition)

    def reorder_jobs(self, job_id: str, priority: int, places: Mapping[str, int], transition: JobTransition) -> None:
        with self._transaction():
            if is_queued(self._db, job_id):
                moved_places = [(number, name) for name, number in places.items()]
                self._db.executemany("UPDATE jobs SET place = ? WHERE id = ?", moved_places)
                self._db.execute("UPDATE jobs SET priority = ? WHERE id = ?", (priority, job_id))
                insert_transition(self._db, job_id, transition)

    def _require_unended(self, job_id: str) -> None:
        row = self._db.execute("SELECT state FROM jobs WHERE id = ?", (job_id,)).fetchone()
        if row is not None and row[0] in FINISHED_STATES:
            raise JobHasEnded(f"job {job_id} is {row[0]} already: another coordinator has ended it")

    def record_decision(self, job_id: str, decision: StepDecision, utc: str) -> None:
        with self._transaction():
            self._require_unended(job_id)
            self._db.execute("INSERT INTO decisions VALUES (?, ?, ?, ?, ?, ?)", (job_id, *decision, utc))

    def withdraw_decision(self, job_id: str, step: int, t0_fleet_ns: int) -> None:
        with self._transaction():
            self._require_unended(job_id)
            self._db.execute(
                "DELETE FROM decisions WHERE job_id = ? AND step = ? AND t0_fleet_ns = ?", (job_id, step, t0_fleet_ns)
            )

    def list_decisions(self, job_id: str) -> list[tuple[int, int]]:
        rows = self._select_rows("SELECT step, t0_fleet_ns FROM decisions WHERE job_id = ? ORDER BY rowid", (job_id,))
        return [(step, t0_fleet_ns) for step, t0_fleet_ns in rows]

    def load_job_body(self, job_id: str) -> str | None:
        rows = self._select_rows(SELECT_JOB, (job_id,))
        if rows and not is_whole(rows[0]):
            raise make_damaged_error(self._path, "the Job", job_id, "its checksum is wrong")
        return rows[0][BODY] if rows else None

    def load_job(self, job_id: str) -> Job | None:
        body = self.load_job_body(job_id)
        return None if body is None else read_body(self._path, Job, body, job_id)

    def load_record(self, job_id: str) -> JobRecord | None:
        records = self._select_records("WHERE id = ?", (job_id,))
        return records[0] if records else None

    def list_unfinished(self) -> list[JobRecord]:
        finished_states = tuple(sorted(FINISHED_STATES))
        marks = ", ".join("?" * len(finished_states))
        return self._select_records(f"WHERE state NOT IN ({marks}) ORDER BY priority DESC, place", finished_states)

    def fail_damaged(self, job: JobRecord, transition: JobTransition, report: JobReport) -> None:
        with self._transaction():
            if self._db.execute("SELECT 1 FROM jobs WHERE id = ?", (job.id,)).fetchone():
                insert_transition(self._db, job.id, transition)
                self._db.execute("INSERT OR REPLACE INTO reports VALUES (?, ?)", (job.id, report.model_dump_json()))

    def find_jobs(
        self, limit: int, state: JobState | None = None, name: str = "", since_utc: str = "", before_id: str = ""
    ) -> tuple[list[JobRecord], int]:
        condition = f"WHERE (? IS NULL OR state = ?) AND {'instr(name, ?) > 0' if name else 'length(?) = 0'}"
        condition += " AND submitted_utc >= ? AND (? = '' OR number < (SELECT number FROM jobs WHERE id = ?))"
        values = (state, state, name, since_utc, before_id, before_id)
        total = self._select_rows(f"SELECT count(*) FROM jobs {condition}", values)[0][0]
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
        rows = self._select_rows(
            "SELECT state, reason, actor, utc, fleet_ns FROM transitions WHERE job_id = ? ORDER BY rowid", (job_id,)
        )
        try:
            return [JobTransition(state=s, reason=r, actor=a, utc=u, fleet_ns=f) for s, r, a, u, f in rows]
        except ValidationError as error:
            raise make_damaged_error(self._path, "a transition", job_id, first_error_text(error)) from None

    def load_report(self, job_id: str) -> JobReport | None:
        return self._select_body(JobReport, "SELECT body FROM reports WHERE job_id = ?", (job_id,))

    def prune_jobs(self, before_utc: str, keep: int) -> int:
        marks = ", ".join("?" * len(_UNFINISHED_STATES))
        old = (
            f"SELECT id FROM jobs WHERE submitted_utc < ? AND state NOT IN ({marks})"
            " AND number NOT IN (SELECT number FROM jobs ORDER BY number DESC LIMIT ?)"
            f" AND id NOT IN (SELECT after_job FROM jobs WHERE after_job IS NOT NULL AND state IN ({marks}))"
        )
        values = (before_utc, *_UNFINISHED_STATES, keep, *_UNFINISHED_STATES)
        with self._transaction():
            self._db.execute(f"CREATE TEMP TABLE old AS {old}", values)
            digests = self._db.execute("SELECT digest FROM job_points WHERE job_id IN (SELECT id FROM old)").fetchall()
            for table in ("recordings", "reports", "decisions", "transitions", "job_points", "point_rows", "approvals"):
                self._db.execute(f"DELETE FROM {table} WHERE job_id IN (SELECT id FROM old)")
            count = self._db.execute("DELETE FROM jobs WHERE id IN (SELECT id FROM old)").rowcount
            self._db.execute("DROP TABLE old")
        for digest in {digest for (digest,) in digests} - self.list_named_points():
            self.points.delete_upload(digest)
        return count

    def list_named_points(self) -> set[str]:
        return {digest for (digest,) in self._select_rows("SELECT DISTINCT digest FROM job_points")}

    def store_recording(self, job_id: str, recording: StepRecording) -> None:
        with self._transaction():
            self._db.execute(
                "INSERT OR REPLACE INTO recordings VALUES (?, ?, ?)",
                (job_id, recording.step, recording.model_dump_json()),
            )
            self._db.execute(
                "DELETE FROM recordings WHERE job_id NOT IN (SELECT id FROM jobs ORDER BY number DESC LIMIT ?)",
                (MAX_RECORDED_JOBS,),
            )
            self._db.execute(
                "DELETE FROM recordings WHERE job_id = ? AND step <="
                " (SELECT step FROM recordings WHERE job_id = ? ORDER BY step DESC LIMIT 1 OFFSET ?)",
                (job_id, job_id, MAX_RECORDED_STEPS),
            )

    def load_recording(self, job_id: str, step: int) -> StepRecording | None:
        values = (job_id, step)
        return self._select_body(StepRecording, "SELECT body FROM recordings WHERE job_id = ? AND step = ?", values)

    # Manual control

    def store_reservation(self, holder: str, actor: str, what: str, axes: Iterable[str], until_utc: str) -> None:
        with self._transaction():
            values = (holder, actor, what, " ".join(axes), until_utc)
            self._db.execute("INSERT OR REPLACE INTO reservations VALUES (?, ?, ?, ?, ?)", values)

    def delete_reservation(self, holder: str) -> None:
        with self._transaction():
            self._db.execute("DELETE FROM reservations WHERE holder = ?", (holder,))

    def list_reservations(self) -> list[Reservation]:
        rows = self._select_rows("SELECT holder, actor, what, axes, until_utc FROM reservations ORDER BY rowid")
        return [Reservation(holder, actor, use, tuple(axes.split()), utc) for holder, actor, use, axes, utc in rows]

    # Named positions

    def store_position(self, position: SavedPosition) -> None:
        with self._transaction():
            body = position.model_dump_json()
            self._db.execute(
                "INSERT OR REPLACE INTO positions VALUES (?, ?, ?)", (position.name, body, crc32(body.encode()))
            )

    def delete_position(self, name: str) -> None:
        with self._transaction():
            self._db.execute("DELETE FROM positions WHERE name = ?", (name,))

    def list_positions(self) -> tuple[list[SavedPosition], list[str]]:
        return read_positions(self._select_rows("SELECT name, body, crc FROM positions ORDER BY name"))

    # Inside

    def _select_records(self, clause: str, values: tuple[Any, ...]) -> list[JobRecord]:
        return [make_record(row) for row in self._select_rows(f"SELECT {COLUMNS} FROM jobs {clause}", values)]

    def _select_body(self, model: type[M], query: str, values: tuple[Any, ...]) -> M | None:
        rows = self._select_rows(query, values)
        return read_body(self._path, model, rows[0][0], values[0]) if rows else None

    def _select_rows(self, query: str, values: tuple[Any, ...] = ()) -> list[Any]:
        try:
            return self._db.execute(query, values).fetchall()
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None

    def _read_value(self, key: str, default: str = "") -> str:
        try:
            return self._values.read(key, default)
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None

    def _transaction(self) -> Transaction:
        return Transaction(self._db, self._path)


def require_journal(path: Path) -> None:
    """Raises `JournalError` if a fleet that had a journal has none: its jobs, and what they did, would be forgotten
    without a word."""
    if not path.exists():
        raise JournalError(
            f"{path}: the journal of this fleet is missing",
            "put it back; or begin a new one, without the jobs of before: `tutti up FILE --new-journal`",
        )
