"""What the adapter of Galil controllers concludes, on both families: their records have other places than an SMC-4000's."""

from contextlib import suppress
from dataclasses import replace

import pytest
from adapter_worlds import CASES

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.conformance.worlds import Case, World, run_case
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault

FAMILIES = pytest.mark.parametrize("case", [CASES["galil dmc40x0"], CASES["galil dmc21x3"]], ids=["40x0", "21x3"])


async def send_as_other_client(world: World, line: bytes) -> None:
    link = await world.hit.wire.open_link()
    link.write(line)
    await sleep_ns(world.clock, 100 * NS_PER_MS)
    await link.close()


@FAMILIES
def test_a_stepper_that_is_off_has_lost_its_position_until_it_is_on(case: Case) -> None:
    async def main(world: World) -> None:
        await send_as_other_client(world, b"MTX=2\r")
        await world.ready(polls=1)
        await world.driver.set_enabled(["x", "y"], on=False)
        axes = (await world.driver.poll()).axes
        assert axes["x"].position_lost and not axes["y"].position_lost
        await world.driver.set_enabled(["x"], on=True)
        assert not (await world.driver.poll()).axes["x"].position_lost

    options = {**case.config["options"], "motor_type": {"x": 2}}
    run_case(replace(case, config={**case.config, "options": options}), main)


@FAMILIES
def test_a_limit_switch_is_concluded_from_its_level_and_ends_with_it(case: Case) -> None:
    async def main(world: World) -> None:
        for polarity in (b"CN -1\r", b"CN 1\r"):
            await send_as_other_client(world, polarity)
            world.hit.controller.set_limit("X", "none")
            await world.driver.connect()
            await world.driver.configure()
            for which in ("forward", "reverse", "none"):
                world.hit.controller.set_limit("X", which)
                assert (await world.driver.poll()).axes["x"].limit == which

    run_case(case, main)


@FAMILIES
def test_a_power_cycle_is_concluded_from_the_sample_counter(case: Case) -> None:
    async def main(world: World) -> None:
        await world.ready(polls=3)
        await world.driver.connect()
        await world.driver.configure()
        assert not (await world.driver.poll()).restarted
        world.hit.controller.set_power(on=False)
        with suppress(LinkClosed, LinkRefused, ControllerFault):
            await world.driver.poll()
        world.hit.controller.set_power(on=True)
        await sleep_ns(world.clock, 5 * NS_PER_S)
        await world.driver.connect()
        await world.driver.configure()
        assert (await world.driver.poll()).restarted
        assert not (await world.driver.poll()).restarted

    run_case(case, main)
