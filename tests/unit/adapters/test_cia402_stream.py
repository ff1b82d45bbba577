"""Jerk-limited moves as positions that follow each other with SYNC."""

import asyncio
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, cast

import pytest
from unit.adapters.cia402_bench import ACCELERATION, VELOCITY, Drives, config, profiles, run

from adapters.cia402 import MAKE
from adapters.cia402.canopen.bus import SHARED
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.shapes.course import SetpointTrajectory
from adapters.cia402.shapes.switching import OutputSchedule
from adapters.cia402.sync.stream import StreamedMove
from adapters.contract import DriverSetup, HostInterval, JogMove, MoveOutcome
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame, encode_frames
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step

JERK = 4e6
SMOOTH: dict[str, Any] = {"limits": {"velocity": VELOCITY, "acceleration": ACCELERATION, "jerk": JERK}}
PERIOD_NS = 10 * NS_PER_MS


def smooth(begin: int, end: int, slower: float = 1.0) -> dict[str, Profile]:
    plan = plan_step([AxisMove("a", begin, end, VELOCITY / 2, ACCELERATION / 2, JERK, order=3)])
    return dict(plan.stretch_to(plan.duration_s * slower).profiles)


async def released(world: Drives, moves: dict[int, dict[str, Profile]], after_ms: int = 300) -> int:
    """Armed and released for one T0, by number of the drive; T0."""
    t0_ns = world.clock.now_ns() + after_ms * NS_PER_MS
    for number, planned in moves.items():
        driver = world.drivers[number]
        await driver.slots.present.load(driver.lower_profiles(planned, StartOptions(), None), t0_ns, None)
        await driver.slots.present.verify()
    for number in moves:
        await world.drivers[number].slots.present.release()
    return t0_ns


async def followed(world: Drives, number: int = 0) -> tuple[HostInterval, MoveOutcome]:
    driver = world.drivers[number]
    span = (await driver.slots.present.wait_for_start())["a"]
    return span, await driver.slots.present.wait_for_end()


@pytest.mark.parametrize(("mode", "simulate"), [(8, {}), (7, {"modes": [1, 6, 7]})])
def test_a_smooth_move_is_followed_and_its_evidence_contains_the_truth(mode: int, simulate: dict[str, Any]) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        for begin, end in ((0, 40_000), (40_000, -3_000), (-3_000, -3_002)):
            profile = smooth(begin, end)["a"]
            lowered = world.driver.lower_profiles({"a": profile}, StartOptions(), None)
            assert lowered.mode == mode
            t0_ns = await released(world, {0: {"a": profile}})
            off = 0.0
            following = asyncio.get_running_loop().create_task(followed(world))
            at_ns = t0_ns
            while at_ns < t0_ns + lowered.durations_s["a"] * NS_PER_S:
                await world.until(at_ns)
                planned = begin + profile.state_at((at_ns - t0_ns) / NS_PER_S).position
                off = max(off, abs(world.unit.position("1") - planned))
                at_ns += NS_PER_MS
            span, outcome = await following
            motion = world.unit.commanded_motions[-1]
            assert outcome.state == "done", outcome.reason
            assert (motion.start_counts, motion.end_counts) == (begin, end)
            assert span.earliest_ns <= motion.start_ns <= span.latest_ns
            assert outcome.ended["a"].earliest_ns <= motion.end_ns <= outcome.ended["a"].latest_ns
            assert abs(motion.end_ns - motion.start_ns - lowered.durations_s["a"] * NS_PER_S) < 400_000
            # In addition to the bound of the lowering, the plan advances for as long as the SYNC is late.
            assert off <= lowered.path_error_counts["a"] + profile.peak_velocity * 400e-6
        assert len(world.unit.commanded_motions) == 3

    run(main, simulate=simulate, **SMOOTH)


def test_the_stream_starts_and_ends_with_the_plan() -> None:
    for end in (2, 3, 100, -2, -77, 40_000):
        for slower in (1.0, 1.37, 20.0):
            profile = smooth(0, end, slower)["a"]
            course = SetpointTrajectory(profile, PERIOD_NS)
            point = course.setpoint_function()
            told = [point(number) for number in range(-1, course.point_count + 1)]
            assert told[0] == 0 and told[-2:] == [end, end]
            assert course.point_count == 1 or (abs(told[1]) >= 1 and abs(told[-3]) < abs(end))
            ways = [after - before for before, after in pairwise(told)]
            assert all(way * end >= 0 for way in ways)
            assert 0 <= course.duration_s - profile.duration_s < PERIOD_NS / NS_PER_S + 1e-9
            whole = profile.stretch_time(course.duration_s / profile.duration_s)
            assert SetpointTrajectory(whole, PERIOD_NS).duration_s == pytest.approx(course.duration_s, abs=1e-12)


