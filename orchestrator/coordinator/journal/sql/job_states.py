"""Changes of a job's state, as several tables of the journal make them; they belong to the caller's transaction."""

from orchestrator.coordinator.journal.sql.database import Database, make_insert
from orchestrator.model.report import JobTransition

_INSERT = make_insert("transitions", ("job_id", "state", "reason", "actor", "utc", "fleet_ns"))


def find_state(db: Database, job_id: str) -> str | None:
    """The state of a job, in the caller's transaction; None: there is no such job. Raises `JournalError`."""
    known_states = db.known_states
    if job_id not in known_states:
        for (state,) in db.select("SELECT state FROM jobs WHERE id = ?", (job_id,)):
            known_states[job_id] = state
    return known_states.get(job_id)


def is_queued(db: Database, job_id: str) -> bool:
    """Whether a job waits in the queue. Raises `JournalError`."""
    return find_state(db, job_id) == "queued"


def insert_transition(db: Database, job_id: str, transition: JobTransition) -> None:
    """Record a transition, and the state and the reason that it leads to. Raises `JournalError`."""
    state, reason = transition.state, transition.reason
    db.write(_INSERT, (job_id, state, reason, transition.actor, transition.utc, transition.fleet_ns))
    db.write("UPDATE jobs SET state = ?, reason = ? WHERE id = ?", (state, reason, job_id))
    db.known_states[job_id] = state
