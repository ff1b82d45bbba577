"""What the campaign has found, each by itself: faults that once stopped too little, too late, or too much."""

import asyncio

from cluster.worlds import MOVE, PREPARE, changed, demo_fleet, job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_S
from orchestrator.lab.virtual import VirtualFleet
from orchestrator.model.fleet import Fleet

GANTRY = job("[{do: move, to: {gantry.x: 300}, speed: 0.15}]")  # ten seconds
STAGE = job("[{do: move, to: {stage.u: 12}, speed: 0.15}]")
BACK = job("[{do: move, to: {gantry.x: 200}, speed: 1}]")
RAMP_S = 0.2


def two_hosts() -> Fleet:
    return changed(demo_fleet(), stage={"host": "right"})


def now_s(fleet: VirtualFleet) -> float:
    return fleet.clock.now_ns() / NS_PER_S


def gantry_end_s(fleet: VirtualFleet) -> float:
    """When the gantry has come to rest last."""
    end_ns = fleet.controllers["gantry"].motions[-1].end_ns
    assert end_ns is not None
    return end_ns / NS_PER_S


def test_a_host_that_can_not_be_reached_does_not_end_the_leases_on_others() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.client()
        far, near = await client.submit(STAGE), await client.submit(GANTRY)
        await asyncio.sleep(1.5)
        fleet.net.partition({fleet.process("host/right").name}, {fleet.process("coordinator/first").name})
        assert (await client.wait(near)).state == "done"
        fleet.net.heal()
        assert (await client.wait(far)).state != "done"

    run_fleet(main, two_hosts())


def test_others_stop_when_an_adapter_dies_and_is_back_before_anybody_misses_it() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.client()
        job_id = await client.submit(MOVE)
        await asyncio.sleep(3.0)
        fleet.kill("host/right")
        killed_s = now_s(fleet)
        report = await client.wait(job_id)
        assert report.state == "failed" and "stage: its adapter" in report.reason
        await asyncio.sleep(1.0)
        assert gantry_end_s(fleet) < killed_s + 1.0 + RAMP_S

    run_fleet(main, two_hosts())


def test_a_job_waits_for_the_ramp_of_the_one_before() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.client()
        first = await client.submit(GANTRY)
        second = await client.submit(BACK)
        await asyncio.sleep(3.0)
        await client.cancel(first)
        assert (await client.wait(first)).state == "cancelled"
        report = await client.wait(second)
        assert report.state == "done", report.reason

    run_fleet(main)


def test_a_stop_that_a_hung_controller_has_not_taken_is_given_again_when_it_is_back() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.client()
        job_id = await client.submit(GANTRY)
        await asyncio.sleep(2.0)
        fleet.freeze("sim/gantry")
        await asyncio.sleep(0.1)
        await client.stop()
        await asyncio.sleep(3.0)
        assert (await client.status())["gantry"].mode == "offline"
        fleet.resume("sim/gantry")
        resumed_s = now_s(fleet)
        await fleet.until(lambda states: states["gantry"].mode == "idle")
        assert (await client.wait(job_id)).state != "done"
        assert fleet.controllers["gantry"].at_rest()
        assert gantry_end_s(fleet) < resumed_s + 6.0  # its link is tried every five seconds

    run_fleet(main)


def test_a_fleet_that_is_polled_seldom_is_not_taken_for_dead() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, PREPARE, MOVE)
        assert report.state == "done", report.reason

    rates = {"state": {"idle_hz": 0.5, "moving_hz": 3.0}}
    run_fleet(main, changed(demo_fleet(), gantry=rates, stage=rates))
