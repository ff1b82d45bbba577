"""Arguments that stand for jobs, and jobs in words: the name before the id."""

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click
from click.shell_completion import CompletionItem

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.errors import exit_with_error

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.report import JobReport, QueuedJob

F = TypeVar("F", bound=Callable[..., Any])

MAX_REFERENCE = 120


class JobReferenceType(click.ParamType[str]):
    """The beginning of a job's id, its name, or `last`."""

    name = "job"

    def shell_complete(self, ctx: click.Context, param: click.Parameter, incomplete: str) -> list[CompletionItem]:
        from orchestrator.cli.base.completion import complete_jobs

        return complete_jobs(ctx, param, incomplete)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> str:
        text = str(value)
        if not 0 < len(text) <= MAX_REFERENCE:
            self.fail("write the beginning of a job's id, its name, or `last`", param, ctx)
        return text


def job_argument(command: F) -> F:
    """Add the argument JOB."""
    return click.argument("job", metavar="JOB", type=JobReferenceType())(command)


def jobs_argument(*, required: bool) -> Callable[[F], F]:
    """Add the argument JOBS."""
    return click.argument("jobs", metavar="JOBS...", nargs=-1, required=required, type=JobReferenceType())


def name_jobs(*jobs: "QueuedJob") -> str:
    """Jobs in words: their names, each with its id."""
    return ", ".join(f"job {job.name!r} {job.id}" for job in jobs)


async def load_report(tutti: "Tutti", reference: str) -> "JobReport":
    """The report of a finished job, of several of one name the newest; one that has not ended ends the command. Raises
    `Refusal`."""
    entry = await tutti.find_job(reference, newest=True)
    report = (await tutti.show_job(entry.id)).report
    if report is None:
        exit_with_error(
            f"{name_jobs(entry)} has not ended", FAILED, f"see `tutti job show {entry.id}`", code="not-ended"
        )
    return report
