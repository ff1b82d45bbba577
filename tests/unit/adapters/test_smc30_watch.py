"""Settings of an SMC30 that another client changes: no query shows them, so they are set again before every motion."""

from typing import Any

import pytest
from unit.adapters.test_smc30_bench import HOST, World, run

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal

CURRENTS: dict[str, Any] = {"options": {"standby_ma": 1500, "ramp_ma": 3000, "top_ma": 2500}}


def test_a_conversion_factor_of_another_client_changes_no_length() -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.ready()
        assert (await world.move(driver, 1000))[2].state == "done"
        await driver.send_raw("con=2.0000")
        assert not await driver.check_settings(everything=True)
        assert (await world.move(driver, 3000))[2].state == "done"
        assert unit.position("1") == 3000
        await driver.send_raw("con=2.0000")
        await driver.jog_axis("x", JogMove(-2000.0, 20_000.0, 1000))
        await world.sleep(3000)
        assert unit.position("1") == 1000

    run(main)


def test_currents_of_another_client_are_set_again_before_a_step() -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.ready()
        for command in ("CS100", "CR100", "CT100"):
            await driver.send_raw(command)
        assert not await driver.check_settings(everything=True)
        assert _currents(unit) == [1500, 3000, 2500]
        await driver.set_enabled(["x"], on=False)
        assert not await driver.check_settings(everything=True)
        assert _currents(unit) == [0, 3000, 2500]

    run(main, **CURRENTS)


def _currents(unit: Any) -> list[int]:
    currents: dict[str, int] = unit._stations[0].unit._values.parameters.currents_ma
    return [currents[name] for name in ("CS", "CR", "CT")]


def test_the_settings_take_the_time_that_arming_allows_for() -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        await world.ready()
        lowered = driver.lower_profiles(await world.plan(driver, 1000), HOST, None)
        began_ns = world.clock.now_ns()
        assert not await driver.check_settings(everything=True)
        assert world.clock.now_ns() - began_ns < 3 * 25 * NS_PER_MS
        await driver.slots.present.load(lowered, world.t0(lowered), None)
        assert world.clock.now_ns() - began_ns <= lowered.costs.arm_ns

    run(main, **CURRENTS)


def test_nothing_is_sent_at_rest_nor_into_the_program_of_another_client() -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        await world.ready()
        for line in ("PO", "S100"):
            await driver.send_raw(line)
        for _ in range(5):
            assert not await driver.check_settings(everything=False)
        for line in ("T200", "R10", "PX"):
            await driver.send_raw(line)
        assert (await driver.send_raw("Q")).split("\n")[:3] == ["S100", "T200", "R10"]

    run(main)


def test_a_busy_controller_refuses_its_settings() -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        await world.ready()
        await driver.jog_axis("x", JogMove(500.0, 20_000.0, 5000))
        with pytest.raises(Refusal) as caught:
            await driver.check_settings(everything=True)
        assert caught.value.code == "moving"

    run(main)
