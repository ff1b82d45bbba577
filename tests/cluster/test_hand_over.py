"""Hand-over to a standby: at rest, without a stop of the queue, and refused where something would be interrupted."""

import asyncio

import pytest
from cluster.worlds import MOVE, PREPARE, job, outcome, run_fleet

from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import HandedOver
from orchestrator.model.messages import Request
from orchestrator.runtime.virtual.fleet import VirtualFleet


async def hand_over(fleet: VirtualFleet) -> HandedOver:
    client = fleet.make_client()
    return await client.request_service("hand-over", Request(**client.request_fields()), HandedOver)


async def refuse(fleet: VirtualFleet) -> str:
    with pytest.raises(Refusal) as refused:
        await hand_over(fleet)
    assert refused.value.remedy
    return refused.value.code


def test_the_queue_goes_on_and_axes_stay_referenced() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        fleet.start_coordinator("second", standby=True)
        await asyncio.sleep(1.0)
        first = fleet.coordinators["first"][1]
        reply = await hand_over(fleet)
        assert reply.standbys == ["second"]
        # Accepted meanwhile, begun by the next leader.
        submitted = await client.submit(job("[{do: move, to: {gantry.x: 3 mm}}]"))
        await first.handed_over.wait()
        assert not first.scheduler.register.running
        await first.close()
        fleet.kill("coordinator/first")
        report = await client.wait_for_job(submitted)
        assert (report.state, report.epoch) == ("done", 2)
        assert (await client.list_jobs()).stopped is None
        states = await client.status()
        assert all(axis.referenced for axis in states["gantry"].axes.values())

    run_fleet(main)


def test_it_is_refused_without_a_standby_in_motion_and_in_use() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        assert await refuse(fleet) == "no-standby"
        second = fleet.start_coordinator("second", standby=True)
        await asyncio.sleep(1.0)
        client = fleet.make_client()
        submitted = await client.submit(MOVE)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        assert await refuse(fleet) == "busy"
        await client.stop()
        await client.wait_for_job(submitted)
        async with client.manual_control(["gantry.x"]):
            assert await refuse(fleet) == "leased"
        second.kill()
        await asyncio.sleep(1.0)
        assert await refuse(fleet) == "no-standby"
        # Nothing has changed: it leads on.
        await client.start_queue()
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 3 mm}}]"))).state == "done"

    run_fleet(main)
