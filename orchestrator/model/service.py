"""What users ask of the reigning coordinator, on `svc/{verb}`, and its answers."""

from typing import Any, Literal

from pydantic import Field

from orchestrator.model.job import Job
from orchestrator.model.messages import Reply, Request
from orchestrator.model.report import JobReport, QueueEntry, Transition


class Submit(Request):
    """Take a job. The same `client_key` again gives the same job back."""

    job: Job
    client_key: str
    dry_run: bool = False


class Submitted(Reply):
    job_id: str = ""
    dry_run: dict[str, Any] | None = None


class JobRef(Request):
    job_id: str


class JobShown(Reply):
    """Everything the journal has of a job; `report` once it has ended."""

    entry: QueueEntry | None = None
    job: Job | None = None
    report: JobReport | None = None
    transitions: list[Transition] = Field(default=[])


class ListJobs(Request):
    limit: int = Field(default=50, ge=1, le=10_000)


class StopFleet(Request):
    """Stop the running job, all its axes."""

    mode: Literal["decelerate", "abort"] = "decelerate"
