"""The queue in words, and lists of jobs as tables."""

from collections.abc import Iterable

from rich.console import Group, RenderableType
from rich.text import Text

from orchestrator.model.jobs.restart import StartPreview
from orchestrator.model.report import QueueEntry, QueueState
from orchestrator.monitor.tables import make_plain_table
from orchestrator.monitor.times import format_time, localize_times


def describe_queue(state: QueueState) -> str:
    """Whether jobs begin and how many wait: one line."""
    jobs = "1 job waits" if state.waiting == 1 else f"{state.waiting} jobs wait"
    if state.journal is not None:
        jobs += f"; journal: {state.journal}"
    if state.stopped is None:
        return f"the queue is running; {jobs}"
    stop_time = format_time(state.stopped.utc)
    return f"the queue is stopped since {stop_time} ({state.stopped.reason}); {jobs}: tutti queue start"


def describe_start(preview: StartPreview) -> list[str]:
    """What would move first, and what a cause still keeps from it: a line for each job."""
    lines = [
        # What was to be done about the cause is done.
        f"{motion.name!r} {motion.job_id} begins with {motion.text}"
        + f" (it waited: {motion.cause.partition('; ')[0]})" * bool(motion.cause)
        for motion in preview.motions
    ]
    lines += [f"{motion.name!r} {motion.job_id} still waits for: {motion.cause}" for motion in preview.lasting]
    return lines


def make_job_table(jobs: Iterable[QueueEntry]) -> RenderableType:
    """Build a table with a row for each job, and below it its reason: at 80 columns the other cells leave no room for
    a sentence. #: the place of a waiting job in the queue."""
    table = make_plain_table(["name", "job", "actor", "#>", "state", "submitted"], shrinking=("name", "actor"))
    for entry in jobs:
        rank = "" if entry.place is None else str(entry.place)
        # Text of users: one row each, whatever line breaks or markup it contains.
        name, actor = (
            Text(" ".join(words.split()), no_wrap=True, overflow="ellipsis") for words in (entry.name, entry.actor)
        )
        table.add_row(name, entry.id, actor, rank, entry.state, format_time(entry.submitted_utc))
        if entry.reason:
            table.add_note(localize_times(entry.reason))
    return table


def make_queue_table(state: QueueState) -> RenderableType:
    """Build the table of a list of jobs, with what keeps the queue from going on."""
    lines = [Text(describe_queue(state))] if state.stopped is not None else []
    return Group(make_job_table(state.jobs), *lines)
