"""Rows of the table of jobs, read one by one: a damaged one is shown as a failed job; the others are not affected."""

import re
from collections.abc import Mapping, Sequence
from typing import Any, TypeVar, get_args
from zlib import crc32

from pydantic import ValidationError

from orchestrator.coordinator.journal.records import UNREADABLE_TIME, DamagedRecord, JobRecord
from orchestrator.model.base import ID_PATTERN, Model
from orchestrator.model.problems import first_error_text
from orchestrator.model.queue import QueueTerms, parse_utc
from orchestrator.model.report import JobState
from orchestrator.model.script import WrongValue
from orchestrator.model.text.outside_text import show_text

M = TypeVar("M", bound=Model)

COLUMNS = (
    "id, name, actor, state, reason, submitted_utc, priority, place, repeat, after_job, at_utc, missed, due, held_by,"
    " origin, from_step, expires_utc, now, session, proposed, continues"
)


FIND_KEY = "SELECT id, actor, submitted_utc, request_digest FROM jobs WHERE client_key IN (?, ?)"
CHECKED_COLUMNS = (
    "id",
    "client_key",
    "name",
    "actor",
    "body",
    "submitted_utc",
    "repeat",
    "after_job",
    "at_utc",
    "missed",
    "origin",
    "from_step",
    "expires_utc",
    "now",
    "session",
)
"""What never changes of a job, besides `LATER_COLUMNS`."""

LATER_COLUMNS = ("proposed", "continues")
"""The same, of columns that older journals did not have: they count where they are set."""

JOB_COLUMNS = (*CHECKED_COLUMNS, *LATER_COLUMNS)
SELECT_JOB = f"SELECT {', '.join(JOB_COLUMNS)}, crc FROM jobs WHERE id = ?"
BODY = JOB_COLUMNS.index("body")
"""Place of the body in a row of `SELECT_JOB`."""


def is_whole(row: Sequence[Any]) -> bool:
    """Whether a row of `SELECT_JOB` is as it was stored."""
    *values, crc = row
    return crc in (None, find_checksum(dict(zip(JOB_COLUMNS, values, strict=True))))


def make_damaged_error(journal: str, what: str, job_id: str, problem: str) -> DamagedRecord:
    """The error for a part of a job that cannot be read. journal: what messages name it by."""
    text = f"{journal}: {what} of job {job_id} cannot be read: {problem}"
    return DamagedRecord(text, "it is damaged, or was written by another version of Tutti")


def read_body(journal: str, model: type[M], body: str, job_id: str) -> M:
    """A part of a job by its JSON. Raises `DamagedRecord`."""
    try:
        return model.read_stored(body)
    except ValidationError as error:
        raise make_damaged_error(journal, f"the {model.__name__}", job_id, first_error_text(error)) from None


def scope_key(owner: str, client_key: str) -> str:
    """A client's key as it is stored: behind its owner, from schema 11 on. No key has a line break, so none of an older
    journal looks like that."""
    return f"{owner}\n{client_key}"


def list_term_values(terms: QueueTerms) -> dict[str, Any]:
    """The values of terms, by column, but for the originator of a hold."""
    return {
        "priority": terms.priority,
        "repeat": terms.repeat,
        "after_job": terms.after,
        "at_utc": terms.at,
        "missed": terms.missed,
        "due": int(terms.at is None),
        "expires_utc": terms.expires,
        "now": int(terms.now),
        "session": terms.session,
        "proposed": int(terms.proposed),
        "continues": terms.continues,
    }


def find_checksum(values: Mapping[str, Any]) -> int:
    """Return the checksum of a job by the values of its columns."""
    checked_values = [values[column] for column in CHECKED_COLUMNS]
    # Jobs of journals that had no such column have checksums without it.
    checked_values += ["proposed"] if values["proposed"] else []
    checked_values += ["continues", values["continues"]] if values["continues"] else []
    return crc32(repr(checked_values).encode())


def make_record(row: Sequence[Any]) -> JobRecord:
    """Make the record of a row of `COLUMNS`; damaged values are replaced, and stated in `damage`."""
    record = JobRecord(*row)._replace(due=bool(row[12]))
    damage = _find_damage(record)
    name, actor, reason = map(show_text, (str(record.name), str(record.actor), str(record.reason)))
    record = record._replace(name=name, actor=actor, reason=reason)
    if not damage:
        return record
    readable = not _is_unreadable_time(record.submitted_utc)
    reason = f"its record in the journal is damaged: {damage}"
    return JobRecord(
        id=record.id,
        name=record.name,
        actor=record.actor,
        state="failed",
        reason=reason,
        submitted_utc=record.submitted_utc if readable else UNREADABLE_TIME,
        priority=0,
        place=record.place,
        repeat=1,
        after=None,
        at_utc=None,
        missed="skip",
        due=True,
        held_by="",
        origin=None,
        from_step=0,
        damage=reason,
    )


def _find_damage(record: JobRecord) -> str:
    """What cannot be read of a record; empty if all can."""
    if not re.match(ID_PATTERN, record.id):
        return f"the id {record.id!r}"
    if record.state not in get_args(JobState):
        return f"the state {record.state!r}"
    if _is_unreadable_time(record.submitted_utc):
        return f"the time {record.submitted_utc!r}"
    try:
        _ = record.terms
    except WrongValue as error:
        problem = error.problems[0]
        return f"{problem.field} {problem.found!r}"
    return ""


def _is_unreadable_time(text: str) -> bool:
    try:
        parse_utc(text)
    except ValueError:
        return True
    return False
