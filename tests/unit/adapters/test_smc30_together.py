"""Seven SMC30 of one bus in one step, stopped at any moment of it: one of them, or all."""

import asyncio
from collections.abc import Coroutine, Mapping
from dataclasses import replace
from typing import Any

import pytest
from unit.adapters.test_smc30_bench import HOST, World, run, wait
from unit.random_rounds import share_with_nightly

from adapters.contract import JogMove, MoveOutcome
from adapters.smc30.driver import Smc30Driver
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_until_ns
from orchestrator.model.errors import ControllerFault, Refusal

ALL = range(1, 8)
TARGET = 4000


async def follow(driver: Smc30Driver) -> MoveOutcome | None:
    """The outcome of a member after its `go`; None: it has not started."""
    try:
        await driver.slots.present.wait_for_start()
        return await driver.slots.present.wait_for_end()
    except (ControllerFault, Refusal):
        return None


async def released(world: World) -> int:
    """All armed, promised and released; T0."""
    drivers = list(world.drivers.values())
    lowered = [driver.lower_profiles(await world.plan(driver, TARGET), HOST, None) for driver in drivers]
    t0_ns = world.t0(lowered[0]) + sum(each.costs.arm_ns for each in lowered[1:])
    await asyncio.gather(
        *(driver.slots.present.load(each, t0_ns, None) for driver, each in zip(drivers, lowered, strict=True))
    )
    await asyncio.gather(*(driver.slots.present.verify() for driver in drivers))
    await asyncio.gather(*(driver.slots.present.release() for driver in drivers))
    return t0_ns