def test_a_part_that_replaces_one_which_has_not_begun_leaves_the_positions_before_it() -> None:
    """An override cuts the present chunk short, and the one behind that begins at the same instant."""

    def position_frame(position: int, outputs: int) -> int:
        del outputs
        return position

    node = cast(BusDrive, SimpleNamespace(outputs=0, position_frame=position_frame))
    present = SetpointTrajectory(smooth(0, 40_000)["a"], PERIOD_NS, is_chunk=True)
    brake, after = (
        SetpointTrajectory(smooth(20_000, end)["a"], PERIOD_NS, begin_s=0.2, is_chunk=True) for end in (21_000, 30_000)
    )
    move = StreamedMove(node, present, OutputSchedule(), lambda: None)
    for part in (brake, after, brake, after):
        move.continue_with(part, 20, OutputSchedule())
    planned = [*map(present.setpoint_function(), range(20)), *map(after.setpoint_function(), range(20, 60))]
    assert [move.position_frame(number) for number in range(60)] == planned
    # What is compared with the answers of the drive stays, and what follows takes the place of what was not sent.
    move.continue_with(brake, 60, OutputSchedule())
    assert [move.position_frame(number) for number in (50, 60, 70)] == [
        after.setpoint_function()(50),
        *map(brake.setpoint_function(), (60, 70)),
    ]


def _is(frame_id: int) -> bytes:
    return frame_id.to_bytes(4, "little")


def lose(world: Drives, frame_id: int, since_ns: int, count: int) -> None:
    """Lose the next `count` frames with this identifier, from `since_ns` on, on their way to the CAN controller."""
    left = count

    def lossy(data: bytes) -> bytes:
        nonlocal left
        kept = b""
        for at in range(0, len(data), 16):
            frame = data[at : at + 16]
            if left and world.clock.now_ns() >= since_ns and frame[:4] == _is(frame_id):
                left -= 1
            else:
                kept += frame
        return kept

    world.wire.to_far = lossy


def fastest(world: Drives, number: int = 0) -> "asyncio.Task[float]":
    """Watches the speed of a drive for a second."""

    async def watch() -> float:
        found = 0.0
        for _ in range(2000):
            found = max(found, abs(world.units[number].velocity("1")))
            await world.rest(0.5)
        return found

    return asyncio.get_running_loop().create_task(watch())


def test_a_single_lost_setpoint_causes_no_jump() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        profile = smooth(0, 20_000)["a"]
        t0_ns = await released(world, {0: {"a": profile}})
        watching = fastest(world)
        lose(world, 0x501, t0_ns + 300 * NS_PER_MS, 1)
        _, outcome = await followed(world)
        assert outcome.state == "done", outcome.reason
        # A little more than planned, because a SYNC may come a little early after one that was late.
        assert await watching < profile.peak_velocity * 1.1

    run(main, **SMOOTH)


def test_a_lost_setpoint_is_reported_as_an_underrun_and_the_drive_brakes() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000)})
        lose(world, 0x501, t0_ns + 300 * NS_PER_MS, 2)
        _, outcome = await followed(world)
        assert outcome.state == "fault"
        assert "underrun" in outcome.reason and "had no position with SYNC 3" in outcome.reason
        await world.rest(400)
        assert world.unit.at_rest()
        assert 0 < world.unit.position("1") < 40_000
        world.wire.to_far = None
        await another(world, 0)

    run(main, **SMOOTH)


async def another(world: Drives, number: int) -> None:
    """The drive can make its next move, from its present position."""
    here = (await world.drivers[number].poll()).axes["a"].commanded_counts
    await released(world, {number: smooth(here, here + 5_000)})
    _, outcome = await followed(world, number)
    assert outcome.state == "done", outcome.reason
    assert world.units[number].position("1") == here + 5_000


