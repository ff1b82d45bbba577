"""Jobs and the queue for the stream. Each is made plain once for each of its changes, however often it is shown."""

from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.gateway.stream.merge_patch import drop_nulls
from orchestrator.model.report import FINISHED_STATES, JobProgress, QueueState

MAX_JOBS = 300
KEEP_ENDED_NS = 60 * NS_PER_S  # of a job that has ended


class JobTable:
    """The jobs that run, or have ended a short time ago."""

    def __init__(self) -> None:
        self._jobs: dict[str, JobProgress] = {}
        self._plain: dict[str, dict[str, Any]] = {}
        self._ended_ns: dict[str, int] = {}
        self._queue: dict[str, Any] = {}

    def __contains__(self, job_id: str) -> bool:
        return job_id in self._jobs

    def take_progress(self, progress: JobProgress, now_ns: int) -> bool:
        """Store a job's progress; return whether it was new."""
        job_id = progress.job_id
        if not progress.follows(self._jobs.get(job_id)):
            return False
        if progress.state in FINISHED_STATES:
            self._ended_ns[job_id] = now_ns
        self._jobs[job_id] = progress
        self._plain[job_id] = drop_nulls(progress.to_plain())
        if len(self._jobs) > MAX_JOBS:
            self._forget(next(iter(self._jobs)))
        return True

    def show(self, now_ns: int) -> dict[str, Any]:
        """The jobs by their ids."""
        for job_id in [ended_id for ended_id, ended_ns in self._ended_ns.items() if now_ns - ended_ns > KEEP_ENDED_NS]:
            self._forget(job_id)
        return dict(self._plain)

    def _forget(self, job_id: str) -> None:
        self._jobs.pop(job_id, None)
        self._plain.pop(job_id, None)
        self._ended_ns.pop(job_id, None)

    @property
    def has_queue(self) -> bool:
        """Whether the queue is known."""
        return bool(self._queue)

    def take_queue(self, queue: QueueState) -> None:
        """Store the queue."""
        plain = queue.to_plain()
        self._queue = {"permits": plain.pop("missing_permits"), "queue": drop_nulls(plain)}

    def show_queue(self) -> dict[str, Any]:
        """`queue` and `permits`; empty as long as they are not known."""
        return self._queue
