"""The speed of a fleet in virtual time."""

import time
from typing import NamedTuple

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.units import parse_quantity
from orchestrator.runtime.virtual.fleet import VirtualFleet


class VirtualRun(NamedTuple):
    """fleet_s: time that passed in the fleet; cpu_s: processor time of this machine; moves: steps that moved."""

    fleet_s: float
    cpu_s: float
    moves: int
    speedup: float


def bench_virtual(fleet: Fleet, hours: float, seed: int = 1) -> VirtualRun:
    """Move all axes of `fleet` to and fro between the quarters of their soft limits for `hours` of fleet time."""
    began_s = time.process_time()
    fleet_s, moves = run_virtual(lambda clock: _run_fleet(fleet, clock, hours, seed))
    cpu_s = time.process_time() - began_s
    return VirtualRun(round(fleet_s, 1), round(cpu_s, 2), moves, round(fleet_s / cpu_s, 1))


async def _run_fleet(fleet: Fleet, clock: VirtualClock, hours: float, seed: int) -> tuple[float, int]:
    virtual = VirtualFleet(fleet, clock, seed)
    await virtual.start()
    client = virtual.make_client()
    controllers = list(fleet.controllers)
    steps: list[dict[str, object]] = [{"do": "enable", "axes": controllers}, {"do": "home"}]
    await _run_job(client, "prepare", steps)
    moves, end_ns = 0, clock.now_ns() + round(hours * 3600 * NS_PER_S)
    first_move, second_move = (_make_move(fleet, share) for share in (0.75, 0.25))
    while clock.now_ns() < end_ns:
        await _run_job(client, "to and fro", [first_move, second_move] * 25)
        moves += 50
    return clock.now_ns() / NS_PER_S, moves


async def _run_job(client: Tutti, name: str, steps: list[dict[str, object]]) -> None:
    job = Job.model_validate({"schema": "tutti.job/1", "name": name, "steps": steps})
    report = await client.wait_for_job(await client.submit(job), poll_s=60.0)
    if report.state != "done":
        raise RuntimeError(f"the benchmark's job {name!r} is {report.state}: {report.reason}")


def _make_move(fleet: Fleet, share: float) -> dict[str, object]:
    """Return a move of every axis with soft limits to a share of its range."""
    targets: dict[str, float] = {}
    for name in fleet.axis_names:
        axis = fleet.axis(name)
        if axis.soft_limits is not None:
            low, high = (parse_quantity(end, axis.unit) for end in (axis.soft_limits.min, axis.soft_limits.max))
            targets[name] = float(low + (high - low) * parse_quantity(share, axis.unit))
    return {"do": "move", "to": targets, "speed": 0.5}
