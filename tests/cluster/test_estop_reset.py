"""The reset of an e-stop: what still keeps it for adapter hosts that missed it does not bring it back."""

import asyncio

from cluster.worlds import run_fleet

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.messages import EstopReset
from orchestrator.model.state import EstopLatch
from orchestrator.runtime.virtual.fleet import VirtualFleet


async def list_latched(fleet: VirtualFleet) -> list[str]:
    states = await fleet.make_client().status()
    return [name for name, state in states.items() if state.estop is not None]


def test_a_reset_holds_while_slow_disks_store_it_and_the_leader_names_the_e_stop() -> None:
    """A heartbeat comes ten times a second, and saving the reset takes longer."""

    async def main(fleet: VirtualFleet) -> None:
        tutti = fleet.make_client("anna")
        await tutti.estop("a test")
        assert len(await list_latched(fleet)) == 2
        for disk in fleet.host_disks.values():
            disk.draw_delay_ns = lambda: 350 * NS_PER_MS
        assert not any((await tutti.reset()).values())
        await asyncio.sleep(2)
        assert await list_latched(fleet) == []

    run_fleet(main)


def test_an_e_stop_that_is_fetched_late_is_applied_only_where_it_is_missing() -> None:
    """The answer of a process that keeps the latch comes after the reset of one controller."""

    async def main(fleet: VirtualFleet) -> None:
        tutti, latch = fleet.make_client("anna"), EstopLatch(event="old", actor="anna", reason="a test", utc="")
        await tutti.estop("a test")
        (event,) = {state.estop.event for state in (await tutti.status()).values() if state.estop is not None}
        await tutti.reset()
        await asyncio.sleep(0.1)  # those that keep it have released it
        (host,) = fleet.adapter_hosts.values()
        for _, coordinator in fleet.coordinators.values():
            coordinator._latch_keeper.latch = latch.model_copy(update={"event": event})
        await host._fetch_estop(event)
        await asyncio.sleep(1)
        assert await list_latched(fleet) == []
        # One that really is missing it stops, and alone.
        host.supervisors["stage"]._parts.fence._reset_event = ""
        await host._fetch_estop(event)
        await asyncio.sleep(1)
        assert await list_latched(fleet) == ["stage"]
        fleet.net.join_process("user").put(fleet.keys.estop_reset, EstopReset(event=event, actor="anna").to_json())

    run_fleet(main)
