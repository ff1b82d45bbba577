"""Looks at the records of a journal without changing them: what is in it, and what is damaged."""

import json
import re
from collections.abc import Iterator
from typing import NamedTuple
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.records import BRING_BACK
from orchestrator.coordinator.journal.sql.database import Database
from orchestrator.coordinator.journal.sql.rows import COLUMNS, JOB_COLUMNS, find_checksum, make_record
from orchestrator.coordinator.journal.sql.values import StoredValues
from orchestrator.model.base import Model
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import MAX_EPOCH
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.approval import JobApproval
from orchestrator.model.operation.learned import LearnedTimes
from orchestrator.model.positions.entries import SavedPosition
from orchestrator.model.problems import describe_first_error
from orchestrator.model.queue import QueueStop
from orchestrator.model.report import JobReport, JobTransition, StepRecording


class JournalDamage(NamedTuple):
    """Something in a journal that cannot be read. place: table and row."""

    place: str
    problem: str
    remedy: str


class JournalCheck(NamedTuple):
    """What a journal contains. epoch: None if it is damaged. jobs: their number by state."""

    schema: int
    epoch: int | None
    jobs: dict[str, int]
    damages: list[JournalDamage]


class _BodyTable(NamedTuple):
    """A table with a JSON text in each row, perhaps with a checksum of it."""

    name: str
    key: str
    model: type[Model]
    remedy: str
    checked: bool = True


_AGAIN = "it comes again while its condition holds"
_LOST = "the rest of the journal can be used; if a backup has it: `tutti journal import`"
_BODIES = (
    _BodyTable("reports", "job_id", JobReport, _LOST, checked=False),
    _BodyTable("recordings", "job_id || ' step ' || step", StepRecording, _LOST, checked=False),
    _BodyTable("approvals", "job_id", JobApproval, "approve its plan again: `tutti job approve`"),
    _BodyTable("positions", "name", SavedPosition, "save it again: `tutti position save`"),
    _BodyTable("alarms", "id", AlarmRecord, _AGAIN),
    _BodyTable("learned", "controller", LearnedTimes, "nothing is needed: it is learned again"),
    _BodyTable("alarm_notices", "change", AlarmRecord, _AGAIN),
    _BodyTable("alarm_history", "number", AlarmRecord, _LOST, checked=False),
)
POINTS_AGAIN = "submit the jobs that name these points again, with their points; check the disk"


def check_records(db: Database, version: int, damages: list[JournalDamage]) -> JournalCheck:
    """Check all records, in the caller's transaction. damages: those that were found besides. Raises `JournalError`."""
    epoch = _read_epoch(db)
    if epoch is None:
        damages.append(JournalDamage("meta epoch", "it is no number that a coordinator takes", BRING_BACK))
    damages += [*_check_values(db), *_check_jobs(db), *_check_transitions(db), *_check_point_rows(db)]
    for table in _BODIES:
        damages += _check_bodies(db, table)
    jobs = dict(db.select("SELECT state, count(*) FROM jobs GROUP BY state ORDER BY state"))
    return JournalCheck(version, epoch, jobs, damages)


def _read_epoch(db: Database) -> int | None:
    text = StoredValues(db).read("epoch", "0")
    return int(text) if text.isdecimal() and int(text) <= MAX_EPOCH else None


def _check_values(db: Database) -> Iterator[JournalDamage]:
    rows = db.stream("SELECT key, meta_copies.value, crc, meta.value FROM meta_copies LEFT JOIN meta USING (key)")
    for key, copy, crc, value in rows:
        if crc32(copy.encode()) != crc or copy != value:
            remedy = "nothing is lost: each value is kept twice, and is written anew when it changes"
            yield JournalDamage(f"meta {key}", "the value and its copy differ", remedy)
    stop = StoredValues(db).read("queue_stop")
    if stop and (problem := _find_problem(QueueStop, stop)):
        yield JournalDamage("meta queue_stop", problem, "the queue counts as stopped: `tutti queue start`")


def _check_jobs(db: Database) -> Iterator[JournalDamage]:
    remedy = "the job is not run, and ends as failed; submit it again"
    for *row, crc in db.stream(f"SELECT {', '.join(JOB_COLUMNS)}, crc FROM jobs ORDER BY number"):
        values: dict[str, object] = dict(zip(JOB_COLUMNS, row, strict=True))
        if crc not in (None, find_checksum(values)):
            yield JournalDamage(f"jobs {values['id']}", "its checksum is wrong", remedy)
        elif problem := _find_problem(Job, str(values["body"])):
            yield JournalDamage(f"jobs {values['id']}", problem, remedy)
    for row in db.stream(f"SELECT {COLUMNS} FROM jobs ORDER BY number"):
        if damage := make_record(row).damage:
            yield JournalDamage(f"jobs {row[0]}", damage, remedy)


def _check_transitions(db: Database) -> Iterator[JournalDamage]:
    names = ("state", "reason", "actor", "utc", "fleet_ns")
    for row, job_id, *values in db.stream(f"SELECT rowid, job_id, {', '.join(names)} FROM transitions"):
        if problem := _find_problem(JobTransition, json.dumps(dict(zip(names, values, strict=True)))):
            yield JournalDamage(f"transitions {row} of job {job_id}", problem, _LOST)


def _check_point_rows(db: Database) -> Iterator[JournalDamage]:
    for job_id, step, point, *texts in db.stream("SELECT job_id, step, point, target, measured, flown FROM point_rows"):
        try:
            for text in filter(None, texts):
                json.loads(text)
        except (ValueError, RecursionError):
            yield JournalDamage(f"point_rows {job_id} step {step} point {point}", "its values are no JSON", _LOST)


def _check_bodies(db: Database, table: _BodyTable) -> Iterator[JournalDamage]:
    crc = "crc" if table.checked else "NULL"
    for key, body, checksum in db.stream(f"SELECT {table.key}, body, {crc} FROM {table.name} ORDER BY 1"):
        wrong = checksum is not None and crc32(body.encode()) != checksum
        problem = "its checksum is wrong" if wrong else _find_problem(table.model, body)
        if problem:
            yield JournalDamage(f"{table.name} {key}", problem, table.remedy)


def check_parts(db: Database) -> Iterator[JournalDamage]:
    """What is damaged in the points of scans."""
    for digest, begin, data, crc in db.stream("SELECT digest, begin, data, crc FROM parts"):
        if crc32(data) != crc:
            yield JournalDamage(f"points {digest[:15]}… from byte {begin}", "its checksum is wrong", POINTS_AGAIN)


def _find_problem(model: type[Model], text: str) -> str:
    """Why a text is not read as this model; empty: it is."""
    try:
        model.read_stored(text)
    except ValidationError as error:
        return re.sub(r"\s+", " ", describe_first_error(error))
    return ""