@pytest.mark.parametrize("mode", [7, 8])
def test_a_lost_sync_is_an_underrun_of_all_drives_and_none_continues(mode: int) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        lose(world, 0x080, t0_ns + 300 * NS_PER_MS, 1)
        for number, (_, outcome) in enumerate(await asyncio.gather(followed(world, 0), followed(world, 1))):
            assert outcome.state == "fault"
            assert "has not answered SYNC 3" in outcome.reason
            assert f"node {number + 1}" in outcome.reason
        syncs = world.syncs()
        await world.rest(400)
        assert world.syncs() - syncs <= 1  # what waits in the drives is taken away
        for number in (0, 1):
            assert world.units[number].at_rest()
            await another(world, number)

    run(main, count=2, simulate={"modes": [1, 6, mode]}, **SMOOTH)


def test_a_host_that_is_too_busy_is_reported_and_nothing_continues() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000)})
        world.late_ns = lambda at_ns: 3 * NS_PER_MS if at_ns > t0_ns + 300 * NS_PER_MS else 0
        _, outcome = await followed(world)
        assert outcome.state == "fault"
        assert "too busy (underrun)" in outcome.reason
        await world.rest(400)
        assert world.unit.at_rest()
        world.late_ns = lambda at_ns: 0
        await another(world, 0)

    run(main, **SMOOTH)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("when_ms", [-30, 5, 203, 399])
def test_a_stop_in_a_stream_brakes_by_the_axis_limits_and_leaves_nothing_waiting(when_ms: int, abort: bool) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        following = [asyncio.get_running_loop().create_task(followed(world, number)) for number in (0, 1)]
        await world.until(t0_ns + when_ms * NS_PER_MS)
        speed = abs(world.unit.velocity("1"))
        for driver in world.drivers:
            await driver.stop(abort=abort)
        stopped_ns = world.clock.now_ns()
        await asyncio.wait(following)
        for each in following:
            if when_ms > 0:
                assert each.result()[1].state == "stopped"
            else:
                assert each.exception() is not None
        await world.rest(300)
        assert all(unit.at_rest() for unit in world.units)
        if when_ms > 0:
            ramp_ns = speed / ACCELERATION * NS_PER_S
            assert world.unit.commanded_motions[-1].end_ns <= stopped_ns + ramp_ns + 2 * NS_PER_MS
        places = [unit.position("1") for unit in world.units]
        # A SYNC from any sender now moves nothing.
        link = await world.wire.open_link()
        link.write(encode_frames(CanFrame(0x080)))
        await world.rest(50)
        assert [unit.position("1") for unit in world.units] == places
        for driver in world.drivers:
            await driver.set_enabled(["a"], on=True)
        await another(world, 0)
        await another(world, 1)

    run(main, count=2, options={"quick_stop_acceleration": ACCELERATION}, **SMOOTH)


def test_a_drive_that_stops_does_not_delay_the_other() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        following = [asyncio.get_running_loop().create_task(followed(world, number)) for number in (0, 1)]
        await world.until(t0_ns + 300 * NS_PER_MS)
        await world.drivers[0].stop(abort=False)
        assert [(await each)[1].state for each in following] == ["stopped", "done"]
        assert world.units[1].position("1") == 40_000
        assert world.units[0].position("1") < 30_000
        await another(world, 0)

    run(main, count=2, **SMOOTH)


def test_a_drive_that_is_disarmed_before_its_stream_does_not_start_with_others() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        await world.until(t0_ns - 20 * NS_PER_MS)
        await world.drivers[0].slots.unload()
        _, outcome = await followed(world, 1)
        assert outcome.state == "done"
        assert not world.units[0].commanded_motions
        await another(world, 0)

    run(main, count=2, **SMOOTH)


def test_a_trapezoid_and_a_stream_start_by_one_sync_and_other_starts_wait() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        driver = world.drivers[1]
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: profiles(0, 40_000)})
        with pytest.raises(Refusal) as caught:
            await world.arm(2, 1000, t0_ns + 300 * NS_PER_MS)
        assert caught.value.code == "bus-busy"
        assert "streams positions" in caught.value.text
        ends = await asyncio.gather(followed(world, 0), followed(world, 1))
        assert [outcome.state for _, outcome in ends] == ["done", "done"]
        starts = [unit.commanded_motions[-1].start_ns for unit in world.units[:2]]
        assert abs(starts[0] - starts[1]) < 150_000
        for (span, outcome), unit in zip(ends, world.units, strict=False):
            assert span.earliest_ns <= unit.commanded_motions[-1].start_ns <= span.latest_ns
            assert outcome.ended["a"].earliest_ns <= unit.commanded_motions[-1].end_ns <= outcome.ended["a"].latest_ns
        # And the other way round, on the same drives.
        await released(world, {0: profiles(40_000, 0), 1: smooth(40_000, 0)})
        ends = await asyncio.gather(followed(world, 0), followed(world, 1))
        assert [outcome.state for _, outcome in ends] == ["done", "done"]
        await driver.jog_axis("a", JogMove(10_000, 100_000, 2_000))
        await world.rest(600)
        assert world.units[1].position("1") == 2_000

    run(main, count=3, **SMOOTH)


