"""Circles on several controllers: complete coordinators in virtual time, judged by the simulators' truth.

Each path has a fleet of its own, with crystals of its own that were polled for a while.
"""

import asyncio
from collections.abc import Callable, Iterator
from math import pi
from random import Random
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.runtime.simulated_fleets import DRIFT_PPM, WANDER_PPM, make_cia402, make_smc2000, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

Array = NDArray[np.float64]

RADIUS, SPEED = 50.0, 100.0  # mm, mm/s
CENTRE = 100.0  # of every axis
LOOK_NS = 17 * NS_PER_MS  # beside the periods of records, polls and SYNCs
LIMITS = {"velocity": 200, "acceleration": 1000, "jerk": 20_000}


class CircleCase(NamedTuple):
    """A row: a fleet, and how long its circles last. The first two axes are in the plane of the circle; a third one
    goes up and down with the first, so that the plane is inclined. history_s: of polls before."""

    name: str
    controllers: tuple[str, ...]
    duration_s: float
    history_s: int
    tolerance: str


class CircleRun(NamedTuple):
    """One path. errors: the true distances from it on the way, mm; sum_off: by how much the bound is off the sum of its
    terms; proven: the bound afterwards; worst: its largest term. refused: why it did not run."""

    errors: Array
    bound: float = 0.0
    sum_off: float = 0.0
    proven: float | None = None
    worst: str = ""
    refused: str = ""


class CircleTask(NamedTuple):
    """A path to run. seed: of crystals, links and pauses."""

    case: CircleCase
    seed: int


def run_circle(task: CircleTask) -> CircleRun:
    """Run one path in virtual time."""
    return run_virtual(lambda clock: _run_path(clock, task))


_MAKES: dict[str, Callable[[int], dict[str, Any]]] = {
    "smc4000": make_smc4000,
    "smc2000": make_smc2000,
    "cia402": make_cia402,
}


def make_fleet(case: CircleCase, draw: Random) -> Fleet:
    """The fleet of a row with crystals of its own."""
    controllers: dict[str, Any] = {}
    for number, make in enumerate(case.controllers):
        config: dict[str, Any] = _MAKES[make](number)
        crystal = {
            "offset_s": draw.uniform(0, 600),
            "drift_ppm": draw.uniform(-DRIFT_PPM, DRIFT_PPM),
            "wander_ppm": WANDER_PPM,
        }
        axis = {**config["axes"]["x"], "limits": LIMITS}
        name = f"{make}-{number + 1}"
        controllers[name] = {**config, "axes": {"x": axis}, "simulate": {**config["simulate"], **crystal}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "paths", "controllers": controllers})


def _make_directions(width: int) -> tuple[Array, Array]:
    """Two directions at right angles that span the plane of the circle."""
    first, second = np.zeros(width), np.zeros(width)
    first[0] = second[1] = 1.0
    if width > 2:
        first[2] = 1.0
        first /= np.sqrt(2.0)
    return first, second


def _make_pieces(width: int, duration_s: float) -> tuple[list[float], list[dict[str, Any]]]:
    """(start, half circles) of about that time, from the far end of the first direction on."""
    first, second = _make_directions(width)
    ends = [(CENTRE + RADIUS * sign * first).tolist() for sign in (1, -1)]
    sides = [(CENTRE + RADIUS * sign * second).tolist() for sign in (1, -1)]
    halves = 2 * max(1, round(duration_s * SPEED / (2 * pi * RADIUS)))
    pieces = [{"piece": "arc", "through": sides[k % 2], "to": ends[(k + 1) % 2]} for k in range(halves)]
    return ends[0], pieces


async def _run_path(clock: VirtualClock, task: CircleTask) -> CircleRun:
    case, draw = task.case, Random(f"{task.case.name} {task.seed}")
    fleet = VirtualFleet(make_fleet(case, draw), clock, task.seed, guardian=False)
    await fleet.start()
    axes = [f"{name}.x" for name in fleet.fleet.controllers]
    start, pieces = _make_pieces(len(axes), case.duration_s)
    to = dict(zip(axes, start, strict=True))
    enable = {"do": "enable", "axes": list(fleet.fleet.controllers)}
    await _run_job(fleet, [enable, {"do": "home"}, {"do": "move", "to": to}])
    await sleep_ns(clock, case.history_s * NS_PER_S + draw.randrange(NS_PER_S))
    path = {"do": "path", "axes": axes, "start": start, "pieces": pieces, "speed": f"{SPEED} mm/s"}
    positions: list[list[float]] = []
    watching = asyncio.get_running_loop().create_task(_watch_truth(fleet, positions, draw))
    try:
        report = await _run_job(fleet, [{**path, "tolerance": case.tolerance}])
    except Refusal as refusal:
        return CircleRun(np.zeros(0), refused=f"{refusal.code}: {refusal}")
    finally:
        watching.cancel()
    step = report.steps[0].path
    assert step is not None and step.bound is not None
    bound = step.bound
    off = abs(bound.predicted - sum(term.size for term in bound.terms))
    worst = f"{bound.largest.name} of {bound.largest.member}" if bound.largest.member else bound.largest.name
    return CircleRun(_measure_errors(np.array(positions)), bound.predicted, off, bound.proven, worst)


def _measure_errors(seen: Array) -> Array:
    """The distances of positions (instants, axes) from the circle, mm."""
    first, second = _make_directions(seen.shape[1])
    off = seen - CENTRE
    x, y = off @ first, off @ second
    height = np.linalg.norm(off - np.outer(x, first) - np.outer(y, second), axis=1)
    return np.hypot(np.hypot(x, y) - RADIUS, height)


async def _watch_truth(fleet: VirtualFleet, seen: list[list[float]], draw: Random) -> None:
    """Record the true positions of all axes, mm, while any of them moves."""
    units = [
        (controller, fleet.fleet.controllers[name].axes["x"].motors[0])
        for name, controller in fleet.controllers.items()
    ]
    while True:
        await sleep_ns(fleet.clock, LOOK_NS + draw.randrange(NS_PER_MS))
        if any(unit.is_moving(motor) for unit, motor in units):
            seen.append([unit.position(motor) / 1000 for unit, motor in units])


async def _run_job(fleet: VirtualFleet, steps: list[dict[str, Any]]) -> JobReport:
    job = Job.model_validate({"schema": "tutti.job/1", "name": "paths", "max_start_skew": "20 ms", "steps": steps})
    client = fleet.make_client("paths")
    try:
        report = await client.wait_for_job(await client.submit(job), poll_s=0.5)
    finally:
        await client.close()
    refusal = next((step.refused for step in report.steps if step.refused is not None), None)
    if refusal is not None:
        raise Refusal(refusal.code, refusal.text, refusal.remedy)
    if report.state != "done":
        raise Refusal("failed", report.reason)
    return report


def list_tasks(case: CircleCase, paths: int, seed: int) -> Iterator[CircleTask]:
    """The paths of a row."""
    for number in range(paths):
        yield CircleTask(case, seed * 1000 + number)
