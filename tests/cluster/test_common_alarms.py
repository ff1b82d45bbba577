"""A host of many controllers that is lost: one alarm and one notice, in the whole fleet with its coordinator."""

import asyncio

from cluster.test_alarms import QUICK, Commands, states

from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

LOST = "many-disconnected-h1"


def test_a_lost_host_is_one_alarm_with_one_notice_that_clears_when_it_returns() -> None:
    plain = make_light_fleet(24, 3).to_plain() | {"alarms": QUICK, "notify": {"command": ["page"]}}

    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(Fleet.model_validate(plain), clock, 1, guardian=False)
        pages = Commands(fleet)
        await fleet.start()
        fleet.kill("host/h1")
        await asyncio.sleep(8.0)
        assert await states(fleet) == {LOST: "unacknowledged"}
        assert pages.alarms == [LOST]
        (alarm,) = await fleet.make_client().list_alarms()
        assert alarm.text.startswith("offline: all 8 controllers of host h1 (c10, c11, c12 and 5 more); the first: c")
        await fleet.make_client().acknowledge_alarms(LOST)
        # Another leader goes on with it.
        fleet.kill("coordinator/first")
        await asyncio.sleep(1.0)
        fleet.start_coordinator("first")
        await asyncio.sleep(8.0)
        assert await states(fleet) == {LOST: "acknowledged"}
        fleet.start_host("h1")
        await asyncio.sleep(6.0)
        assert await states(fleet) == {} and pages.alarms == [LOST]
        history = await fleet.make_client().list_alarm_history()
        assert len(history) <= 4 and {record.id for record in history} == {LOST}

    run_virtual(main)
