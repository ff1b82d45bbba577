"""The journal: what was accepted, decided and done, in SQLite, safe on disk before anybody is told.

`Journal` is synchronous. Live it runs in a thread of its own (`Threaded`), in virtual time inline (`Inline`).
"""

import asyncio
import sqlite3
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple, Protocol, TypeVar

from orchestrator.model.job import Job
from orchestrator.model.report import ENDED, JobReport, JobState, StepRecording, Transition

T = TypeVar("T")
VERSION = 2
RECORDED_JOBS = 100  # the newest; recordings are large, and reports are what lasts

_SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE jobs (
  number INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT UNIQUE NOT NULL,
  client_key TEXT UNIQUE NOT NULL,
  name TEXT NOT NULL,
  actor TEXT NOT NULL,
  body TEXT NOT NULL,
  state TEXT NOT NULL,
  reason TEXT NOT NULL,
  submitted_utc TEXT NOT NULL
) STRICT;
CREATE INDEX jobs_state ON jobs (state);
CREATE TABLE transitions (
  job_id TEXT NOT NULL REFERENCES jobs (id),
  state TEXT NOT NULL, reason TEXT NOT NULL, actor TEXT NOT NULL, utc TEXT NOT NULL, fleet_ns INTEGER
) STRICT;
CREATE INDEX transitions_job ON transitions (job_id);
CREATE TABLE decisions (
  job_id TEXT NOT NULL, step INTEGER NOT NULL, epoch INTEGER NOT NULL, t0_fleet_ns INTEGER NOT NULL,
  members TEXT NOT NULL, utc TEXT NOT NULL
) STRICT;
CREATE TABLE reports (job_id TEXT PRIMARY KEY REFERENCES jobs (id), body TEXT NOT NULL) STRICT;
"""
# What leads from the schema of a version to that of the next; a new journal goes through all of them.
_MIGRATIONS = {
    1: """
