"""Homing of an SMC-4000, its soft limits, and motors that were moved while off."""

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest
from unit.adapters.test_smc4000_bench import FLEET, LIMITS, World, run, trapezoid
from unit.adapters.watching import at_rest, not_found

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal

BOTH = {"home_edge": {"X": 3000, "Y": 5000}, "index_every": {"X": 2000, "Y": 2000}}


async def homed(world: World, *axes: str) -> Mapping[str, Refusal]:
    """Home, and check that each axis is reported as either found or failed."""
    found: list[str] = []
    failed = await world.driver.home_axes(axes or ("x", "y"), found.append)
    assert sorted([*found, *failed]) == sorted(axes or ("x", "y"))
    return failed


def test_axes_home_simultaneously_and_the_others_finish_if_one_fails():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_enabled(["x"], on=False)
        failed = await homed(world)
        assert {axis: error.code for axis, error in failed.items()} == {"x": "not-enabled"}
        assert (await world.driver.poll()).axes["y"].commanded_counts == 0
        assert {motion.axis for motion in world.controller.commanded_motions} == {"Y"}
        with pytest.raises(Refusal, match="axis x is not enabled"):
            await homed(world, "x")

    run(main, options=BOTH)


def test_each_axis_is_reported_as_soon_as_it_is_homed():
    async def main(world: World) -> None:
        await world.ready()
        told_ns: dict[str, int] = {}
        await world.driver.home_axes(["x", "y"], lambda axis: told_ns.update({axis: world.clock.now_ns()}))
        for motion in world.controller.commanded_motions:
            assert motion.end_ns is not None
            assert 0 < told_ns[motion.axis.lower()] - motion.end_ns < 60 * NS_PER_MS
        assert abs(told_ns["y"] - told_ns["x"]) > 100 * NS_PER_MS

    run(main, options={"home_edge": {"X": 300, "Y": 9000}, "index_every": {"X": 2000, "Y": 2000}})


@pytest.mark.parametrize("edge", [-4000, -1, 0, 1, 4000])
def test_the_switch_is_found_from_either_side_and_when_it_is_active_already(edge: int):
    async def main(world: World) -> None:
        await world.ready()
        for _ in range(2):
            assert not await homed(world, "x")
            assert (await world.driver.poll()).axes["x"].commanded_counts == 0

    run(main, options={"home_edge": {"X": edge}, "index_every": {"X": 2000}})


@pytest.mark.parametrize("method", ["default", "edge", "index"])
def test_a_switch_that_never_comes_ends_on_the_limit_switch(method: str):
    axes = {
        name: {"motors": [name.upper()], "unit": "mm", "scale": 1000, "limits": LIMITS, "homing": {"method": method}}
        for name in ("x", "y")
    }
    found = {"home_edge": {"Y": 400}, "index_every": {"Y": -700}}

    async def main(world: World) -> None:
        await world.ready()
        failed = await homed(world)
        assert set(failed) == {"x"}
        assert "limit" in str(failed["x"])
        assert (await world.driver.poll()).axes["x"].limit != "none"
        assert (await world.driver.poll()).axes["y"].commanded_counts == 0
        with pytest.raises(Refusal, match="Limit Switch"):
            await homed(world, "x")
        back = -1 if (await world.driver.poll()).axes["x"].limit == "forward" else 1
        await world.driver.jog_axis("x", JogMove(back * 10_000.0, 100_000.0, None))
        await sleep_ns(world.clock, 300 * NS_PER_MS)
        await world.driver.stop_axes(["x"])
        assert (await world.driver.poll()).axes["x"].limit == "none"

    run(main, fleet=FLEET | {"axes": axes}, options=found | {"travel": {"X": (-2000, 2000)}})


def test_native_limits_block_a_homing_until_they_are_opened():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.load_soft_limits({"x": (-500, 500)})
        failed = await homed(world, "x")
        assert "limit" in str(failed["x"])
        await world.driver.load_soft_limits({"x": None})
        assert not await homed(world, "x")
        await world.driver.load_soft_limits({"x": (-500, 500)})
        await world.driver.jog_axis("x", JogMove(5000.0, 100_000.0, 500))
        await at_rest(world.clock, world.controller, "X", NS_PER_S)
        assert world.controller.position("X") == 500

    run(main, options=BOTH)


def test_limits_that_are_not_stored_are_a_fault():
    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_far = lambda data: data.replace(b"FLX=900", b"FLX=800")
        with pytest.raises(ControllerFault, match="FLX is 800, wanted 900") as fault:
            await world.driver.load_soft_limits({"x": (-900, 900)})
        assert fault.value.code == "config-mismatch"

    run(main)


