"""A second coordinator on the same journal: it takes over when the first one dies or hangs, and continues the queue."""

import pytest
from cluster.worlds import MOVE, PREPARE, job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.runtime.virtual.fleet import VirtualFleet

THEN = job("[{do: move, to: {gantry.x: 20, stage.u: 2}}]")
TAKE_OVER_NS = 2 * NS_PER_S


@pytest.mark.parametrize("how", ["kill", "freeze"])
def test_the_standby_takes_over_within_two_seconds_and_keeps_the_queue(how: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        fleet.start_coordinator("second", standby=True)
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        running, queued = await client.submit(MOVE), await client.submit(THEN)
        await sleep_ns(fleet.clock, 4 * NS_PER_S)
        assert not fleet.coordinators["second"][1].leadership.epoch
        getattr(fleet, how)("coordinator/first")
        lost_ns = fleet.clock.now_ns()
        second = fleet.coordinators["second"][1].leadership
        await fleet.wait_until(lambda states: all(each.epoch == second.epoch > 0 for each in states.values()))
        assert fleet.clock.now_ns() - lost_ns < TAKE_OVER_NS
        assert (await client.wait_for_job(running)).state == "interrupted"
        # A step was interrupted, which the axes have noticed: nothing begins until an operator starts the queue.
        await sleep_ns(fleet.clock, 10 * NS_PER_S)
        assert (await client.list_jobs(state="queued")).waiting == 1
        await client.start_queue()
        assert (await client.wait_for_job(queued)).state == "done"
        assert fleet.controllers["gantry"].position("X") == 20_000
        # A coordinator that wakes later detects that it is no longer the leader, and does nothing.
        assert not fleet.coordinators["first"][0].alive

    run_fleet(main)


def test_a_standby_continues_the_queue_by_itself_when_no_axis_has_noticed_the_change() -> None:
    async def main(fleet: VirtualFleet) -> None:
        fleet.start_coordinator("second", standby=True)
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        _, holder = await client.reserve_axes(["gantry"], 3600.0)
        queued = await client.submit(THEN)
        await sleep_ns(fleet.clock, NS_PER_S)
        fleet.kill("coordinator/first")
        second = fleet.coordinators["second"][1].leadership
        await fleet.wait_until(lambda states: all(each.epoch == second.epoch > 0 for each in states.values()))
        await client.release_axes(holder)
        assert (await client.wait_for_job(queued)).state == "done"

    run_fleet(main)


def test_the_standby_stays_passive_while_the_leader_lives() -> None:
    async def main(fleet: VirtualFleet) -> None:
        fleet.start_coordinator("second", standby=True)
        assert (await outcome(fleet, PREPARE, THEN)).state == "done"
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        assert not fleet.coordinators["second"][1].leadership.epoch
        states = await fleet.make_client().status()
        assert {each.epoch for each in states.values()} == {fleet.coordinators["first"][1].leadership.epoch}

    run_fleet(main)
