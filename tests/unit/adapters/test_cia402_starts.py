"""One SYNC starts the drives of a step, and never those of another."""

import asyncio

import pytest
from unit.adapters.cia402_bench import Drives, config, run

from adapters.cia402 import MAKE
from adapters.contract import JogMove, Lowered
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.plan.step import AxisMove, plan_step


def test_one_sync_starts_all_drives_of_a_step() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
        for number in range(4):
            await world.arm(number, 20_000, t0_ns)
        for driver in world.drivers:
            await driver.slots.present.release()
        before_ns = world.clock.now_ns()
        spans = await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in world.drivers))
        outcomes = await asyncio.gather(*(driver.slots.present.wait_for_end() for driver in world.drivers))
        assert [each.state for each in outcomes] == ["done"] * 4
        assert world.syncs(before_ns) == 1
        starts = [unit.commanded_motions[-1].start_ns for unit in world.units]
        assert max(starts) - min(starts) <= 150_000
        for span, start_ns in zip(spans, starts, strict=True):
            assert span["a"].earliest_ns <= start_ns <= span["a"].latest_ns

    run(main, count=4)


@pytest.mark.parametrize("released", [False, True])
def test_a_disarmed_drive_does_not_start_with_the_others(released: bool) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
        for number in range(2):
            await world.arm(number, 20_000, t0_ns)
        await world.drivers[1].slots.present.release()
        if released:
            await world.drivers[0].slots.present.release()
            await world.rest(5)
        await world.drivers[0].slots.unload()
        await world.drivers[1].slots.present.wait_for_start()
        assert (await world.drivers[1].slots.present.wait_for_end()).state == "done"
        assert not world.units[0].commanded_motions
        assert world.units[1].position("1") == 20_000
        # Nor with a later SYNC of others.
        t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
        await world.arm(1, 0, t0_ns, begin=20_000)
        await world.drivers[1].slots.present.release()
        await world.drivers[1].slots.present.wait_for_start()
        assert (await world.drivers[1].slots.present.wait_for_end()).state == "done"
        assert not world.units[0].commanded_motions

    run(main, count=2)


def test_a_released_step_that_is_disarmed_alone_leaves_nothing_waiting() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(after_ms=300)
        await world.rest(5)
        await world.driver.slots.unload()
        await world.until(t0_ns + 500 * NS_PER_MS)
        # A SYNC from any sender now starts nothing.
        link = await world.wire.open_link()
        link.write(bytes.fromhex("80000000") + bytes(12))
        await world.rest(500)
        assert not world.unit.commanded_motions

    run(main)


def test_steps_of_one_bus_start_one_after_another_each_with_its_own_sync() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
        await world.arm(0, 20_000, t0_ns)
        with pytest.raises(Refusal) as caught:
            await world.arm(1, 20_000, t0_ns + 5 * NS_PER_MS)
        assert caught.value.code == "bus-busy"
        assert caught.value.remedy
        await world.arm(1, 20_000, t0_ns + 50 * NS_PER_MS)
        # The later one is released first: its set-point must not be taken by the earlier SYNC.
        await world.drivers[1].slots.present.release()
        await world.drivers[0].slots.present.release()
        spans = await asyncio.gather(*(driver.slots.present.wait_for_start() for driver in world.drivers))
        await asyncio.gather(*(driver.slots.present.wait_for_end() for driver in world.drivers))
        starts = [unit.commanded_motions[-1].start_ns for unit in world.units]
        assert 48 * NS_PER_MS < starts[1] - starts[0] < 52 * NS_PER_MS
        for span, start_ns in zip(spans, starts, strict=True):
            assert span["a"].earliest_ns <= start_ns <= span["a"].latest_ns

    run(main, count=2)


def test_a_lost_sync_is_reported_and_nothing_moves() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.go()
        world.wire.to_far = lambda data: b"" if data[:4] == bytes.fromhex("80000000") else data
        with pytest.raises(ControllerFault) as caught:
            await world.driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started"
        assert "SYNC" in caught.value.text
        assert caught.value.remedy
        await world.driver.stop(abort=False)
        await world.driver.slots.unload()
        world.wire.to_far = None
        assert not world.unit.commanded_motions
        # The next start does not make up for the lost one.
        await world.rest(200)
        await world.go(target=-10_000)
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"
        assert [motion.end_counts for motion in world.unit.commanded_motions] == [-10_000]

    run(main)


def test_another_client_stops_a_moving_drive_with_the_makes_stop_bytes() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=400_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 1000 * NS_PER_MS)
        assert world.unit.is_moving("1")
        link = await world.wire.open_link()
        link.write(MAKE.stop_bytes(config(1)))
        await world.rest(300)
        assert not world.unit.is_moving("1")
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "another master" in outcome.reason

    run(main)


