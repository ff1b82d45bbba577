"""Jobs of the fault campaign: one that the fault affects, one that runs at the same time, one that waits for both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from random import Random
from typing import Any

from orchestrator.model.fleet import Fleet, group_by_link
from orchestrator.model.job import Job
from orchestrator.model.queue import QueueTerms

PACE = 0.17  # of the speed limits: no axis reaches its target before the fault
MOST_S = 5.5  # of a move: some seconds more than injecting and detecting the fault takes


@dataclass(frozen=True, slots=True)
class Order:
    """A job to submit, with its queue terms. controllers: those that it moves."""

    job: Job
    terms: QueueTerms
    controllers: tuple[str, ...]


def job_of(name: str, steps: list[dict[str, Any]]) -> Job:
    """Return a job with a loose end skew limit.

    After a failed job an axis may have only a short distance to go while others move for seconds, and its controller
    may not support so low a speed: it may end that much earlier."""
    plain = {"schema": "tutti.job/1", "name": name, "max_start_skew": "150 ms", "max_end_skew": "7 s"}
    return Job.model_validate({**plain, "steps": steps})


def preparation(axes: list[str], homing: list[str]) -> Job:
    """Return a job that enables axes, and homes some of them."""
    steps: list[dict[str, Any]] = [{"do": "enable", "axes": axes}]
    return job_of("prepare", steps + ([{"do": "home", "axes": homing}] if homing else []))


def orders_of(fleet: Fleet, member: str, homes: bool, where: Mapping[str, float], draw: Random) -> list[Order]:
    """Draw two or three jobs; the first one moves `member`, and may home it first. where: position of each axis, in
    its unit."""
    together = [line for line in _inseparable(fleet) if member not in line]
    draw.shuffle(together)
    others = max(1, len(together) - draw.choice((0, 1, 2)))
    main = sorted([*_inseparable_from(fleet, member), *chain(*together[:others])])
    beside = sorted(chain(*together[others:]))
    there = dict(where)
    first: list[dict[str, Any]] = []
    if homes:
        first = [{"do": "home", "axes": [member]}]
        there |= {f"{member}.{axis}": 0.0 for axis in fleet.controllers[member].axes}
    orders = [Order(_moves(fleet, "main", main, there, draw, first), QueueTerms(), tuple(main))]
    if beside:
        terms = QueueTerms(repeat=draw.choice((1, 2)), priority=draw.choice((0, 5)))
        orders.append(Order(_moves(fleet, "beside", beside, there, draw), terms, tuple(beside)))
    late = sorted(chain(*draw.sample(_inseparable(fleet), 2)))
    terms = QueueTerms(priority=draw.choice((-1, 0)))
    orders.append(Order(_moves(fleet, "late", late, there, draw), terms, tuple(late)))
    return orders


def trial(fleet: Fleet, member: str) -> Order:
    """Return a job of the highest priority that homes and moves one controller."""
    targets = {f"{member}.{name}": axis.limits.velocity * PACE for name, axis in fleet.controllers[member].axes.items()}
    steps: list[dict[str, Any]] = [{"do": "enable", "axes": [member]}, {"do": "home", "axes": [member]}]
    job = job_of("try", [*steps, {"do": "move", "to": targets, "speed": PACE}])
    return Order(job, QueueTerms(priority=9), (member,))


def _inseparable(fleet: Fleet) -> list[list[str]]:
    """Group controllers that move in one job or not at all, because one broadcast starts all loaded moves on a link."""
    lines = [line for line in group_by_link(fleet) if fleet.controllers[line[0]].adapter in ("cia402", "smc30")]
    drives = {name for line in lines for name in line}
    return lines + [[name] for name in fleet.controllers if name not in drives]


def _inseparable_from(fleet: Fleet, member: str) -> list[str]:
    return next(names for names in _inseparable(fleet) if member in names)


def _moves(
    fleet: Fleet,
    name: str,
    controllers: list[str],
    there: dict[str, float],
    draw: Random,
    first: Sequence[dict[str, Any]] = (),
) -> Job:
    """Draw a job with a move. there: position of each axis before the move; updated to the position after it. first:
    steps before the move."""
    targets = _targets(fleet, controllers, there, draw)
    there |= targets
    steps: list[dict[str, Any]] = [{"do": "move", "to": targets, "speed": PACE, **_how(fleet, controllers, draw)}]
    if draw.random() < 0.25:
        steps.insert(0, {"do": "dwell", "duration": f"{draw.randrange(300)} ms"})
    return job_of(name, [*first, *steps])


def _targets(fleet: Fleet, controllers: list[str], there: Mapping[str, float], draw: Random) -> dict[str, float]:
    """Draw targets: moves of some seconds to and fro within the soft limits."""
    axes = [f"{name}.{axis}" for name in controllers for axis in fleet.controllers[name].axes]
    targets: dict[str, float] = {}
    for axis in axes:
        reach = fleet.axis(axis).limits.velocity * PACE * MOST_S
        far = there[axis] < 0.5 * reach
        targets[axis] = round(reach * (draw.uniform(0.75, 1.0) if far else draw.uniform(0.0, 0.25)), 2)
    return targets


def _how(fleet: Fleet, controllers: list[str], draw: Random) -> dict[str, Any]:
    """Draw how the move is synchronised and started, among the options that the makes support."""
    drawn = draw.random()
    makes = {fleet.controllers[name].adapter for name in controllers}
    waiting = {each.target for each in fleet.connections} & set(controllers)
    if drawn < 0.15:
        return {"sync": "none"}
    if drawn < 0.3:
        return {"sync": "phase"}
    if drawn < 0.55 and waiting:
        return {"start": "line"}
    if drawn < 0.65 and makes <= {"shrc203", "ppsmc", "smc30"}:
        return {"start": "host"}
    if drawn < 0.75 and makes <= {"smc4000", "smc2000"}:
        return {"start": "clock"}
    if drawn < 0.75 and makes == {"cia402"}:
        return {"start": "sync"}
    return {}


def line_of(fleet: Fleet, member: str) -> list[str]:
    """Return the controllers on the link of `member`, the first one included."""
    return next(names for names in group_by_link(fleet) if member in names)