@pytest.mark.parametrize("after_ms", [0, 1, 2, 4, 6, 8, 10, 12, 30, 200, 900])
@pytest.mark.parametrize("whole", [False, True])
def test_a_stop_in_between_ends_the_homing_as_failed(after_ms: int, whole: bool):
    async def main(world: World) -> None:
        await world.ready()
        search = asyncio.create_task(homed(world, "x"))
        await sleep_ns(world.clock, after_ms * NS_PER_MS)
        await (world.driver.stop(abort=False) if whole else world.driver.stop_axes(["x"]))
        (outcome,) = await asyncio.gather(search, return_exceptions=True)
        assert not_found(outcome, "x")
        await sleep_ns(world.clock, 500 * NS_PER_MS)
        assert not world.controller.is_moving("X")
        assert not await homed(world, "x")

    run(main, options=BOTH, seed=after_ms)


@pytest.mark.parametrize("after_ms", [*range(0, 24, 2), 300, 900])
def test_a_cancelled_homing_is_ended_by_a_stop(after_ms: int):
    async def main(world: World) -> None:
        await world.ready()
        search = asyncio.create_task(homed(world))
        await sleep_ns(world.clock, after_ms * NS_PER_MS)
        search.cancel()
        await asyncio.gather(search, return_exceptions=True)
        await world.driver.stop(abort=False)
        await sleep_ns(world.clock, 500 * NS_PER_MS)
        assert not world.controller.is_moving("X") and not world.controller.is_moving("Y")
        await world.driver.poll()
        assert not await homed(world)

    run(main, options=BOTH, seed=after_ms)


def test_a_cancelled_homing_ends_by_itself():
    async def main(world: World) -> None:
        await world.ready()
        search = asyncio.create_task(homed(world))
        await sleep_ns(world.clock, 150 * NS_PER_MS)
        assert world.controller.is_moving("X") and world.controller.is_moving("Y")
        search.cancel()
        await asyncio.gather(search, return_exceptions=True)
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert not world.controller.is_moving("X") and not world.controller.is_moving("Y")

    run(main, options=BOTH)


@pytest.mark.parametrize("way", ["power", "reset"])
def test_a_restart_in_between_is_no_success(way: str):
    async def main(world: World) -> None:
        await world.ready()
        search = asyncio.create_task(homed(world, "x"))
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        if way == "power":
            world.controller.set_power(on=False)
            await sleep_ns(world.clock, 100 * NS_PER_MS)
            world.controller.set_power(on=True)
        else:
            await world.talk("RS")
        (outcome,) = await asyncio.gather(search, return_exceptions=True)
        assert not_found(outcome, "x")
        assert not world.controller.is_moving("X")

    run(main, options=BOTH)


def test_a_servo_that_was_pushed_while_off_continues_from_its_position():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_enabled(["x"], on=False)
        world.controller.push_axis("X", 1234)
        reading = (await world.driver.poll()).axes["x"]
        assert reading.actual_counts == 1234 and not reading.position_lost
        await world.driver.set_enabled(["x"], on=True)
        reading = (await world.driver.poll()).axes["x"]
        assert reading.commanded_counts == reading.actual_counts == 1234
        _, _, outcome, _ = await world.moved({"x": trapezoid(1234, 2234, 20_000, 200_000)})
        assert outcome.state == "done"
        await world.driver.jog_axis("x", JogMove(-20_000.0, 200_000.0, 0))
        await at_rest(world.clock, world.controller, "X", NS_PER_S)
        assert world.controller.position("X") == 0

    run(main)


def test_a_stepper_that_is_off_has_lost_its_position():
    config: dict[str, Any] = FLEET | {"options": {"motor_type": {"x": 2}}}

    async def main(world: World) -> None:
        await world.talk("MTX=2")
        await world.ready()
        assert not any(axis.position_lost for axis in (await world.driver.poll()).axes.values())
        await world.driver.set_enabled(["x", "y"], on=False)
        world.controller.push_axis("X", 700)
        reading = await world.driver.poll()
        assert reading.axes["x"].position_lost and not reading.axes["y"].position_lost
        assert reading.axes["x"].actual_counts == reading.axes["x"].commanded_counts == 0
        await world.driver.set_enabled(["x"], on=True)
        assert not (await world.driver.poll()).axes["x"].position_lost
        # The stage stands where it was pushed to: the switch is nearer by that distance.
        assert not await homed(world, "x")
        motion = world.controller.commanded_motions[0]
        assert motion.axis == "X"

    run(main, fleet=config, options=BOTH)
