"""SMC30 started by a trigger line, or driving one, judged by the simulator's ground truth."""

import asyncio

import pytest
from unit.adapters.restarts import sees_the_restart
from unit.adapters.test_smc30_bench import HOST, WINDOW_NS, World, drive, run, wait

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_until_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions, TriggerWait


def window(lowered_terms: object) -> tuple[int, int]:
    terms = list(lowered_terms)  # type: ignore[call-overload]
    return sum(term.earliest_ns for term in terms), sum(term.latest_ns for term in terms)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("live", [False, True])
def test_a_controller_waits_for_its_trigger_line_and_starts_within_its_bounds(seed: int, live: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        lowered, t0_ns = await world.arm(driver, 6000, wait())
        assert lowered.start_class == "line"
        assert [term.name for term in lowered.terms] == ["line", "input", "firmware"]
        await driver.slots.present.verify()
        await driver.slots.present.release()
        assert not (await driver.poll()).axes["x"].moving
        await sleep_until_ns(world.clock, t0_ns)
        unit.set_input(1, level=True)
        span = (await driver.slots.present.wait_for_start())["x"]
        outcome = await driver.slots.present.wait_for_end()
        assert outcome.state == "done"
        motion = unit.commanded_motions[0]
        low, high = window(lowered.terms)
        assert low <= motion.start_ns - t0_ns <= high
        assert span.earliest_ns <= motion.start_ns <= span.latest_ns
        assert motion.end_ns is not None
        assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns
        assert motion.end_counts == 6000

    run(main, simulate={"input_poll_ms": 1.0, "live_verify": live}, seed=seed)


def test_a_trigger_line_that_is_active_already_is_refused() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        unit.set_input(1, level=True)
        await world.sleep(5)
        with pytest.raises(Refusal) as caught:
            await world.arm(driver, 6000, wait())
        assert caught.value.code == "line-level"
        await world.sleep(2000)
        assert not unit.commanded_motions
        unit.set_input(1, level=False)
        await driver.slots.unload()
        await world.arm(driver, 6000, wait())

    run(main)


def test_an_input_that_is_active_low_is_waited_for_as_such() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        with pytest.raises(Refusal) as caught:
            await world.arm(driver, 500, wait())
        assert caught.value.code == "line-level"
        unit.set_input(1, level=True)
        await world.sleep(5)
        lowered, _ = await world.arm(driver, 500, wait())
        assert "N11.09" in lowered.program
        unit.set_input(1, level=False)
        await world.sleep(1000)
        assert unit.position("1") == 500

    run(main, inputs={"go": {"number": 1, "active": "low"}})


@pytest.mark.parametrize("way", ["disarm", "stop", "abort"])
def test_a_waiting_controller_is_disarmed_and_a_later_edge_moves_nothing(way: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 6000, wait())
        await driver.slots.present.verify()
        if way == "disarm":
            await driver.slots.unload()
        else:
            await driver.stop(abort=way == "abort")
            await driver.slots.unload()
        unit.set_input(1, level=True)
        await world.sleep(3000)
        assert not unit.commanded_motions
        reading = await driver.poll()
        assert not reading.axes["x"].position_lost  # it had not moved
        unit.set_input(1, level=False)
        _, _, outcome = await world.move(driver, 800)
        assert outcome.state == "done"

    run(main)


@pytest.mark.parametrize("after_ms", range(0, 180, 10))
def test_a_controller_that_is_restarted_while_it_is_armed_does_not_wait_for_its_trigger_line(after_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        lowered = driver.lower_profiles(await world.plan(driver, 6000), wait(), None)
        arming = asyncio.ensure_future(driver.slots.present.load(lowered, world.t0(lowered), None))
        await world.sleep(after_ms)
        await world.power_cycle(unit, 100)
        with pytest.raises((Refusal, ControllerFault)):
            await arming
        await sees_the_restart(driver)
        unit.set_input(1, level=True)
        await world.sleep(3000)
        assert not unit.commanded_motions

    run(main)


def test_a_missing_trigger_edge_is_reported_and_nothing_is_left_waiting() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 6000, wait())
        await driver.slots.present.verify()
        await driver.slots.present.release()
        assert not (await driver.slots.present.wait_for_start())["x"].seen
        outcome = await driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "go" in outcome.reason
        unit.set_input(1, level=True)
        await world.sleep(3000)
        assert not unit.commanded_motions

    run(main)


def test_a_power_cycle_before_the_edge_is_no_start_even_if_the_target_equals_the_power_up_position() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.move(driver, 500)
        _, t0_ns = await world.arm(driver, 0, wait())
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns - 80 * NS_PER_MS)
        await world.power_cycle(unit, 40)
        with pytest.raises(ControllerFault) as caught:
            await driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started"
        assert len(unit.commanded_motions) == 1

    run(main)


def test_a_waiting_controller_that_was_switched_off_is_not_promised() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 6000, wait())
        await world.power_cycle(unit, 200)
        await world.sleep(200)
        with pytest.raises(Refusal) as caught:
            await driver.slots.present.verify()
        assert caught.value.code == "not-armed"

    run(main)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("moves", [False, True])