async def followed(
    world: World, stopping: list[Smc30Driver], at_ns: int, abort: bool
) -> Mapping[int | None, MoveOutcome]:
    """Some are stopped at that instant; return the outcome of those that have started."""
    following = {each: asyncio.get_running_loop().create_task(follow(driver)) for each, driver in world.drivers.items()}
    await sleep_until_ns(world.clock, at_ns)
    for driver in stopping:
        await driver.stop(abort=abort)
    await world.sleep(world.one[0].capabilities.costs.stop_ns / NS_PER_MS)
    for each, driver in world.drivers.items():
        if driver in stopping:
            assert world.units[each].at_rest(), each
    ended = {each: await task for each, task in following.items()}
    return {each: outcome for each, outcome in ended.items() if outcome is not None}


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("before_ms", [120, 90, 83, 78, 71, 64, 57, 49, 41, 33, 27, 19, 11, 5, 0, -3, -200])
def test_all_stop_at_any_stage_of_their_start_commands(before_ms: int, abort: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        t0_ns = await released(world)
        outcomes = await followed(world, list(world.drivers.values()), t0_ns - before_ms * NS_PER_MS, abort)
        assert all(outcome.state != "done" for outcome in outcomes.values())
        rests = {each: unit.position("1") for each, unit in world.units.items()}
        await world.sleep(3000)
        assert rests == {each: unit.position("1") for each, unit in world.units.items()}
        # Seven stops take 29 ms on the line, and some more to be decoded.
        if before_ms > 35:
            assert set(rests.values()) == {0.0}
        # Nothing is left over.
        again = await released(world)
        outcomes = await followed(world, [], again, abort)
        assert {outcome.state for outcome in outcomes.values()} == {"done"}
        assert len(outcomes) == len(ALL)

    run(main, ALL, seed=before_ms + 300)


@pytest.mark.parametrize("before_ms", [120, 83, 64, 41, 19, 5, 0, -200])
@pytest.mark.parametrize("which", [1, 3, 7])
def test_one_stops_and_nothing_wrong_is_reported_of_the_others(before_ms: int, which: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        t0_ns = await released(world)
        outcomes = await followed(world, [world.drivers[which]], t0_ns - before_ms * NS_PER_MS, False)
        await world.sleep(3000)
        for each, unit in world.units.items():
            outcome = outcomes.get(each)
            assert unit.at_rest()
            if each == which:
                assert outcome is None or outcome.state == "stopped"
            elif outcome is not None and outcome.state == "done":
                assert unit.position("1") == TARGET
            # A controller that is reported as not started stands still, or was stopped for it.
            elif outcome is None:
                assert unit.position("1") < TARGET

    run(main, ALL, seed=before_ms + 300)


@pytest.mark.parametrize("seed", range(4))
def test_answers_that_arrive_late_are_not_mistaken_for_each_other(seed: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        await released(world)
        # More than from one slot to the next.
        world.wire.model = replace(world.wire.model, hold_ns=14 * NS_PER_MS)
        started = await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in world.drivers.values()))
        for each, span in zip(world.drivers, started, strict=True):
            assert span["x"].earliest_ns <= world.units[each].commanded_motions[0].start_ns <= span["x"].latest_ns

    run(main, ALL, seed=seed)


def test_seven_that_jog_are_stopped_together() -> None:
    async def main(world: World) -> None:
        await world.ready()
        await asyncio.gather(
            *(driver.jog_axis("x", JogMove(3000.0, 25_000.0, None)) for driver in world.drivers.values())
        )
        await world.sleep(20)
        assert all(unit.is_moving("1") for unit in world.units.values())
        began_ns = world.clock.now_ns()
        for driver in world.drivers.values():
            await driver.stop(abort=False)
        while any(unit.is_moving("1") for unit in world.units.values()):
            await world.sleep(1)
        # The lines of all, and the ramp.
        assert world.clock.now_ns() - began_ns < 220 * NS_PER_MS
        for driver in world.drivers.values():
            assert not (await driver.poll()).axes["x"].position_lost

    run(main, ALL)


@pytest.mark.parametrize("act", ["jog", "home"])
@pytest.mark.parametrize(
    "after_ms", share_with_nightly([*range(0, 450, 45), *range(15, 450, 45), *range(30, 450, 45)], 10)
)
def test_a_controller_on_a_busy_line_that_is_restarted_before_a_manual_motion_does_not_move(
    act: str, after_ms: int
) -> None:
    """No line of its program is executed instead of being stored: the program is lost while the others have their
    turns."""

    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.drivers[3], world.units[3]

        async def polled(other: Smc30Driver) -> None:
            while True:
                await other.poll()

        loop = asyncio.get_running_loop()
        others = [loop.create_task(polled(each)) for address, each in world.drivers.items() if address != 3]
        if act == "jog":
            doing: Coroutine[Any, Any, object] = driver.jog_axis("x", JogMove(-1000.0, 25_000.0, None))
        else:
            doing = driver.home_axes(["x"], lambda _: None)
        assert not await world.begun_by_restarted(unit, doing, after_ms, 2000)
        for other in others:
            other.cancel()

    run(main, ALL)


def test_a_trigger_line_starts_some_while_slots_start_the_others() -> None:
    async def main(world: World) -> None:
        await world.ready()
        ways = {each: wait() if (each or 0) % 2 else HOST for each in world.drivers}
        lowered = {
            each: driver.lower_profiles(await world.plan(driver, 500), ways[each], None)
            for each, driver in world.drivers.items()
        }
        t0_ns = world.t0(lowered[1]) + sum(each.costs.arm_ns for each in lowered.values())
        drivers = world.drivers
        await asyncio.gather(
            *(driver.slots.present.load(lowered[each], t0_ns, None) for each, driver in drivers.items())
        )
        await asyncio.gather(*(driver.slots.present.verify() for driver in drivers.values()))
        await asyncio.gather(*(driver.slots.present.release() for driver in drivers.values()))
        await sleep_until_ns(world.clock, t0_ns)
        for unit in world.units.values():
            unit.set_input(1, level=True)
        started = await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in drivers.values()))
        for each, span in zip(drivers, started, strict=True):
            assert span["x"].earliest_ns <= world.units[each].commanded_motions[0].start_ns <= span["x"].latest_ns
        outcomes = await asyncio.gather(*(driver.slots.present.wait_for_end() for driver in drivers.values()))
        assert {outcome.state for outcome in outcomes} == {"done"}
        assert world.clock.now_ns() - t0_ns < 5 * NS_PER_S

    run(main, ALL, {"input_poll_ms": 1.0})
