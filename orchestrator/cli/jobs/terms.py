"""Options for a job's place in the queue."""

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any, TypedDict, TypeVar

import click

from orchestrator.cli.base.common import console
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.instants import InstantType
from orchestrator.cli.base.jobs import JobReferenceType, name_jobs
from orchestrator.model.steps.numbers import name_step

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.queue import QueueTerms
    from orchestrator.model.report import QueueEntry

F = TypeVar("F", bound=Callable[..., Any])


class TermsOptions(TypedDict):
    """The values that `terms_options` passes to a command."""

    priority: int
    repeat: int
    after: str | None
    at: datetime | None
    missed: str
    held: bool
    proposed: bool
    now: bool
    expires: float | None


def terms_options(command: F) -> F:
    """Add the options `--priority`, `--repeat`, `--after`, `--at`, `--missed`, `--hold`, `--proposed`, `--now` and
    `--expires`."""
    options = (
        click.option(
            "--priority", default=0, show_default=True, type=click.IntRange(-100, 100), help="Higher ones come first."
        ),
        click.option("--repeat", default=1, show_default=True, type=click.IntRange(1, 10_000), help="Number of runs."),
        click.option(
            "--after",
            default=None,
            metavar="JOB",
            type=JobReferenceType(),
            help="Begin when JOB is done; never if it fails.",
        ),
        click.option("--at", default=None, type=InstantType(), help="Not before this time: RFC 3339, or local time."),
        click.option(
            "--missed",
            default="skip",
            show_default=True,
            type=click.Choice(["run", "skip"]),
            help="What to do if no coordinator leads at that time.",
        ),
        click.option("--hold", "held", is_flag=True, help="Hold it until `tutti job release`."),
        click.option("--proposed", is_flag=True, help="Hold it until its plan is approved: `tutti job approve`."),
        click.option("--now", is_flag=True, help="Refuse it instead of letting it wait: for scripts."),
        click.option(
            "--expires", default=None, type=DurationType(), metavar="DURATION", help="Cancel it if it waits longer: 8h."
        ),
    )
    for option in reversed(options):
        command = option(command)
    return command


def make_terms(options: TermsOptions) -> "QueueTerms":
    """Convert the options to the model of the service."""
    from orchestrator.model.queue import QueueTerms

    at, expires = options["at"], options["expires"]
    end = None if expires is None else datetime.now(UTC) + timedelta(seconds=expires)
    times = {"at": None if at is None else at.isoformat(), "expires": None if end is None else end.isoformat()}
    return QueueTerms.model_validate({**options, **times})


async def resolve_after(tutti: "Tutti", terms: "QueueTerms") -> "QueueTerms":
    """The terms with the id of the job that `--after` means."""
    if terms.after is None:
        return terms
    return terms.model_copy(update={"after": (await tutti.find_job(terms.after)).id})


def print_accepted(entry: "QueueEntry") -> None:
    """Print that a job is queued, and when it begins if it has a time."""
    console.print(f"{name_jobs(entry)} is accepted", highlight=False, markup=False)
    for line in make_entry_lines(entry):
        console.print(f"  {line}", highlight=False, markup=False, soft_wrap=True)
    if entry.note:
        console.print(f"  [bold yellow]note:[/] {entry.note}", highlight=False, soft_wrap=True)


def make_entry_lines(entry: "QueueEntry") -> list[str]:
    """Describe special queue terms of a job, in lines."""
    from orchestrator.model.jobs.restart import RESTART
    from orchestrator.model.queue import APPROVAL
    from orchestrator.monitor.times import format_time, localize_times

    terms = entry.terms
    lines = _list_origins(entry)
    if terms.at is not None:
        consequence = "begins late" if terms.missed == "run" else "is skipped"
        lines.append(f"at {format_time(terms.at)}; {consequence} if no coordinator leads then")
    if terms.after is not None:
        lines.append(f"after job {terms.after}")
    if terms.expires is not None:
        lines.append(f"cancelled if it has not begun at {format_time(terms.expires)}")
    if terms.repeat > 1:
        lines.append(f"{terms.repeat} times")
    if terms.priority:
        lines.append(f"priority {terms.priority}")
    if entry.proposed:
        lines.append("proposed" + (f"; its plan: `tutti job plan {entry.id}`" if entry.state == "queued" else ""))
    if entry.held_by and entry.held_by != RESTART and not (entry.proposed and entry.held_by == APPROVAL):
        lines.append(f"held by {entry.held_by}: `tutti job release {entry.id}`")
    if entry.place is not None:
        lines.append(f"place {entry.place} in the queue: {localize_times(entry.reason)}")
    elif entry.state == "queued" and entry.reason != "submitted":
        lines.append(localize_times(entry.reason))
    return lines


def _list_origins(entry: "QueueEntry") -> list[str]:
    """What job it is the rest of, or runs again."""
    continued_id = entry.terms.continues
    if continued_id is not None:
        return [f"goes on with job {continued_id}, from where it stood"]
    if entry.origin is not None:
        return [f"retries job {entry.origin}, from {name_step(entry.from_step)} on"]
    return []
