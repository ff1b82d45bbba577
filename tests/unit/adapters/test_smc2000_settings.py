"""Settings of the SMC-2000 that another client changes: found before each step and at rest, and repaired by a reset."""

import asyncio

import pytest
from unit.adapters.settings_at_rest import find_at_rest
from unit.adapters.test_smc2000_bench import ChainWorld, World, run, run_chain

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import ControllerFault

TURNS = 300  # checks at rest that cover every part of the settings and of the program


async def change(world: World, *commands: str) -> None:
    """Change settings as another client would, by a raw command."""
    for command in commands:
        assert "?" not in await world.driver.send_raw(command)


CHANGES = [  # commands of another client, setting, its value then and before, whether it is read before each step
    (("GA X", "GRY=0.5"), "GRY of axis y", "0.5", "0", True),
    (("ITX=0.02",), "ITX of axis x", "0.0195", "1", True),
    (("KPX=20",), "KPX of axis x", "20", "6", False),
    (("KDY=3.5",), "KDY of axis y", "3.5", "64", False),
    (("ERX=100",), "ERX of axis x", "100", "16384", False),
    (("BLY=-7",), "BLY of axis y", "-7", "-2147483648", False),
]


def test_changed_settings_are_found_and_a_reset_writes_them_again():
    """All at once: none hides another."""

    async def main(world: World) -> None:
        await world.ready(5)
        for commands, *_ in CHANGES:
            await change(world, *commands)
        before = await world.driver.check_settings(everything=True)
        assert sorted(each.item for each in before) == sorted(item for _, item, _, _, at_arm in CHANGES if at_arm)
        differences = (await find_at_rest(world.driver, TURNS)).values()
        assert sorted((each.item, each.found, each.expected) for each in differences) == sorted(
            (item, found, expected) for _, item, found, expected, _ in CHANGES
        )
        await world.driver.clear_faults()
        assert not await world.driver.check_settings(everything=True)
        assert not await find_at_rest(world.driver, TURNS)

    run(main)


def test_another_sample_period_is_left_to_a_person():
    async def main(world: World) -> None:
        await world.ready(5)
        await change(world, "TM 500")
        (difference,) = await world.driver.check_settings(everything=True)
        assert (difference.item, difference.found, difference.repairable) == ("TM", "500", False)

    run(main)


def test_a_cam_found_when_configuring_is_refused():
    async def main(world: World) -> None:
        await world.ready()
        await change(world, "EA X", "EM 1000,100", "EP 10,0", "EB 1")
        with pytest.raises(ControllerFault, match="cam mode"):
            await world.driver.configure()

    run(main)


def test_a_check_at_rest_takes_a_few_hundredths_of_a_second_on_the_line():
    async def main(world: World) -> None:
        await world.ready(5)
        longest_ns = 0
        for _ in range(20):
            began_ns = world.clock.now_ns()
            await world.driver.check_settings(everything=False)
            longest_ns = max(longest_ns, world.clock.now_ns() - began_ns)
        assert longest_ns < 80 * NS_PER_MS

    run(main)


def test_a_stop_does_not_wait_for_a_check():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_enabled(["x"], on=True)
        await change(world, "JGX=5000", "BGX")
        check = asyncio.ensure_future(world.driver.check_settings(everything=True))
        await sleep_ns(world.clock, 5 * NS_PER_MS)
        await world.driver.stop(abort=True)
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert world.controller.at_rest()
        assert not await check

    run(main)


def test_checks_of_the_controllers_of_a_chain_find_their_own_settings():
    async def main(world: ChainWorld) -> None:
        await world.ready(5)
        await world.drivers[1].send_raw("ITX=0.5")
        found = await asyncio.gather(*(each.check_settings(everything=True) for each in world.drivers.values()))
        assert [[each.item for each in one] for one in found] == [[], ["ITX of axis x"], []]

    run_chain(main)


def test_a_zero_that_is_redefined_shows_as_a_jump_of_both_counts():
    async def main(world: World) -> None:
        await world.ready()
        before = (await world.driver.poll()).axes["x"]
        await change(world, "DPX=50000")
        after = (await world.driver.poll()).axes["x"]
        assert (before.commanded_counts, after.commanded_counts, after.actual_counts) == (0, 50_000, 50_000)
        assert not after.moving

    run(main)
