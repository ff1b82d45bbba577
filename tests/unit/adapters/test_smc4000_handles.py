"""Ethernet handles of the SMC-4000 after lost connections: those of the adapter are closed, those of others are not."""

from typing import Any

import pytest
from unit.adapters.test_smc4000_bench import FLEET, World, run

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.link.base import LinkRefused

OTHER_HOST = -1062731510


def occupied(world: World) -> list[str]:
    controller: Any = world.controller
    return sorted(controller.machine.ports.handles)


async def pull_cable(world: World) -> None:
    """A cable pull: the adapter gives up its links, and nothing of that gets through."""
    world.wire.cut = world.wire.refuse = world.wire.lose_close = True
    await world.driver.close()
    await sleep_ns(world.clock, NS_PER_S)
    world.wire.cut = world.wire.refuse = world.wire.lose_close = False


@pytest.mark.parametrize("kind", ["tcp", "udp"])
def test_twelve_cable_pulls_leave_no_handle_occupied(kind: str):
    async def main(world: World) -> None:
        for _ in range(12):
            await world.driver.connect()
            assert len(occupied(world)) == 2
            await pull_cable(world)
        await world.driver.connect()
        await world.driver.configure()
        assert len(occupied(world)) == 2

    run(main, fleet=FLEET | {"link": FLEET["link"] | {"kind": kind}})


def test_handles_of_other_clients_stay_open_whether_on_this_host_or_on_another():
    async def main(world: World) -> None:
        controller: Any = world.controller
        same = await world.wire.open_link()
        controller.machine.ports.host_address, host = OTHER_HOST, controller.machine.ports.host_address
        other = await world.wire.open_link()
        controller.machine.ports.host_address = host
        for _ in range(3):
            await world.driver.connect()
            await pull_cable(world)
        await world.driver.connect()
        assert len(occupied(world)) == 4
        for link in (same, other):
            link.write(b"MG 7{F1.0}\r")
            assert (await link.read()).data == b" 7\r\n:"

    run(main)


def test_connections_of_a_computer_that_lost_power_are_closed_when_handles_run_short():
    async def main(world: World) -> None:
        controller: Any = world.controller
        controller.machine.ports.host_address, host = OTHER_HOST, controller.machine.ports.host_address
        other = await world.wire.open_link()
        controller.machine.ports.host_address = host
        for _ in range(3):
            # Each process knows only its own connection.
            await world.other().connect()
        assert len(occupied(world)) == 7
        await world.driver.connect()
        assert len(occupied(world)) == 3
        assert other in world.wire.links
        await world.driver.poll()

    run(main)


def test_the_handles_of_another_adapter_process_stay_open_while_enough_are_free():
    async def main(world: World) -> None:
        first, second = world.other(), world.other()
        await first.connect()
        await second.connect()
        assert len(occupied(world)) == 4
        await first.poll()
        await second.poll()
        with pytest.raises(LinkRefused):
            for _ in range(8):
                await world.wire.open_link()

    run(main)
