"""An adapter host that is slow to start: what jobs and alarms say of its controllers."""

import asyncio

import pytest
from cluster.test_faults import two_hosts
from cluster.worlds import job

from orchestrator.client.api import Tutti
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import Reply, ResetRequest
from orchestrator.runtime.virtual.fleet import VirtualFleet


async def collect_refusals(client: Tutti) -> list[Refusal]:
    """The refusals of two requests to its adapter, and of two to the coordinator, which asks the adapter."""
    refusals: list[Refusal] = []
    for request in (
        client.controller_info("stage"),
        client.request_controller("stage", "reset", ResetRequest(**client.request_fields()), Reply),
        client.send_raw("stage", "Q:", i_know=True),
        client.reserve_axes(["stage"], 60),
    ):
        with pytest.raises(Refusal) as caught:
            await request
        refusals.append(caught.value)
    return refusals


async def describe_wait(client: Tutti, job_id: str) -> str:
    await asyncio.sleep(2.0)
    (entry,) = [entry for entry in (await client.list_jobs()).jobs if entry.id == job_id]
    return entry.reason


def test_controllers_of_a_host_that_starts_slowly_are_said_to_be_so() -> None:
    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(two_hosts(), clock, 1, guardian=False)
        await fleet.start()
        client, guardian = fleet.make_client(), fleet.net.join_process("guardian")
        fleet.kill("host/right")
        await asyncio.sleep(2.0)
        job_id = await client.submit(job("[{do: enable, axes: [stage]}]"))
        assert "stage: its adapter does not answer" in await describe_wait(client, job_id)
        assert not any("starting slowly" in refusal.text for refusal in await collect_refusals(client))
        token = await guardian.announce(fleet.keys.slow_start("right"))
        assert "stage: its adapter is starting slowly (10 s)" in await describe_wait(client, job_id)
        refusals = await collect_refusals(client)
        for refusal in refusals[:2]:
            assert refusal.text == "no adapter answers for controller stage; starting slowly: host right"
            assert refusal.remedy.startswith("wait, if the controller is on that host")
        for refusal in refusals[2:]:
            assert refusal.text == "stage: its adapter is starting slowly (10 s)"
            assert refusal.remedy.startswith("wait")
        await asyncio.sleep(30.0)
        assert "stage: its adapter is starting slowly (40 s); wait" in await describe_wait(client, job_id)
        assert any("starting slowly" in alarm.text for alarm in await client.list_alarms())
        await token.undeclare()
        assert "stage: its adapter does not answer" in await describe_wait(client, job_id)
        await guardian.announce(fleet.keys.slow_start("right"))
        fleet.start_host("right")
        await asyncio.sleep(2.0)
        assert "starting slowly" not in await describe_wait(client, job_id)

    run_virtual(main)
