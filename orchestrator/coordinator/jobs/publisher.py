"""What the bus shows of the queue: lists of jobs, and for what each one waits."""

import asyncio
from collections.abc import Iterable, Mapping, Sequence

from orchestrator.bus.base import Priority
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.coordinator.jobs.job_run import JobRun, Works
from orchestrator.coordinator.jobs.queue import Waiting, in_order
from orchestrator.coordinator.journal.journal import JobRow
from orchestrator.model.report import ENDED, JobState, Progress, QueueEntry, QueueState

SHOWN = 200  # entries of the queue on the bus: what is behind them waits for long
SOON_NS = NS_PER_MS  # first it is decided what becomes of a job that has just come
QUIET_NS = 50 * NS_PER_MS  # between two puts of the queue, however fast jobs come


class Board:
    """Shows the jobs that wait and run."""

    def __init__(self, works: Works, waiting: Mapping[str, Waiting], running: Mapping[str, JobRun]) -> None:
        self._works = works
        self._waiting = waiting
        self._running = running
        self._places: Mapping[str, int] = {}
        self._reasons: Mapping[str, str] = {}
        self._told: dict[str, str] = {}
        self._changed = False
        self._announcing: asyncio.Task[None] | None = None

    def close(self) -> None:
        if self._announcing is not None:
            self._announcing.cancel()

    def entries(self, rows: Iterable[JobRow]) -> list[QueueEntry]:
        """Jobs as a list shows them: with what only the present coordinator knows of those that wait."""
        return [self.entry(row) for row in rows]

    def entry(self, row: JobRow) -> QueueEntry:
        """A job as a list shows it. It has its place as soon as it was decided that it waits."""
        run, waiting = self._running.get(row.id), self._waiting.get(row.id)
        if waiting is not None:
            row = waiting.row
        return QueueEntry(
            id=row.id,
            name=row.name,
            actor=row.actor,
            state=run.state if run is not None and row.state not in ENDED else row.state,
            reason=row.reason if waiting is None else self._reasons.get(row.id, row.reason),
            submitted_utc=row.submitted_utc,
            place=None if waiting is None else self._places.get(row.id),
            terms=row.terms,
            held_by=row.held_by,
            origin=row.origin,
            from_step=row.from_step,
        )

    def announce(self) -> None:
        """Put the queue on the bus: soon after a quiet time, else when one has passed."""
        self._changed = True
        if self._announcing is None or self._announcing.done():
            self._announcing = asyncio.get_running_loop().create_task(self._announce())

    async def _announce(self) -> None:
        await sleep_ns(self._works.clock, SOON_NS)
        while self._changed:
            self._changed = False
            rows = [run.row for run in self._running.values()]
            rows += [each.row for each in in_order(self._waiting)[:SHOWN]]
            total = len(self._running) + len(self._waiting)
            state = QueueState(total=total, jobs=self.entries(rows[:SHOWN]))
            self._works.bus.put(self._works.keys.queue, state.to_json(), Priority.EVENT)
            await sleep_ns(self._works.clock, QUIET_NS)

    def decided(self, order: Sequence[Waiting], reasons: Mapping[str, str]) -> None:
        """Take over for what each job waits, in the queue's order; say it of those that are shown, if it is new."""
        self._places = {each.row.id: place for place, each in enumerate(order, 1)}
        self._reasons = reasons
        told: dict[str, str] = {}
        for each in order[:SHOWN]:
            row = each.row
            reason = told[row.id] = reasons.get(row.id, row.reason)
            if self._told.get(row.id) != reason:
                steps = len(each.job.steps) * row.repeat
                progress = queued_progress(row, "queued", reason, self._works.clock.utc(), steps)
                self._works.bus.put(self._works.keys.job_state(row.id), progress.to_json(), Priority.STATE)
        self._told = told


def queued_progress(row: JobRow, state: JobState, reason: str, utc: str, steps: int) -> Progress:
    """A job that does not run, as it stands."""
    return Progress(
        job_id=row.id,
        name=row.name,
        actor=row.actor,
        state=state,
        step=row.from_step,
        steps=steps,
        step_name="",
        fraction=row.from_step / steps,
        remaining_s=None,
        reason=reason,
        utc=utc,
    )
