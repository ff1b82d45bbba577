"""Manual motion and homing of the SMC30, judged by the simulator's ground truth."""

import asyncio

import pytest
from unit.adapters.test_smc30_bench import World, run

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal


@pytest.mark.parametrize("end", [7, 40, 900, 20_000])
def test_a_jog_ends_exactly_at_the_end_of_travel(end: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await driver.jog_axis("x", JogMove(2500.0, 25_000.0, end))
        fastest = 0.0
        for _ in range(2000):
            await world.sleep(5)
            fastest = max(fastest, unit.velocity("1"))
            if unit.at_rest():
                break
        assert unit.position("1") == end
        assert fastest <= 2500 * 1.0001
        reading = (await driver.poll()).axes["x"]
        assert reading.commanded_counts == end
        assert reading.limit == "none"

    run(main)


def test_a_jog_changes_its_speed_by_a_stop_and_continues_when_it_is_repeated() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        first = JogMove(1000.0, 25_000.0, None)
        await driver.jog_axis("x", first)
        await world.sleep(300)
        await driver.jog_axis("x", first)
        assert len(unit.commanded_motions) == 1
        await driver.jog_axis("x", JogMove(-2000.0, 25_000.0, None))
        await world.sleep(400)
        assert len(unit.commanded_motions) == 2
        assert unit.velocity("1") == pytest.approx(-2000, rel=1e-3)
        reading = (await driver.poll()).axes["x"]
        assert reading.moving
        assert reading.velocity_counts_s == pytest.approx(-2000, rel=1e-3)
        assert reading.commanded_counts == pytest.approx(unit.position("1"), abs=200)
        await driver.stop_axes(["x"])
        await world.sleep(300)
        assert unit.at_rest()
        await driver.poll()
        _, _, outcome = await world.move(driver, 0)
        assert outcome.state == "done"

    run(main)


@pytest.mark.parametrize("after_ms", [0, 5, 30, 60, 90, 120, 150])
def test_a_stop_overtakes_a_jog_that_is_being_started(after_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        jogging = asyncio.get_running_loop().create_task(driver.jog_axis("x", JogMove(1000.0, 25_000.0, None)))
        await world.sleep(after_ms)
        await driver.stop(abort=False)
        await world.sleep(driver.capabilities.costs.stop_ns / NS_PER_MS)
        assert unit.at_rest()
        await asyncio.gather(jogging, return_exceptions=True)
        await world.sleep(500)
        assert unit.at_rest()

    run(main, (3,))


def test_a_cancelled_jog_stops() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        for after_ms in range(0, 200, 9):
            jogging = asyncio.get_running_loop().create_task(driver.jog_axis("x", JogMove(1000.0, 25_000.0, None)))
            await world.sleep(after_ms)
            if jogging.done():
                await jogging
                await driver.stop_axes(["x"])
            jogging.cancel()
            await asyncio.gather(jogging, return_exceptions=True)
            await world.sleep(800)
            assert unit.at_rest(), after_ms
            await driver.poll()

    run(main)


def test_an_impossible_jog_is_refused() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        for move, code in ((JogMove(10.0, 25_000.0, None), "too-slow"), (JogMove(-500.0, 25_000.0, 0), "at-end")):
            with pytest.raises(Refusal) as caught:
                await driver.jog_axis("x", move)
            assert caught.value.code == code
        await world.arm(driver, 500)
        with pytest.raises(Refusal) as caught:
            await driver.jog_axis("x", JogMove(500.0, 25_000.0, None))
        assert caught.value.code == "busy"
        await driver.slots.unload()
        await driver.set_enabled(["x"], on=False)
        with pytest.raises(Refusal) as caught:
            await driver.jog_axis("x", JogMove(500.0, 25_000.0, None))
        assert caught.value.code == "not-enabled"
        assert not unit.commanded_motions

    run(main)


def test_a_jog_into_the_end_of_travel_reports_which_end() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, _ = world.one
        await driver.jog_axis("x", JogMove(-1000.0, 25_000.0, None))
        await world.sleep(1500)
        reading = (await driver.poll()).axes["x"]
        assert (reading.commanded_counts, reading.limit, reading.moving) == (-600, "reverse", False)

    run(main, simulate={"travel_steps": [-600, 600]})


@pytest.mark.parametrize("direction", ["negative", "positive"])
def test_homing_to_an_end_of_travel(direction: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        found: list[str] = []
        assert await driver.home_axes(["x"], found.append) == {}
        assert found == ["x"]
        assert (await driver.poll()).axes["x"].commanded_counts == 0
        assert unit.commanded_motions[-1].end_counts == (-600 if direction == "negative" else 700)

    run(main, simulate={"travel_steps": [-600, 700]}, axis={"homing": {"speed": 1, "direction": direction}})


@pytest.mark.parametrize("reached", [True, False])
def test_homing_to_a_user_input(reached: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        homing = asyncio.get_running_loop().create_task(driver.home_axes(["x"], lambda _: None))
        await world.sleep(600)
        assert unit.is_moving("1")
        if reached:
            unit.set_input(3, level=True)
        failed = await homing
        if reached:
            assert failed == {}
            assert (await driver.poll()).axes["x"].commanded_counts == 0
        else:
            # The end of travel came first: that is no reference.
            assert failed["x"].code == "homing-failed"
            assert "input 3" in failed["x"].text

    run(main, simulate={"travel_steps": [-2000, 2000]}, axis={"homing": {"speed": 0.5, "method": "input3"}})


@pytest.mark.parametrize("how", ["stop", "cancel", "power"])
def test_a_homing_that_is_stopped_has_found_nothing(how: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.move(driver, 300)
        homing = asyncio.get_running_loop().create_task(driver.home_axes(["x"], lambda _: None))
        await world.sleep(500)
        assert unit.is_moving("1")
        if how == "stop":
            await driver.stop(abort=False)
        elif how == "cancel":
            homing.cancel()
        else:
            unit.set_power(on=False)
            unit.set_power(on=True)
        (result,) = await asyncio.gather(homing, return_exceptions=True)
        await world.sleep(500)
        assert unit.at_rest()
        if how == "cancel":
            assert isinstance(result, asyncio.CancelledError)
        else:
            assert isinstance(result, dict)
            assert result["x"].code == "homing-failed"

    run(main, simulate={"travel_steps": [-20_000, 2000]})


def test_homing_finds_the_place_again_after_a_kill() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, _ = world.one
        await driver.jog_axis("x", JogMove(1000.0, 25_000.0, None))
        await world.sleep(300)
        await driver.stop(abort=True)
        await world.sleep(300)
        assert (await driver.poll()).axes["x"].position_lost
        await driver.home_axes(["x"], lambda _: None)
        assert not (await driver.poll()).axes["x"].position_lost

    run(main, simulate={"travel_steps": [-600, 20_000]})


def test_outputs_inputs_and_raw() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await driver.set_output(3, on=True)
        unit.set_input(2, level=True)
        await world.sleep(5)
        reading = await driver.poll()
        assert reading.outputs == {1: False, 2: False, 3: True}
        assert reading.inputs == {1: False, 2: True, 3: False}
        assert await driver.send_raw("VT") == "T1000"
        assert await driver.send_raw("nonsense") == "E4"
        with pytest.raises(Refusal):
            await driver.send_raw("VT\rK")
        await driver.jog_axis("x", JogMove(500.0, 25_000.0, None))
        with pytest.raises(Refusal) as caught:
            await driver.set_output(3, on=False)
        assert caught.value.code == "moving"
        assert await driver.send_raw("F") == "B"

    run(main, (4,))


@pytest.mark.parametrize("after_ms", range(0, 200, 10))
def test_a_controller_that_is_restarted_while_its_homing_is_prepared_does_not_start_it(after_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one

        async def search() -> None:
            assert await driver.home_axes(["x"], lambda _: None)

        assert not await world.begun_by_restarted(unit, search(), after_ms, 3000)

    run(main)


@pytest.mark.parametrize("after_ms", range(0, 200, 10))
def test_a_controller_that_is_restarted_while_a_jog_is_prepared_does_not_start_it(after_ms: int) -> None:
    """Its counter is 0 again: the end of travel would lie on the other side."""

    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        jogging = driver.jog_axis("x", JogMove(-1000.0, 25_000.0, None))
        assert not await world.begun_by_restarted(unit, jogging, after_ms, 1000)

    run(main)