def test_stop_bytes_overwrite_setpoints_that_wait_for_a_sync() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.go()
        await world.rest(5)
        link = await world.wire.open_link()
        link.write(MAKE.stop_bytes(config(1)))
        with pytest.raises(ControllerFault):
            await world.driver.slots.present.wait_for_start()
        assert not world.unit.commanded_motions

    run(main)


def test_a_drive_that_is_stopped_before_the_start_of_others_is_not_halted_by_their_sync() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = world.clock.now_ns() + 400 * NS_PER_MS
        for number in range(2):
            await world.arm(number, 20_000, t0_ns)
        for driver in world.drivers:
            await driver.slots.present.release()
        await world.rest(5)
        with pytest.raises(Refusal) as caught:
            await world.drivers[0].set_output(1, on=True)
        assert caught.value.code == "busy"
        await world.drivers[0].stop(abort=False)
        await world.rest(50)
        await world.drivers[0].jog_axis("a", JogMove(10_000, 100_000, None))
        await world.drivers[1].slots.present.wait_for_start()
        await world.drivers[1].slots.present.wait_for_end()
        # It had received a halt, in a controlword that may still have waited for that SYNC.
        assert world.units[0].velocity("1") == pytest.approx(10_000, rel=1e-3)
        await world.drivers[0].stop(abort=False)

    run(main, count=2)


def test_the_end_of_a_move_from_between_two_counts_is_known_no_better_than_half_a_count() -> None:
    """A drive that was stopped reports the nearer count; a slow move shows the difference."""

    async def main(world: Drives) -> None:
        await world.ready()
        for stopped_ms in (73, 111, 140):
            here = (await world.driver.poll()).axes["a"].commanded_counts
            t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
            await world.arm(0, here + 40_000, t0_ns, here)
            await world.driver.slots.present.release()
            await world.until(t0_ns + stopped_ms * NS_PER_MS)
            await world.driver.stop(abort=False)
            await world.rest(500)
            await world.driver.slots.unload()
            here = (await world.driver.poll()).axes["a"].commanded_counts
            assert 0.05 < abs(world.unit.position("1") - here) <= 0.5
            slow = dict(plan_step([AxisMove("a", here, here + 20, 20.0, 4000.0)]).profiles)
            t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
            await world.driver.slots.present.load(world.driver.lower_profiles(slow, StartOptions(), None), t0_ns, None)
            await world.driver.slots.present.verify()
            await world.driver.slots.present.release()
            await world.driver.slots.present.wait_for_start()
            ended = (await world.driver.slots.present.wait_for_end()).ended["a"]
            assert ended.earliest_ns <= world.unit.commanded_motions[-1].end_ns <= ended.latest_ns

    run(main)


AT_ONCE = StartOptions(follows=True, at_once=True)


def lower_at_once(world: Drives, number: int, begin: int, end: int) -> Lowered:
    plan = plan_step([AxisMove("a", begin, end, 20_000, 200_000)])
    lowered = world.drivers[number].lower_profiles(dict(plan.profiles), AT_ONCE, None)
    assert lowered.release_ns is not None and lowered.can_advance
    return lowered


@pytest.mark.parametrize("other_ms", [None, 300])
def test_a_step_at_once_gets_a_sync_of_its_own_for_an_earlier_t0(other_ms: int | None) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        clock, driver = world.clock, world.driver
        if other_ms is not None:  # another drive of the bus waits for its own
            await world.arm(1, 20_000, clock.now_ns() + other_ms * NS_PER_MS)
        lowered = lower_at_once(world, 0, 0, 5000)
        t0_ns = clock.now_ns() + 400 * NS_PER_MS
        await driver.slots.present.load(lowered, t0_ns, None, "at once")
        early_ns = clock.now_ns() + (lowered.release_ns or 0)
        await driver.slots.present.release(advance_ns=t0_ns - early_ns)
        span = (await driver.slots.present.wait_for_start())["a"]
        assert (await driver.slots.present.wait_for_end()).state == "done"
        start_ns = world.units[0].commanded_motions[-1].start_ns
        assert span.earliest_ns <= start_ns <= span.latest_ns
        assert abs(start_ns - early_ns) < NS_PER_MS
        assert other_ms is None or not world.units[1].commanded_motions

    run(main, count=2)


def test_an_earlier_t0_beside_the_sync_of_another_drive_is_refused() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        clock, driver = world.clock, world.driver
        other_ns = clock.now_ns() + 100 * NS_PER_MS
        await world.arm(1, 20_000, other_ns)
        lowered = lower_at_once(world, 0, 0, 5000)
        await driver.slots.present.load(lowered, other_ns + 100 * NS_PER_MS, None, "at once")
        with pytest.raises(Refusal) as caught:
            await driver.slots.present.release(advance_ns=95 * NS_PER_MS)
        assert caught.value.code == "bus-busy"
        await driver.slots.unload()
        await world.until(other_ns + NS_PER_S)
        assert not world.units[0].commanded_motions

    run(main, count=2)
