"""Homing of an SHRC-203, and stages that were moved while their motors were off."""

import asyncio
from collections.abc import Mapping
from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import Bench, controller, run
from unit.adapters.watching import Polling, at_rest, not_found

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal


def mixed(*methods: str) -> Any:
    """Axes x, y, z with these homing methods."""
    fleet = controller()
    axes = {
        name: axis.model_copy(update={"homing": axis.homing.model_copy(update={"method": method})})
        for (name, axis), method in zip(fleet.axes.items(), methods, strict=True)
    }
    return fleet.model_copy(update={"axes": axes})


async def homed(bench: Bench, *axes: str) -> Mapping[str, Refusal]:
    """Home, and check that each axis is reported as either found or failed."""
    found: list[str] = []
    failed = await bench.driver.home_axes(axes, found.append)
    assert sorted([*found, *failed]) == sorted(axes)
    return failed


@pytest.mark.parametrize("simulate", [{}, {"busy_anywhere": True}, {"completion_after_stop": False}])
def test_axes_of_different_methods_are_all_homed(simulate: dict[str, Any]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        async with Polling(bench.clock, bench.driver.poll):
            assert not await homed(bench, "x", "y", "z")
        reading = await bench.driver.poll()
        assert all(axis.commanded_counts == 0 and not axis.moving for axis in reading.axes.values())
        starts = sorted(motion.start_ns for motion in bench.unit.commanded_motions)
        assert len(starts) == 3
        assert (starts[2] - starts[0] < 200 * NS_PER_MS) != ("busy_anywhere" in simulate)
        await bench.start({"x": 500, "y": 500})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, config=mixed("orgs", "mini", "default"), simulate=simulate)


def test_the_other_axes_finish_if_one_fails() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.set_enabled(["y"], on=False)
        failed = await homed(bench, "x", "y", "z")
        assert {axis: error.code for axis, error in failed.items()} == {"y": "not-enabled"}
        assert {motion.axis for motion in bench.unit.commanded_motions} == {"1", "3"}
        with pytest.raises(Refusal, match="axis y is not enabled"):
            await homed(bench, "y")
        assert not bench.unit.is_moving("2")

    run(case)


def test_each_axis_is_reported_as_soon_as_it_is_homed() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        told_ns: dict[str, int] = {}
        await bench.driver.home_axes(["x", "y"], lambda axis: told_ns.update({axis: bench.clock.now_ns()}))
        for motion in bench.unit.commanded_motions:
            assert motion.end_ns is not None
            assert 0 < told_ns["xyz"[int(motion.axis) - 1]] - motion.end_ns < 100 * NS_PER_MS
        assert told_ns["y"] - told_ns["x"] > 300 * NS_PER_MS

    run(case, simulate={"origin_pls": {"1": -1000, "2": -9000}})


def test_a_persistent_error_is_named() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.stop(abort=True)
        await bench.driver.poll()
        with pytest.raises(Refusal):
            await homed(bench, "x")
        assert not bench.moved()

    run(case, simulate={"emergency_excitation_off": False})