CREATE TABLE recordings (
  job_id TEXT NOT NULL REFERENCES jobs (id), step INTEGER NOT NULL, body TEXT NOT NULL,
  PRIMARY KEY (job_id, step)
) STRICT;
"""
}


class JournalError(Exception):
    """The journal can not be used; nothing in it has been changed. Names the file and the remedy."""


class JobRow(NamedTuple):
    """A job as the journal has it."""

    id: str
    name: str
    actor: str
    state: JobState
    reason: str
    submitted_utc: str


class Journal:
    """One fleet's journal. Every method that changes something has committed to disk when it returns."""

    def __init__(self, path: str | Path) -> None:
        """Open or make the journal at `path` (`:memory:` for tests). Raises `JournalError`."""
        self._path = str(path)
        try:
            if self._path != ":memory:":
                Path(path).parent.mkdir(parents=True, exist_ok=True)
            self._db = sqlite3.connect(self._path, isolation_level=None, check_same_thread=False)
            self._db.execute("PRAGMA journal_mode=WAL")
            self._db.execute("PRAGMA synchronous=FULL")
            self._db.execute("PRAGMA foreign_keys=ON")
            version = self._db.execute("PRAGMA user_version").fetchone()[0]
            if version > VERSION:
                raise JournalError(f"{path}: schema {version} is newer than this Tutti's {VERSION}; use a newer Tutti")
            steps = "" if version else _SCHEMA
            steps += "".join(_MIGRATIONS[each] for each in range(max(version, 1), VERSION))
            if steps:
                self._db.executescript(f"BEGIN; {steps} PRAGMA user_version={VERSION}; COMMIT;")
        except (sqlite3.Error, OSError) as error:
            raise JournalError(
                f"{path}: the journal can not be used ({error}); move it aside to begin a new one, or mend it"
            ) from None

    def close(self) -> None:
        self._db.close()

    # Reign

    def take_epoch(self, seen: int) -> int:
        """The next epoch: above the last one here and above `seen`, taken in one transaction."""
        with self._transaction():
            epoch = max(int(self._meta("epoch", "0")), seen) + 1
            self._set_meta("epoch", str(epoch))
        return epoch

    def scale(self, kernel_id: str, now_ns: int, scale_id: str) -> tuple[str, int]:
        """(scale id, origin in host ns): that of the last reign on this kernel, else a new one from `now_ns`."""
        with self._transaction():
            if self._meta("kernel_id", "") == kernel_id:
                return self._meta("scale_id", ""), int(self._meta("origin_host_ns", "0"))
            self._set_meta("kernel_id", kernel_id)
            self._set_meta("scale_id", scale_id)
            self._set_meta("origin_host_ns", str(now_ns))
        return scale_id, now_ns

    # Jobs

    def accept(self, job_id: str, client_key: str, job: Job, utc: str) -> tuple[str, bool]:
        """Take a job: (its id, whether it is new). The same `client_key` gives the job that it gave before."""
        with self._transaction():
            row = self._db.execute("SELECT id FROM jobs WHERE client_key = ?", (client_key,)).fetchone()
            if row is not None:
                return row[0], False
            self._db.execute(
                "INSERT INTO jobs (id, client_key, name, actor, body, state, reason, submitted_utc)"
                " VALUES (?, ?, ?, ?, ?, 'queued', 'submitted', ?)",
                (job_id, client_key, job.name, job.actor, job.model_dump_json(), utc),
            )
            self._db.execute(
                "INSERT INTO transitions VALUES (?, 'queued', 'submitted', ?, ?, NULL)", (job_id, job.actor, utc)
            )
        return job_id, True

    def change(self, job_id: str, transition: Transition, report: JobReport | None = None) -> None:
        """Note a change of a job's state, with its report if it has ended."""
        with self._transaction():
            self._db.execute(
                "INSERT INTO transitions VALUES (?, ?, ?, ?, ?, ?)",
                (
                    job_id,
                    transition.state,
                    transition.reason,
                    transition.actor,
                    transition.utc,
                    transition.fleet_ns,
                ),
            )
            self._db.execute(
                "UPDATE jobs SET state = ?, reason = ? WHERE id = ?", (transition.state, transition.reason, job_id)
            )
            if report is not None:
                self._db.execute("INSERT OR REPLACE INTO reports VALUES (?, ?)", (job_id, report.model_dump_json()))

    def decide(self, job_id: str, step: int, epoch: int, t0_fleet_ns: int, members: str, utc: str) -> None:
        """Note that all members have promised: from here on the step may move."""
        with self._transaction():
            self._db.execute(
                "INSERT INTO decisions VALUES (?, ?, ?, ?, ?, ?)", (job_id, step, epoch, t0_fleet_ns, members, utc)
            )

    def decisions(self, job_id: str) -> list[tuple[int, int]]:
        """(step, T0 in fleet ns) of every decision to move in a job."""
        rows = self._db.execute("SELECT step, t0_fleet_ns FROM decisions WHERE job_id = ? ORDER BY rowid", (job_id,))
        return [(step, t0_fleet_ns) for step, t0_fleet_ns in rows]

    def job(self, job_id: str) -> Job | None:
        row = self._db.execute("SELECT body FROM jobs WHERE id = ?", (job_id,)).fetchone()
        return None if row is None else Job.model_validate_json(row[0])

    def row(self, job_id: str) -> JobRow | None:
        found = self._rows("WHERE id = ?", (job_id,))
        return found[0] if found else None

    def unended(self) -> list[JobRow]:
        """Jobs that are queued or were running, oldest first."""
        marks = ", ".join("?" * len(ENDED))
        return self._rows(f"WHERE state NOT IN ({marks}) ORDER BY number", tuple(sorted(ENDED)))

    def recent(self, limit: int) -> list[JobRow]:
        """The newest jobs, newest first."""
        return self._rows("ORDER BY number DESC LIMIT ?", (limit,))

    def transitions(self, job_id: str) -> list[Transition]:
        rows = self._db.execute(
            "SELECT state, reason, actor, utc, fleet_ns FROM transitions WHERE job_id = ? ORDER BY rowid", (job_id,)
        )
        return [Transition(state=s, reason=r, actor=a, utc=u, fleet_ns=f) for s, r, a, u, f in rows]

    def report(self, job_id: str) -> JobReport | None:
        row = self._db.execute("SELECT body FROM reports WHERE job_id = ?", (job_id,)).fetchone()
        return None if row is None else JobReport.model_validate_json(row[0])

    def record(self, job_id: str, recording: StepRecording) -> None:
        """Keep what a step has done, and let go of what old jobs have."""
        with self._transaction():
            self._db.execute(
                "INSERT OR REPLACE INTO recordings VALUES (?, ?, ?)",
                (job_id, recording.step, recording.model_dump_json()),
            )
            self._db.execute(
                "DELETE FROM recordings WHERE job_id NOT IN (SELECT id FROM jobs ORDER BY number DESC LIMIT ?)",
                (RECORDED_JOBS,),
            )

    def recording(self, job_id: str, step: int) -> StepRecording | None:
        row = self._db.execute("SELECT body FROM recordings WHERE job_id = ? AND step = ?", (job_id, step)).fetchone()
        return None if row is None else StepRecording.model_validate_json(row[0])

    # Inside

    def _rows(self, clause: str, values: tuple[Any, ...]) -> list[JobRow]:
        rows = self._db.execute(f"SELECT id, name, actor, state, reason, submitted_utc FROM jobs {clause}", values)
        return [JobRow(*row) for row in rows]

    def _meta(self, key: str, default: str) -> str:
        row = self._db.execute("SELECT value FROM meta WHERE key = ?", (key,)).fetchone()
        return default if row is None else row[0]

    def _set_meta(self, key: str, value: str) -> None:
        self._db.execute("INSERT OR REPLACE INTO meta VALUES (?, ?)", (key, value))

    def _transaction(self) -> "_Transaction":
        return _Transaction(self._db)


class _Transaction:
    """BEGIN IMMEDIATE … COMMIT, or ROLLBACK on an error."""

    def __init__(self, db: sqlite3.Connection) -> None:
        self._db = db

    def __enter__(self) -> None:
        self._db.execute("BEGIN IMMEDIATE")

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        self._db.execute("COMMIT" if kind is None else "ROLLBACK")


class Runs(Protocol):
    """Where the journal's calls run."""

    async def __call__(self, function: Callable[..., T], *values: Any) -> T: ...


async def inline(function: Callable[..., T], *values: Any) -> T:
    """At once, in virtual time."""
    return function(*values)


class Threaded:
    """In a thread of its own, so that a slow disk does not hold up heartbeats and commands."""

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="journal")

    async def __call__(self, function: Callable[..., T], *values: Any) -> T:
        return await asyncio.get_running_loop().run_in_executor(self._pool, lambda: function(*values))
