"""The queue: its order, which jobs may begin, and what each needs exclusively.

The rule: **no job overtakes an earlier one that needs one of its controllers.** From the first in the queue to the
last, a job begins when all controllers that it needs are free of running jobs and manual leases, and no earlier job
waits for one of them. A job whose controllers are free may still have to wait for the world (an e-stop, a permit, a
controller that is off); it keeps its place. Once such a cause is gone, it and those that waited behind it begin only by
a word (`deliberate_starts`). So jobs without a common controller run at the same time, and a job that needs many
controllers is not starved by small ones: what becomes free is kept for it. Jobs that are held, not due, or waiting for
the end of another job block no other job. Manual control has priority: a waiting job does not keep axes from an
operator, nor does one that waits at a step for a person.

A controller is loaded with one step at a time, so jobs need whole controllers, also where axes can be leased
separately.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.restart import READY, RESTART
from orchestrator.model.queue import APPROVAL, WAITS_FOR_APPROVAL

MAX_JOBS_WITHOUT_AXES = 32  # that run at once; jobs with axes are limited by the controllers of the fleet

READY_REASON = f"{READY}: its start has to be asked for, `tutti queue start`"
WITHOUT_AXES_REASON = f"waits for the end of one of the {MAX_JOBS_WITHOUT_AXES} jobs without axes that run"


@dataclass(slots=True)
class WaitingJob:
    """A job in the queue. pending: the job that must be done before it begins, while it is not. deviation: why its
    approval counts no longer; empty: it was not approved yet."""

    row: JobRecord
    job: Job
    pending: str | None = None
    deviation: str = ""

    @property
    def sort_key(self) -> tuple[bool, int, int]:
        """Its place in the queue; the smallest is the first. A job that a person waits for is before all others."""
        return not self.is_attended, -self.row.priority, self.row.place

    @property
    def is_attended(self) -> bool:
        """Whether it belongs to a command that a person waits for."""
        return self.row.session is not None

    @property
    def awaits_approval(self) -> bool:
        """Whether it is held until its plan is approved."""
        return bool(self.row.proposed) and self.row.held_by == APPROVAL

    @property
    def awaits_word(self) -> bool:
        """Whether it had to wait for a cause, or for a job that had to, and its start was not asked for since."""
        return self.row.held_by == RESTART

    @property
    def blocking_reason(self) -> str:
        """Why it would not begin even on free controllers; empty if nothing prevents it."""
        if self.awaits_approval:
            return self.deviation or WAITS_FOR_APPROVAL
        if self.row.held_by and not self.awaits_word:
            return f"held by {self.row.held_by}"
        if self.pending is not None:
            return f"begins when job {self.pending} is done"
        return "" if self.row.due else f"begins at {self.row.at_utc}"


def sort_waiting(waiting: Mapping[str, WaitingJob]) -> list[WaitingJob]:
    """The queue, first job first."""
    return sorted(waiting.values(), key=lambda job: job.sort_key)


@dataclass(slots=True)
class Schedule:
    """The jobs that may begin now, and what each of the others waits for. ready: jobs that may begin only by a word.
    causes: by job that is not marked for that yet, the cause that it waits for, or that a job before it waits for.
    waits_for_world: one waits for a condition outside the queue, which must be looked at again."""

    begin: list[WaitingJob]
    reasons: dict[str, str]
    ready: set[str]
    causes: dict[str, str]
    waits_for_world: bool = False

    def add_job(self, job: WaitingJob, reason: str, cause: str) -> None:
        """Take in what becomes of a job. reason: what it waits for; empty: it begins."""
        if reason:
            self.reasons[job.row.id] = reason
        else:
            self.begin.append(job)
        if reason == READY_REASON:
            self.ready.add(job.row.id)
        if cause and not job.awaits_word:
            self.causes[job.row.id] = cause


class Condition(NamedTuple):
    """What a job on free controllers waits for. asks: once it is gone, the job begins only by a word."""

    text: str
    asks: bool


class QueueLimits(NamedTuple):
    """stopped: why the queue is stopped; empty: it is not. free_places: how many more jobs without axes may run. lent:
    controllers of jobs that wait for a person."""

    stopped: str = ""
    free_places: int = MAX_JOBS_WITHOUT_AXES
    lent: frozenset[str] = frozenset()


UNLIMITED = QueueLimits()


def choose_jobs(
    waiting: Iterable[tuple[WaitingJob, frozenset[str]]],
    busy: Mapping[str, str],
    find_condition: Callable[[WaitingJob], Condition | None] = lambda _: None,
    limits: QueueLimits = UNLIMITED,
) -> Schedule:
    """Choose the jobs of `waiting` that may begin now. waiting: in the queue's order, each with the controllers that
    it needs. busy: by controller, its present user in words. find_condition: returns what a job on free controllers
    still waits for; None: nothing.
    """
    schedule, claims, free_places = Schedule([], {}, set(), {}), _Claims(busy, limits.lent), limits.free_places
    for job, needs in waiting:
        reason = job.blocking_reason or ("" if job.is_attended else limits.stopped)
        if reason:
            schedule.reasons[job.row.id] = reason
            continue
        in_the_way = claims.find_in_the_way(job, needs)
        cause = claims.find_cause(in_the_way)
        if in_the_way:
            reason = f"waits for {in_the_way[0]}: {claims.users[in_the_way[0]]}"
        elif needs or free_places:
            condition = find_condition(job)
            reason, cause = _find_own_cause(job, condition)
            schedule.waits_for_world |= condition is not None
        else:
            reason = WITHOUT_AXES_REASON
        schedule.add_job(job, reason, cause)
        free_places -= not (reason or needs)
        claims.add_claim(job, needs, cause, waits=bool(reason), for_world=bool(reason) and not in_the_way)
    return schedule


class _Claims:
    """What keeps jobs from controllers. users: by controller, its user or the job that waits for it, in words."""

    def __init__(self, busy: Mapping[str, str], lent: frozenset[str]) -> None:
        self.users = dict(busy)
        self._causes: dict[str, str] = {}
        """The cause of a job that keeps its claim."""
        self._of_world = set(lent)
        """Claimed by jobs that wait for the world: a person may be about to change that, and is not kept from it."""

    def find_in_the_way(self, job: WaitingJob, needs: frozenset[str]) -> list[str]:
        """The controllers of `needs` that this job does not get."""
        return sorted(name for name in needs & self.users.keys() if not (job.is_attended and name in self._of_world))

    def find_cause(self, in_the_way: Iterable[str]) -> str:
        """The cause of a job that is in the way; empty: none."""
        return next((self._causes[name] for name in in_the_way if name in self._causes), "")

    def add_claim(self, job: WaitingJob, needs: frozenset[str], cause: str, *, waits: bool, for_world: bool) -> None:
        """The job keeps its claim on the controllers while it waits, or uses them."""
        claim = f"job {job.row.name!r} {job.row.id} of {job.row.actor}" + " comes first" * waits
        if cause:
            self._causes |= dict.fromkeys(needs, cause)
        if for_world:
            self._of_world |= needs - self.users.keys()
        for controller in needs:
            self.users.setdefault(controller, claim)


def _find_own_cause(job: WaitingJob, condition: Condition | None) -> tuple[str, str]:
    """What a job on free controllers waits for, and the cause whose end will not start it; both empty: it begins."""
    if condition is not None:
        return f"waits for: {condition.text}", condition.text if condition.asks or job.awaits_word else ""
    return (READY_REASON, job.row.reason) if job.awaits_word else ("", "")
