"""Looks at a journal without changing it, also while its coordinator runs: what is in it, and what is damaged."""

import json
import re
import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import NamedTuple
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.sqlite.rows import COLUMNS, JOB_COLUMNS, find_checksum, make_record
from orchestrator.coordinator.journal.sqlite.schema import VERSION, list_statements, read_version
from orchestrator.coordinator.journal.sqlite.transaction import (
    DATABASE_ERRORS,
    connect_database,
    make_unusable_error,
    open_read_only,
)
from orchestrator.coordinator.journal.sqlite.values import StoredValues
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

MAX_PROBLEMS = 20  # of SQLite's own check; more are the same again


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
_MOVE_AWAY = "end the fleet, and bring back a backup: `tutti journal import FILE --state DIR --replace`"


def check_journal(path: Path) -> JournalCheck:
    """Check a journal, and the points beside it. Raises `JournalError` if it is none, or of a newer Tutti."""
    try:
        with closing(open_read_only(path)) as file:
            version = read_version(file, str(path))
            damages = _check_pages(file, path.name)
            if damages:
                return JournalCheck(version, None, {}, damages)
            if version == VERSION:
                return _check_records(file, version, damages + _check_points(path))
            # An older schema is read as this Tutti migrates it, in a copy.
            with closing(connect_database(":memory:")) as copy:
                file.backup(copy)
                copy.executescript(list_statements(version))
                return _check_records(copy, version, damages + _check_points(path))
    except DATABASE_ERRORS as error:
        raise make_unusable_error(str(path), error) from None


def _check_pages(db: sqlite3.Connection, name: str) -> list[JournalDamage]:
    """What SQLite finds wrong with a whole file."""
    texts = [problem for (problem,) in db.execute(f"PRAGMA integrity_check({MAX_PROBLEMS})") if problem != "ok"]
    return [JournalDamage(name, problem, _MOVE_AWAY) for problem in texts]


def _check_records(db: sqlite3.Connection, version: int, damages: list[JournalDamage]) -> JournalCheck:
    db.execute("BEGIN")  # all records as they are at one instant
    epoch = _read_epoch(db)
    if epoch is None:
        damages.append(JournalDamage("meta epoch", "it is no number that a coordinator takes", _MOVE_AWAY))
    damages += [*_check_values(db), *_check_jobs(db), *_check_transitions(db), *_check_point_rows(db)]
    for table in _BODIES:
        damages += _check_bodies(db, table)
    jobs = dict(db.execute("SELECT state, count(*) FROM jobs GROUP BY state ORDER BY state").fetchall())
    return JournalCheck(version, epoch, jobs, damages)


def _read_epoch(db: sqlite3.Connection) -> int | None:
    text = StoredValues(db).read("epoch", "0")
    return int(text) if text.isdecimal() and int(text) <= MAX_EPOCH else None


def _check_values(db: sqlite3.Connection) -> Iterator[JournalDamage]:
    rows = db.execute("SELECT key, meta_copies.value, crc, meta.value FROM meta_copies LEFT JOIN meta USING (key)")
    for key, copy, crc, value in rows:
        if crc32(copy.encode()) != crc or copy != value:
            remedy = "nothing is lost: each value is kept twice, and is written anew when it changes"
            yield JournalDamage(f"meta {key}", "the value and its copy differ", remedy)
    stop = StoredValues(db).read("queue_stop")
    if stop and (problem := _find_problem(QueueStop, stop)):
        yield JournalDamage("meta queue_stop", problem, "the queue counts as stopped: `tutti queue start`")


def _check_jobs(db: sqlite3.Connection) -> Iterator[JournalDamage]:
    remedy = "the job is not run, and ends as failed; submit it again"
    for *row, crc in db.execute(f"SELECT {', '.join(JOB_COLUMNS)}, crc FROM jobs ORDER BY number"):
        values: dict[str, object] = dict(zip(JOB_COLUMNS, row, strict=True))
        if crc not in (None, find_checksum(values)):
            yield JournalDamage(f"jobs {values['id']}", "its checksum is wrong", remedy)
        elif problem := _find_problem(Job, str(values["body"])):
            yield JournalDamage(f"jobs {values['id']}", problem, remedy)
    for row in db.execute(f"SELECT {COLUMNS} FROM jobs ORDER BY number"):
        if damage := make_record(row).damage:
            yield JournalDamage(f"jobs {row[0]}", damage, remedy)


def _check_transitions(db: sqlite3.Connection) -> Iterator[JournalDamage]:
    names = ("state", "reason", "actor", "utc", "fleet_ns")
    for row, job_id, *values in db.execute(f"SELECT rowid, job_id, {', '.join(names)} FROM transitions"):
        if problem := _find_problem(JobTransition, json.dumps(dict(zip(names, values, strict=True)))):
            yield JournalDamage(f"transitions {row} of job {job_id}", problem, _LOST)


def _check_point_rows(db: sqlite3.Connection) -> Iterator[JournalDamage]:
    for job_id, step, point, *texts in db.execute(
        "SELECT job_id, step, point, target, measured, flown FROM point_rows"
    ):
        try:
            for text in filter(None, texts):
                json.loads(text)
        except (ValueError, RecursionError):
            yield JournalDamage(f"point_rows {job_id} step {step} point {point}", "its values are no JSON", _LOST)


def _check_bodies(db: sqlite3.Connection, table: _BodyTable) -> Iterator[JournalDamage]:
    crc = "crc" if table.checked else "NULL"
    for key, body, checksum in db.execute(f"SELECT {table.key}, body, {crc} FROM {table.name} ORDER BY rowid"):
        wrong = checksum is not None and crc32(body.encode()) != checksum
        problem = "its checksum is wrong" if wrong else _find_problem(table.model, body)
        if problem:
            yield JournalDamage(f"{table.name} {key}", problem, table.remedy)


def _check_points(journal: Path) -> list[JournalDamage]:
    """What is damaged in the points of scans."""
    path = journal.with_name(f"{journal.name}-points")
    if not path.exists():
        return []
    remedy = "submit the jobs that name these points again, with their points; check the disk"
    try:
        with closing(open_read_only(path)) as db:
            damages = _check_pages(db, path.name)
            if damages:
                return damages
            return [
                JournalDamage(f"points {digest[:15]}… from byte {begin}", "its checksum is wrong", remedy)
                for digest, begin, data, crc in db.execute("SELECT digest, begin, data, crc FROM parts")
                if crc32(data) != crc
            ]
    except DATABASE_ERRORS as error:
        return [JournalDamage(path.name, f"it cannot be read ({error})", remedy)]


def _find_problem(model: type[Model], text: str) -> str:
    """Why a text is not read as this model; empty: it is."""
    try:
        model.read_stored(text)
    except ValidationError as error:
        return re.sub(r"\s+", " ", describe_first_error(error))
    return ""
