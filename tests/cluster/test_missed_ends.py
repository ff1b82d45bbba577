"""A step whose members have all logged their end is done, although the bus was away at that moment."""

import asyncio

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.bus.memory.router import MemoryRouter
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

MOVES = job("[{do: move, to: {gantry.x: 30, stage.u: 12}}, {do: move, to: {gantry.x: 0, stage.u: 0}}]")


async def run_with_hung_router(fleet: VirtualFleet, left_s: float, hangs_s: float) -> JobReport:
    """Run `MOVES`, whose router hangs `left_s` before the end of the first step, for `hangs_s`."""
    assert (await outcome(fleet, PREPARE)).state == "done"
    planned = await outcome(fleet, MOVES)
    longest_s = planned.steps[0].planned_s
    assert planned.state == "done" and longest_s is not None
    client = fleet.make_client()
    moved = len(fleet.controllers["gantry"].commanded_motions)
    job_id = await client.submit(MOVES)
    while len(fleet.controllers["gantry"].commanded_motions) == moved:
        await asyncio.sleep(0.001)
    await asyncio.sleep(longest_s - left_s)
    router = MemoryRouter(fleet.net)
    router.hang()
    await asyncio.sleep(hangs_s)
    router.restart()
    return await client.wait_for_job(job_id)


@pytest.mark.parametrize("hangs_s", [1.0, 2.0, 27.0])
def test_a_step_that_ends_while_the_router_hangs_is_done(hangs_s: float) -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await run_with_hung_router(fleet, 0.2, hangs_s)
        first = report.steps[0]
        assert first.state == "done", first.reason
        assert {evidence.end is not None for m in first.members.values() for evidence in m.evidence.values()} == {True}

    run_fleet(main)


def test_a_step_that_the_adapters_stopped_while_the_router_hung_has_failed() -> None:
    async def main(fleet: VirtualFleet) -> None:
        begun_ns = fleet.clock.now_ns()
        report = await run_with_hung_router(fleet, 1.0, 5.0)
        assert report.steps[0].state == "failed"
        assert fleet.clock.now_ns() - begun_ns < 60 * NS_PER_S

    run_fleet(main)