def test_the_driven_line_is_active_at_t0_and_passive_again(seed: int, moves: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        edges: list[tuple[int, bool]] = []
        unit.on_output(lambda number, level: edges.append((world.clock.now_ns(), level)) if number == 2 else None)
        profiles = await world.plan(driver, 400) if moves else {}
        lowered = driver.lower_profiles(profiles, drive(300), None)
        t0_ns = world.t0(lowered)
        await driver.slots.present.load(lowered, t0_ns, None)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        spans = await driver.slots.present.wait_for_start()
        assert set(spans) == set(profiles)
        assert (await driver.slots.present.wait_for_end()).state == "done"
        (on_ns, on), (off_ns, off) = edges
        assert (on, off) == (True, False)
        low, high = window(lowered.edge)
        assert low <= on_ns - t0_ns <= high
        assert 290 * NS_PER_MS <= off_ns - on_ns <= 320 * NS_PER_MS
        if moves:
            low, high = window(lowered.terms)
            assert low <= unit.commanded_motions[0].start_ns - t0_ns <= high
            assert spans["x"].earliest_ns <= unit.commanded_motions[0].start_ns <= spans["x"].latest_ns

    run(main, seed=seed)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("moves", [False, True])
def test_a_stop_leaves_the_driven_line_passive(abort: bool, moves: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        profiles = await world.plan(driver, 20_000) if moves else {}
        lowered = driver.lower_profiles(profiles, drive(3000), None)
        t0_ns = world.t0(lowered)
        await driver.slots.present.load(lowered, t0_ns, None)
        await driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + 300 * NS_PER_MS)
        assert unit.output_level(2)
        await driver.stop(abort=abort)
        await world.sleep(lowered.costs.stop_ns / NS_PER_MS)
        assert not unit.output_level(2)
        assert unit.at_rest()

    run(main)


def test_nothing_is_driven_without_go_and_an_active_line_is_refused() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        lowered = driver.lower_profiles({}, drive(), None)
        t0_ns = world.t0(lowered)
        await driver.slots.present.load(lowered, t0_ns, None)
        await driver.slots.present.verify()
        await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
        assert not unit.output_level(2)
        await driver.slots.unload()
        await driver.set_output(2, on=True)
        with pytest.raises(Refusal) as caught:
            await driver.slots.present.load(lowered, world.t0(lowered), None)
        assert caught.value.code == "line-level"

    run(main)


def test_one_controller_of_a_bus_drives_the_trigger_line_that_the_others_wait_for() -> None:
    async def main(world: World) -> None:
        await world.ready()
        first, *others = world.drivers
        for each in others:
            world.units[first].on_output(
                lambda number, level, each=each: world.units[each].set_input(1, level=level) if number == 2 else None
            )
        ways = {first: drive(), **dict.fromkeys(others, wait())}
        lowered = {
            each: driver.lower_profiles(await world.plan(driver, 3000) if each != first else {}, ways[each], None)
            for each, driver in world.drivers.items()
        }
        t0_ns = world.t0(lowered[first])
        for each, driver in world.drivers.items():
            await driver.slots.present.load(lowered[each], t0_ns, None)
        await asyncio.gather(*(driver.slots.present.verify() for driver in world.drivers.values()))
        await asyncio.gather(*(driver.slots.present.release() for driver in world.drivers.values()))
        await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in world.drivers.values()))
        outcomes = await asyncio.gather(*(driver.slots.present.wait_for_end() for driver in world.drivers.values()))
        assert [outcome.state for outcome in outcomes] == ["done"] * 4
        starts = [world.units[each].commanded_motions[0].start_ns for each in others]
        assert max(starts) - min(starts) < 2 * NS_PER_MS

    run(main, (1, 2, 3, 7), {"input_poll_ms": 1.0})


def test_a_trigger_line_that_cannot_be_used_is_refused() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, _ = world.one
        profiles = await world.plan(driver, 500)
        both = StartOptions(wait=wait().wait, drive=drive().drive)
        for how in (wait("nothing"), StartOptions(start_class="clock"), StartOptions(start_class="line"), both):
            with pytest.raises(Refusal) as caught:
                driver.lower_profiles(profiles, how, None)
            assert caught.value.code == "start-class"
            assert caught.value.remedy
        # Where the line may be is part of the budget.
        late = TriggerWait(input="go", earliest_ns=0, latest_ns=NS_PER_MS)
        lowered = driver.lower_profiles(profiles, StartOptions(wait=late), None)
        assert (
            lowered.window_ns[1] - driver.lower_profiles(profiles, wait(), None).window_ns[1] == NS_PER_MS - WINDOW_NS
        )
        assert driver.lower_profiles(profiles, HOST, None).start_class == "host"

    run(main)


def test_a_waiting_controller_that_an_operator_stops_is_not_started() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 6000, wait())
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.send_raw("K")
        with pytest.raises(ControllerFault) as caught:
            await driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started"
        assert not unit.commanded_motions

    run(main)
