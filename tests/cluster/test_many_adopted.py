"""Adoption of many controllers: what it costs on the bus."""

from collections import Counter

from orchestrator.bus.memory.traffic import BusTraffic
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

REQUESTS_A_HOST = 3  # for the information of its controllers, their adoption, and all states after a gap
OTHER_REQUESTS = 8  # of a new coordinator: for latches, epochs, all states, the servers of all controllers


def test_adoption_takes_as_many_requests_as_there_are_hosts() -> None:
    async def main(clock: VirtualClock) -> None:
        virtual = VirtualFleet(make_light_fleet(60, 3), clock, 1, guardian=False)
        await virtual.start()
        virtual.kill("coordinator/first")
        await sleep_ns(clock, NS_PER_S)
        traffic = virtual.net.traffic = BusTraffic()
        virtual.start_coordinator("second")
        await virtual.wait_until(lambda states: all(state.epoch == 2 for state in states.values()))
        assert len(virtual.fleet.controllers) == 60
        asked = Counter({name: count for (name, kind), count in traffic.by_kind.items() if kind == "request"})
        (requests,) = (count for name, count in asked.items() if name.startswith("coordinator-"))
        assert requests <= REQUESTS_A_HOST * 3 + OTHER_REQUESTS, asked

    run_virtual(main)
