"""Jobs of the fault campaign: one that takes part in what breaks, one beside it, one that has to wait for them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from random import Random
from typing import Any

from orchestrator.model.fleet import Fleet, by_line
from orchestrator.model.job import Job
from orchestrator.model.queue import Terms

PACE = 0.17  # of the speed limits: nobody is there by chance before a fault comes
MOST_S = 5.5  # of a move: some seconds more than it takes to break it and to notice


@dataclass(frozen=True, slots=True)
class Order:
    """A job to submit, and its place in the queue. controllers: that it moves."""

    job: Job
    terms: Terms
    controllers: tuple[str, ...]


def job_of(name: str, steps: list[dict[str, Any]]) -> Job:
    """Where a job before it has failed, an axis may have some steps to go beside others that move for seconds, and its
    unit may not be able to go so slowly: it may end as much earlier."""
    plain = {"schema": "tutti.job/1", "name": name, "max_start_skew": "150 ms", "max_end_skew": "7 s"}
    return Job.model_validate({**plain, "steps": steps})


def preparation(axes: list[str], homing: list[str]) -> Job:
    """Enable axes, and home some of them."""
    steps: list[dict[str, Any]] = [{"do": "enable", "axes": axes}]
    return job_of("prepare", steps + ([{"do": "home", "axes": homing}] if homing else []))


def orders_of(fleet: Fleet, member: str, homes: bool, where: Mapping[str, float], draw: Random) -> list[Order]:
    """Two or three jobs; the first one moves `member`, and may home it before. where: each axis stands, in its unit."""
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
    orders = [Order(_moves(fleet, "main", main, there, draw, first), Terms(), tuple(main))]
    if beside:
        terms = Terms(repeat=draw.choice((1, 2)), priority=draw.choice((0, 5)))
        orders.append(Order(_moves(fleet, "beside", beside, there, draw), terms, tuple(beside)))
    late = sorted(chain(*draw.sample(_inseparable(fleet), 2)))
    terms = Terms(priority=draw.choice((-1, 0)))
    orders.append(Order(_moves(fleet, "late", late, there, draw), terms, tuple(late)))
    return orders


def trial(fleet: Fleet, member: str) -> Order:
    """Home a controller and move it, before everybody else."""
    targets = {f"{member}.{name}": axis.limits.velocity * PACE for name, axis in fleet.controllers[member].axes.items()}
    steps: list[dict[str, Any]] = [{"do": "enable", "axes": [member]}, {"do": "home", "axes": [member]}]
    job = job_of("try", [*steps, {"do": "move", "to": targets, "speed": PACE}])
    return Order(job, Terms(priority=9), (member,))


def _inseparable(fleet: Fleet) -> list[list[str]]:
    """Controllers that move in one job or not at all, because one write starts all of a line that are loaded."""
    lines = [line for line in by_line(fleet) if fleet.controllers[line[0]].adapter in ("cia402", "smc30")]
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
    """there: where each axis will stand before it moves, and afterwards. first: steps before that."""
    targets = _targets(fleet, controllers, there, draw)
    there |= targets
    steps: list[dict[str, Any]] = [{"do": "move", "to": targets, "speed": PACE, **_how(fleet, controllers, draw)}]
    if draw.random() < 0.25:
        steps.insert(0, {"do": "dwell", "duration": f"{draw.randrange(300)} ms"})
    return job_of(name, [*first, *steps])


def _targets(fleet: Fleet, controllers: list[str], there: Mapping[str, float], draw: Random) -> dict[str, float]:
    """Where axes are to go: some seconds to and fro within their soft limits."""
    axes = [f"{name}.{axis}" for name in controllers for axis in fleet.controllers[name].axes]
    targets: dict[str, float] = {}
    for axis in axes:
        reach = fleet.axis(axis).limits.velocity * PACE * MOST_S
        far = there[axis] < 0.5 * reach
        targets[axis] = round(reach * (draw.uniform(0.75, 1.0) if far else draw.uniform(0.0, 0.25)), 2)
    return targets


def _how(fleet: Fleet, controllers: list[str], draw: Random) -> dict[str, Any]:
    """How the move is synchronised and started; what a make can not do is not asked for."""
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
    """The controllers on the line of `member`, the host's first."""
    return next(names for names in by_line(fleet) if member in names)