@pytest.mark.parametrize("coordinate", [0, 700])
def test_an_origin_that_never_comes_ends_on_the_limit_sensor(coordinate: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        # Where the sensor stops it, the coordinate happens to be 0.
        await bench.driver.send_raw(f"PSET:1+P{coordinate}")
        failed = await homed(bench, "x", "z")
        assert set(failed) == {"x"}
        assert "limit" in str(failed["x"])
        reading = await bench.driver.poll()
        assert reading.axes["x"].limit == "reverse" and reading.axes["z"].commanded_counts == 0
        await bench.driver.jog_axis("x", JogMove(10_000.0, 100_000.0, coordinate + 100))
        await at_rest(bench.clock, bench.unit, "1", NS_PER_S)
        assert (await bench.driver.poll()).axes["x"].limit == "none"

    run(case, simulate={"origin_pls": {"1": -9000}, "travel_pls": {"1": (-coordinate, 9000)}})


@pytest.mark.parametrize("origin", [0, 1, -1, 1000])
def test_the_origin_is_found_from_either_side_and_from_where_it_is(origin: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for _ in range(2):
            assert not await homed(bench, "x")
            assert (await bench.driver.poll()).axes["x"].commanded_counts == 0

    run(case, simulate={"origin_pls": {"1": origin}})


@pytest.mark.parametrize("after_ms", [0, 2, 5, 8, 11, 14, 17, 20, 60, 150])
@pytest.mark.parametrize("whole", [False, True])
@pytest.mark.parametrize("speaks", [False, True])
def test_a_stop_in_between_ends_the_homing_as_failed(after_ms: int, whole: bool, speaks: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        search = asyncio.create_task(homed(bench, "x"))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        await (bench.driver.stop(abort=False) if whole else bench.driver.stop_axes(["x"]))
        (outcome,) = await asyncio.gather(search, return_exceptions=True)
        assert not_found(outcome, "x")
        assert not bench.unit.is_moving("1")
        await sleep_ns(bench.clock, 500 * NS_PER_MS)
        assert not bench.unit.is_moving("1")
        assert not await homed(bench, "x")

    run(case, seed=after_ms, simulate={"completion_after_stop": speaks})


@pytest.mark.parametrize("after_ms", [*range(0, 40, 4), 120])
@pytest.mark.parametrize("speaks", [False, True])
def test_a_cancelled_homing_is_ended_by_a_stop_and_polls_stay_right(after_ms: int, speaks: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_input(2, level=True)
        search = asyncio.create_task(homed(bench, "x", "y"))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        search.cancel()
        await asyncio.gather(search, return_exceptions=True)
        await bench.driver.stop(abort=False)
        for _ in range(6):
            reading = await bench.driver.poll()
            assert reading.inputs[1] is False  # a completion line is not taken for the inputs
            await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert not bench.unit.is_moving("1") and not bench.unit.is_moving("2")
        reading = await bench.driver.poll()
        assert reading.inputs[2]
        await bench.driver.set_output(1, on=True)
        assert not await homed(bench, "x", "y")

    fleet = controller(inputs={"door": {"number": 2}}, outputs={"lamp": {"number": 1}})
    run(case, config=fleet, seed=after_ms, simulate={"completion_after_stop": speaks})


@pytest.mark.parametrize("polls", [False, True])
@pytest.mark.parametrize("after_ms", [30, 100, 150])
def test_a_power_cycle_in_between_is_no_success(after_ms: int, polls: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        search = asyncio.create_task(homed(bench, "x"))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        bench.unit.set_power(on=False)
        await sleep_ns(bench.clock, 20 * NS_PER_MS)
        bench.unit.set_power(on=True)
        if polls:
            with pytest.raises(LinkClosed, match="restarted"):
                await bench.driver.poll()
        (outcome,) = await asyncio.gather(search, return_exceptions=True)
        why = not_found(outcome, "x")
        assert "restarted" in why or "no reply" in why

    run(case)


def test_a_cancelled_homing_ends_by_itself() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        search = asyncio.create_task(homed(bench, "x", "y"))
        await sleep_ns(bench.clock, 80 * NS_PER_MS)
        assert bench.unit.is_moving("1") and bench.unit.is_moving("2")
        search.cancel()
        await asyncio.gather(search, return_exceptions=True)
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert not bench.unit.is_moving("1") and not bench.unit.is_moving("2")

    run(case)


def test_an_open_loop_stage_whose_motor_was_off_has_lost_its_position() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert not any(axis.position_lost for axis in (await bench.driver.poll()).axes.values())
        await bench.driver.set_enabled(["x"], on=False)
        bench.unit.push_axis("1", 700)
        reading = await bench.driver.poll()
        assert reading.axes["x"].position_lost and not reading.axes["y"].position_lost
        assert reading.axes["x"].commanded_counts == 0
        await bench.driver.set_enabled(["x"], on=True)
        assert not (await bench.driver.poll()).axes["x"].position_lost
        await homed(bench, "x")
        assert bench.unit.commanded_motions[0].end_counts == -1700  # the origin is as much farther away

    run(case)


def test_a_closed_loop_keeps_its_position_and_returns_the_stage() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.set_enabled(["x"], on=False)
        bench.unit.push_axis("1", 700)
        reading = (await bench.driver.poll()).axes["x"]
        assert not reading.position_lost
        assert (reading.commanded_counts, reading.actual_counts) == (0, 700.0)
        await bench.driver.set_enabled(["x"], on=True)
        reading = (await bench.driver.poll()).axes["x"]
        assert (reading.commanded_counts, reading.actual_counts) == (0, 0.0)
        await bench.start({"x": 1000})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"
        assert (await bench.driver.poll()).axes["x"].actual_counts == 1000.0

    run(case, options={"loop": "closed"}, simulate={"scales": True})
