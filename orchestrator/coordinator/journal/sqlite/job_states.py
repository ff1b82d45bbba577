"""Changes of a job's state, as several tables of the journal make them; they belong to the caller's transaction."""

import sqlite3

from orchestrator.model.report import JobTransition


def is_queued(db: sqlite3.Connection, job_id: str) -> bool:
    """Whether a job waits in the queue. Raises `sqlite3.Error`."""
    return db.execute("SELECT state FROM jobs WHERE id = ?", (job_id,)).fetchone() == ("queued",)


def insert_transition(db: sqlite3.Connection, job_id: str, transition: JobTransition) -> None:
    """Record a transition, and the state and the reason that it leads to. Raises `sqlite3.Error`."""
    state, reason = transition.state, transition.reason
    values = (job_id, state, reason, transition.actor, transition.utc, transition.fleet_ns)
    db.execute("INSERT INTO transitions VALUES (?, ?, ?, ?, ?, ?)", values)
    db.execute("UPDATE jobs SET state = ?, reason = ? WHERE id = ?", (state, reason, job_id))
