"""Which jobs may begin: the order of the queue, and what each needs for itself.

The rule: **no job overtakes an earlier one that needs one of its controllers.** From the first in the queue to the
last, a job begins when nobody has a controller that it needs, neither a running job nor a person's hand, and no
earlier job waits for one. So jobs without a controller in common run at the same time, and a job that needs many is
not starved by small ones: what comes free is kept for it. What is held, not due, or waits for the end of another job
is not in anybody's way. People who take axes in hand go first: a waiting job does not keep axes from them.

A controller is loaded with one step at a time, so it is what jobs have for themselves, also where its axes can be
leased one by one.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from orchestrator.coordinator.jobs.steps import expand
from orchestrator.coordinator.journal.journal import JobRow
from orchestrator.model.fleet import Fleet
from orchestrator.model.job import Disable, Enable, Home, Job, Move, SetOutput, SetPosition, Step


@dataclass(slots=True)
class Waiting:
    """A job in the queue. pending: the job that must be done before it begins, while that one is not."""

    row: JobRow
    job: Job
    pending: str | None = None

    @property
    def order(self) -> tuple[int, int]:
        """Its place in the queue; the least is the first."""
        return -self.row.priority, self.row.place

    @property
    def kept_back(self) -> str:
        """Why it does not begin even if nobody is in its way; empty if nothing keeps it back."""
        if self.row.held_by:
            return f"held by {self.row.held_by}"
        if self.pending is not None:
            return f"begins when job {self.pending} is done"
        return "" if self.row.due else f"begins at {self.row.at_utc}"


def in_order(waiting: Mapping[str, Waiting]) -> list[Waiting]:
    """The queue, the first one first."""
    return sorted(waiting.values(), key=lambda each: each.order)


@dataclass(frozen=True, slots=True)
class Choice:
    """What may begin now, and for what each of the others waits."""

    begin: list[Waiting]
    reasons: dict[str, str]


def choose(waiting: Iterable[tuple[Waiting, frozenset[str]]], busy: Mapping[str, str]) -> Choice:
    """Which of `waiting`, in the queue's order and each with the controllers it needs, may begin now.

    busy: by controller, who has it, in words.
    """
    taken = dict(busy)
    begin: list[Waiting] = []
    reasons: dict[str, str] = {}
    for each, needs in waiting:
        why = each.kept_back
        if why:
            reasons[each.row.id] = why
            continue
        # Its claim on what it needs stands while it waits.
        claim = f"job {each.row.id} {each.row.name!r} of {each.row.actor}"
        in_the_way = sorted(needs & taken.keys())
        if in_the_way:
            first = in_the_way[0]
            reasons[each.row.id] = f"waits for {first}: {taken[first]}"
            claim += " comes first"
        else:
            begin.append(each)
        for controller in needs:
            taken.setdefault(controller, claim)
    return Choice(begin, reasons)


def steps_to_run(row: JobRow, job: Job) -> list[Step]:
    """The steps of a job with its repeats, each at its number, those before `from_step` too."""
    return job.steps * row.repeat


def axes_of(fleet: Fleet, steps: Iterable[Step]) -> list[str]:
    """Axes that steps move, switch or rename: those that their job must hold. Raises `UnknownName`."""
    names: list[str] = []
    for step in steps:
        if isinstance(step, Move):
            names += [*step.to, *step.by]
        elif isinstance(step, Home | Enable | Disable):
            names += expand(fleet, step.axes or list(fleet.controllers))
        elif isinstance(step, SetPosition):
            names += step.axes
    return list(dict.fromkeys(names))


def needs_of(fleet: Fleet, steps: list[Step]) -> frozenset[str]:
    """Controllers that no other job may use meanwhile: those of its axes, and those whose outputs start by wire what
    waits for them. Raises `UnknownName`."""
    needs = {axis.partition(".")[0] for axis in axes_of(fleet, steps)}
    for wire in fleet.wiring:
        driver, targets = wire.from_.partition(".")[0], {end.partition(".")[0] for end in wire.to}
        for step in steps:
            by_line = isinstance(step, Move) and targets & {axis.partition(".")[0] for axis in step.to | step.by}
            if by_line or (isinstance(step, SetOutput) and step.output == wire.from_):
                needs.add(driver)
    return frozenset(needs)
