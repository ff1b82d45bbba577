"""A job that was checked, as it passes from one process to another."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, Self

from orchestrator.model.jobs.files import FileProblem
from orchestrator.model.jobs.forecast import StepProblem
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.parts import dump_long, split_value

MAX_DRAWN_HERE = 200  # steps; more take a second


@dataclass(frozen=True, slots=True)
class CheckedJob:
    """What a check has found. plain: the fields of its answer that are ready. job: the JSON of what would be submitted.

    whole: what is forecast, in parts; empty: there are mistakes. steps: its written ones. is_long: to draw it takes
    long."""

    plain: Mapping[str, Any]
    job: bytes = b"null"
    whole: Sequence[bytes] = field(default=())
    steps: int = 0
    is_long: bool = False

    @classmethod
    def of(cls, job: Job, plain: Mapping[str, Any] | None = None, whole: Job | None = None) -> Self:
        """Of a job without mistakes. whole: what is forecast, if that is another one."""
        forecast_job = whole or job
        parts = split_value(forecast_job)
        steps = forecast_job.steps
        is_long = len(steps) > MAX_DRAWN_HERE or any(s.plans_long for step in steps for s in step.iterate_written())
        return cls(plain or {}, dump_long(job), parts, len(steps), is_long)


class CheckedSource(Protocol):
    """What a job is made of. It passes to another process if it is large."""

    @property
    def size(self) -> int:
        """Characters."""
        ...

    def check(self) -> CheckedJob:
        """The job, or mistakes. Raises `Refusal`."""
        ...

    def locate(self, problems: Sequence[StepProblem]) -> list[FileProblem]:
        """Problems of the forecast, at their places in the source."""
        ...
