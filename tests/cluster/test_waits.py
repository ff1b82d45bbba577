"""What waits for something ends when that is gone: the table in `docs/explanation/failures.md`."""

# pyright: reportPrivateUsage=false

import asyncio
from typing import Any

import pytest
from cluster.test_operating import narrowed
from cluster.worlds import demo_fleet, run_fleet

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.fleet.lease_states import LeaseUser
from orchestrator.coordinator.fleet.leases import GIVE_BACK_NS, AxesInUse, LeaseRegistry
from orchestrator.coordinator.maintenance.reload import RECONNECT_S
from orchestrator.model.errors import Refusal
from orchestrator.runtime.virtual.fleet import VirtualFleet

BRIEF, OTHER = LeaseUser("brief", "anna", "enabling"), LeaseUser("other", "ben", "a job")
AXES = ["gantry.x"]


def in_leader(fleet: VirtualFleet, act: Any) -> "asyncio.Task[Any]":
    """A task in the process of the leader."""
    process, coordinator = fleet.coordinators["first"]
    return process.start_task(act(coordinator._leases))


def test_a_lease_that_is_not_given_back_is_waited_for_for_ten_seconds() -> None:
    async def main(fleet: VirtualFleet) -> None:
        async def acquire(leases: LeaseRegistry) -> None:
            await leases.acquire(BRIEF, AXES, brief=True)
            begun_ns = fleet.clock.now_ns()
            with pytest.raises(AxesInUse, match="in use by anna"):
                await leases.acquire(OTHER, AXES)
            assert GIVE_BACK_NS <= fleet.clock.now_ns() - begun_ns < GIVE_BACK_NS + NS_PER_S
            await leases.release("brief")
            await leases.acquire(OTHER, AXES)

        await in_leader(fleet, acquire)

    run_fleet(main)


def test_a_release_that_is_cancelled_gives_the_axes_back() -> None:
    async def main(fleet: VirtualFleet) -> None:
        async def acquire(leases: LeaseRegistry) -> None:
            await leases.acquire(BRIEF, AXES)
            fleet.freeze("host/local")
            releasing = asyncio.get_running_loop().create_task(leases.release("brief"))
            await asyncio.sleep(0.5)
            releasing.cancel()
            await asyncio.wait([releasing])
            assert leases.find_conflict(AXES) is None

        await in_leader(fleet, acquire)

    run_fleet(main)


@pytest.mark.parametrize(("gone", "reason"), [("sim/gantry", "within 10 s: "), ("host/local", "does not answer")])
def test_a_reload_waits_ten_seconds_for_a_controller_that_does_not_come_back(gone: str, reason: str) -> None:
    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(demo_fleet(), clock, 1, guardian=False)
        await fleet.start()
        client, lines = fleet.make_client(), len(fleet.lines)
        reload = asyncio.get_running_loop().create_task(client.reload_fleet(narrowed(demo_fleet(), 100)))
        while not any("another configuration" in line for line in fleet.lines[lines:]):
            await asyncio.sleep(0.001)
        fleet.freeze(gone)
        begun_ns = fleet.clock.now_ns()
        with pytest.raises(Refusal, match=f"gantry has its new configuration, but is not back .*{reason}"):
            await reload
        assert fleet.clock.now_ns() - begun_ns < (RECONNECT_S + 1) * NS_PER_S

    run_virtual(main)
