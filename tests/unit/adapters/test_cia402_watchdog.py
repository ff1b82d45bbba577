"""A drive that watches this computer stops by itself when that is gone."""

import pytest
from unit.adapters.cia402_bench import Drives, run

from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault

WATCHING = {"watchdog_ms": 200}


@pytest.mark.parametrize("watching", [False, True])
def test_drives_with_a_watchdog_stop_when_the_host_dies(watching: bool) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=200_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 1000 * NS_PER_MS)
        assert not (await world.driver.poll()).faults
        world.wire.links[0].hang_up()
        with pytest.raises(LinkClosed):
            await world.driver.slots.present.wait_for_end()
        await world.rest(400)
        assert world.unit.at_rest() == watching
        if watching:
            assert world.unit.position("1") < 100_000
            await world.driver.close()
            await world.driver.connect()
            await world.driver.configure()
            assert not (await world.driver.poll()).axes["a"].enabled
            await world.driver.set_enabled(["a"], on=True)
            assert (await world.driver.poll()).axes["a"].enabled

    run(main, options=WATCHING if watching else {})


def test_a_host_that_disconnects_does_not_trip_the_watchdog() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=100_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 500 * NS_PER_MS)
        await world.driver.close()
        await world.rest(4000)
        assert world.unit.position("1") == 100_000

    run(main, options=WATCHING)


def test_a_power_cycled_drive_gets_its_watchdog_again() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        world.unit.set_power(on=False)
        await world.rest(100)
        world.unit.set_power(on=True)
        await world.rest(500)
        assert (await world.driver.poll()).restarted
        assert int(await world.driver.send_raw("1016:1/32")) == 127 << 16 | 200

    run(main, options=WATCHING)


def test_a_drive_without_a_heartbeat_consumer_is_named() -> None:
    async def main(world: Drives) -> None:
        with pytest.raises(ControllerFault, match="1016h") as caught:
            await world.driver.connect()
        assert caught.value.code == "config-mismatch"
        assert caught.value.remedy

    run(main, options=WATCHING, simulate={"without": ["1016"]})


def test_a_drive_with_the_number_of_this_computer_is_refused() -> None:
    async def main(world: Drives) -> None:
        with pytest.raises(ControllerFault, match="node number 2") as caught:
            await world.driver.connect()
        assert "host_node" in caught.value.remedy

    run(main, count=2, options={**WATCHING, "host_node": 2})