def test_a_drive_that_follows_no_positions_is_refused_with_a_remedy() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        assert world.driver.capabilities.orders == (2, 3)
        with pytest.raises(Refusal) as caught:
            world.driver.lower_profiles(smooth(0, 40_000), StartOptions(), None)
        assert caught.value.code == "jerk"
        assert "6502h" in caught.value.text and "remove `jerk`" in caught.value.remedy
        await world.go()
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"

    run(main, simulate={"modes": [1, 3, 6]}, **SMOOTH)


def test_more_than_the_bus_can_carry_is_refused() -> None:
    async def main(world: Drives) -> None:
        with pytest.raises(Refusal) as caught:
            world.driver.lower_profiles(smooth(0, 40_000), StartOptions(), None)
        assert caught.value.code == "bus-load"
        assert "period_ms" in caught.value.remedy

    run(main, count=8, options={"period_ms": 3}, **SMOOTH)


def test_drives_of_one_bus_with_different_periods_are_refused() -> None:
    async def main(world: Drives) -> None:
        its = config(2, {"period_ms": 20}, **SMOOTH)
        options = MAKE.options_model.model_validate(its.options)
        firer, shared = LoopTimedWriter(world.clock), {SHARED: world.shared[SHARED]}
        other = MAKE.create_driver(DriverSetup("d2", its, options, world.clock, world.wire.open_link, firer, shared))
        with pytest.raises(ControllerFault, match="period_ms"):
            await other.connect()

    run(main, **SMOOTH)


def test_a_host_that_dies_leaves_drives_that_brake_by_themselves() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000)})
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 300 * NS_PER_MS)
        world.wire.links[0].hang_up()
        with pytest.raises(LinkClosed):
            await world.driver.slots.present.wait_for_end()
        await world.rest(400)
        assert world.unit.at_rest()
        assert 0 < world.unit.position("1") < 40_000
        await world.driver.close()
        await world.driver.connect()
        await world.driver.configure()
        reading = await world.driver.poll()
        assert any("SYNC lost (8700h)" in fault.text for fault in reading.faults)
        await world.driver.clear_faults()
        await world.driver.set_enabled(["a"], on=True)
        await another(world, 0)

    run(main, **SMOOTH)


@pytest.mark.parametrize("before_ms", [150, 3])
def test_a_host_that_dies_before_its_start_leaves_nothing_that_a_later_sync_starts(before_ms: int) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        await world.until(t0_ns - before_ms * NS_PER_MS)
        world.wire.links[0].hang_up()
        await world.rest(100)
        for driver in world.drivers:
            await driver.close()
        for driver in world.drivers:
            await driver.connect()
            await driver.configure()
        link = await world.wire.open_link()
        link.write(encode_frames(CanFrame(0x080)))
        await world.rest(50)
        assert not any(unit.commanded_motions for unit in world.units)
        for number in (0, 1):
            await world.drivers[number].set_enabled(["a"], on=True)
            await another(world, number)

    run(main, count=2, **SMOOTH)


@pytest.mark.parametrize("trouble", ["power", "fault", "bus-off", "cut"])
def test_a_fault_of_a_drive_in_its_stream_is_reported(trouble: str) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        following = [asyncio.get_running_loop().create_task(followed(world, number)) for number in (0, 1)]
        await world.until(t0_ns + 300 * NS_PER_MS)
        if trouble == "power":
            world.unit.set_power(on=False)
        elif trouble == "fault":
            world.unit.station.drive.enter_fault(0x4310, 0)
        elif trouble == "bus-off":
            world.bus._nodes[-1].count_errors(transmit=256)
        else:
            world.bus.cut = True
        _, outcome = await following[0]
        assert outcome.state == "fault"
        words = {"power": "has not answered", "fault": "(4310h)", "bus-off": "bus-off", "cut": "has not answered"}
        assert words[trouble] in outcome.reason
        if trouble in ("power", "fault"):
            # The caller that has started both stops the other one.
            await world.drivers[1].stop(abort=False)
        assert (await following[1])[1].state in ("fault", "stopped")
        await world.rest(600)
        assert all(unit.at_rest() for unit in world.units)

    run(main, count=2, **SMOOTH)
