"""A move that is loaded right behind another one: what is not read again before it, the check before the commit reads;
without one (`at once`), loading itself."""

import pytest
from unit.adapters import ppsmc_bench, test_smc30_bench
from unit.adapters.ppsmc_bench import Bench
from unit.adapters.test_smc30_bench import HOST, World

from adapters.contract import LoadPlace
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal


@pytest.mark.parametrize("place", ["behind", "at once"])
@pytest.mark.parametrize("restarts", [False, True])
def test_smc30_is_loaded_behind_and_refused_if_it_has_restarted(restarts: bool, place: LoadPlace) -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.ready()
        await world.move(driver, 2000)
        lowered = driver.lower_profiles(await world.plan(driver, 500), HOST, None)
        if restarts:
            await world.power_cycle(unit, 50)
            await world.sleep(500)
        slot = driver.slots.present
        t0_ns = world.t0(lowered)
        begun_ns = world.clock.now_ns()
        if restarts:
            with pytest.raises(Refusal):
                await slot.load(lowered, t0_ns, None, place)
                if place == "behind":
                    await slot.verify()
            await world.sleep(2000)
            assert unit.position("1") != 500
            return
        await slot.load(lowered, t0_ns, None, place)
        behind_ns = world.clock.now_ns() - begun_ns
        if place == "behind":
            await slot.verify()
        await slot.release()
        await slot.wait_for_start()
        assert (await slot.wait_for_end()).state == "done" and unit.position("1") == 500
        lowered, begun_ns = driver.lower_profiles(await world.plan(driver, 900), HOST, None), world.clock.now_ns()
        await slot.load(lowered, world.t0(lowered), None)
        assert place == "at once" or behind_ns < 0.92 * (world.clock.now_ns() - begun_ns)

    test_smc30_bench.run(main)


@pytest.mark.parametrize("place", ["behind", "at once"])
@pytest.mark.parametrize("line", ["", "goto1:1.9", "goto1:80", "block"])
def test_ppsmc_is_loaded_behind_and_refused_if_another_client_has_moved_it(line: str, place: LoadPlace) -> None:
    async def main(bench: Bench) -> None:
        await bench.ready()
        await bench.move({"x": 2000})
        lowered = await bench.lowered({"x": 500})
        if line:
            await bench.send_as_other_client(line)
        slot = bench.driver.slots.present
        t0_ns = bench.clock.now_ns() + NS_PER_S
        if line:
            with pytest.raises(Refusal):
                await slot.load(lowered, t0_ns, None, place)
                if place == "behind":
                    await slot.verify()
            return
        await slot.load(lowered, t0_ns, None, place)
        if place == "behind":
            await slot.verify()
        await slot.release()
        await slot.wait_for_start()
        assert (await slot.wait_for_end()).state == "done"

    ppsmc_bench.run(main)
