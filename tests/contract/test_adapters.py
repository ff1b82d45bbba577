"""The contract of adapters, over every make and link: the guarantees of a driver, judged by the simulator's ground
truth."""

import asyncio
import contextlib
from typing import get_args

import pytest
from adapter_worlds import CASES, World, evidence_holds, motions, run

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions, TriggerDrive, TriggerWait
from orchestrator.model.state import StartClass

pytestmark = pytest.mark.parametrize("name", CASES)

TARGETS = (23_456, -12_345)


def targets(world: World, factor: float = 1.0) -> dict[str, float]:
    return {axis: round(target * factor) for axis, target in zip(world.axes, TARGETS, strict=False)}


def test_connected_identified_compared_and_read(name: str) -> None:
    async def main(world: World) -> None:
        identity = await world.driver.connect()
        assert identity.model
        await world.driver.configure()
        reading = await world.driver.poll()
        assert list(reading.axes) == world.axes
        assert not reading.restarted
        capabilities = world.driver.capabilities
        assert capabilities.start_classes
        assert 2 in capabilities.orders
        assert min(capabilities.costs.arm_ns, capabilities.costs.disarm_ns, capabilities.costs.stop_ns) > 0
        # Reached again, while nothing is wrong, it is the same.
        await world.leave()
        assert await world.driver.connect() == identity

    run(name, main)


def test_motors_are_switched_and_axes_homed(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_enabled(world.axes, on=False)
        assert not any(axis.enabled for axis in (await world.driver.poll()).axes.values())
        with pytest.raises(Refusal, match="enable"):
            await world.driver.home_axes(world.axes, lambda _: None)
        assert not world.motions
        await world.driver.set_enabled(world.axes, on=True)
        assert all(axis.enabled for axis in (await world.driver.poll()).axes.values())
        found: list[str] = []
        assert await world.driver.home_axes(world.axes, found.append) == {}
        assert sorted(found) == sorted(world.axes)
        assert world.at_rest
        assert all(axis.commanded_counts == 0 for axis in (await world.driver.poll()).axes.values())

    run(name, main)


@pytest.mark.parametrize(("seed", "ppm"), [(0, -100.0), (1, 100.0), (2, 0.0), (3, 100.0)])
def test_a_step_does_what_was_lowered_and_its_evidence_contains_the_truth(name: str, seed: int, ppm: float) -> None:
    async def main(world: World) -> None:
        await world.ready(60)
        for factor in (1.0, -0.4, 2.0):
            before = len(world.motions)
            lowered, started, outcome, t0_ns, profiles = await world.move(targets(world, factor))
            assert outcome.state == "done", outcome
            made = motions(world, before)
            evidence_holds(world, started, {axis: made[axis].start_ns for axis in made}, "start")
            evidence_holds(world, outcome.ended, {axis: made[axis].end_ns for axis in made}, "end")
            earliest_ns = sum(term.earliest_ns for term in lowered.terms)
            latest_ns = sum(term.latest_ns for term in lowered.terms)
            for axis, motion in made.items():
                assert earliest_ns <= motion.start_ns - t0_ns <= latest_ns
                assert motion.end_counts == profiles[axis].end_counts
            positions = {axis: reading.commanded_counts for axis, reading in (await world.driver.poll()).axes.items()}
            assert positions == {axis: profile.end_counts for axis, profile in profiles.items()}

    run(name, main, seed, ppm)


@pytest.mark.parametrize("ppm", [-100.0, 0.0, 100.0])
def test_a_step_can_start_sooner_than_it_was_armed_for(name: str, ppm: float) -> None:
    async def main(world: World) -> None:
        await world.ready(60)
        for factor in (1.0, -0.4):
            before = len(world.motions)
            profiles = await world.plan(targets(world, factor))
            lowered, armed_for_ns = await world.arm(profiles)
            if not lowered.can_advance:
                pytest.skip("this make begins when it was armed to")
            tick_ns = lowered.tick_ns or 1.0
            sooner_ns = round(100 * NS_PER_MS // tick_ns * tick_ns)
            await world.driver.verify_armed()
            await world.driver.go(0, sooner_ns)
            started, outcome = await world.driver.wait_for_start(), await world.driver.wait_for_end()
            assert outcome.state == "done", outcome
            made = motions(world, before)
            evidence_holds(world, started, {axis: made[axis].start_ns for axis in made}, "start")
            evidence_holds(world, outcome.ended, {axis: made[axis].end_ns for axis in made}, "end")
            earliest_ns = sum(term.earliest_ns for term in lowered.terms) - 1
            latest_ns = sum(term.latest_ns for term in lowered.terms) + 1
            for axis, motion in made.items():
                assert earliest_ns <= motion.start_ns - (armed_for_ns - sooner_ns) <= latest_ns
                assert motion.end_counts == profiles[axis].end_counts

    run(name, main, 0, ppm)


def test_lowering_is_pure_and_refuses_what_it_cannot_do(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        profiles, mapping = await world.plan(targets(world)), world.driver.clock_mapping()
        assert world.driver.lower_profiles(profiles, StartOptions(), mapping) == world.driver.lower_profiles(
            profiles, StartOptions(), mapping
        )
        assert world.driver.lower_profiles(profiles, StartOptions(), mapping).commands
        for by in set(get_args(StartClass)) - {"line"}:  # which needs a wire
            if by in world.driver.capabilities.start_classes:
                assert world.driver.lower_profiles(profiles, StartOptions(start_class=by), mapping).start_class == by
            else:
                with pytest.raises(Refusal) as caught:
                    world.driver.lower_profiles(profiles, StartOptions(start_class=by), mapping)
                assert caught.value.code == "start-class"
                assert caught.value.remedy
        assert not world.motions

    run(name, main)


@pytest.mark.parametrize("seed", range(3))
def test_a_move_waits_for_its_line_and_its_evidence_contains_the_truth(name: str, seed: int) -> None:
    async def main(world: World) -> None:
        world.line(False)
        await world.ready(60)
        if "line" not in world.driver.capabilities.start_classes:
            pytest.skip("this make can not wait for an input")
        window_ns = NS_PER_MS
        how = StartOptions(wait=TriggerWait(input="line", earliest_ns=-window_ns, latest_ns=window_ns))
        for factor in (1.0, -0.4):
            before = len(world.motions)
            profiles = await world.plan(targets(world, factor))
            lowered, t0_ns = await world.arm(profiles, how)
            assert lowered.start_class == "line"
            await world.driver.verify_armed()
            await world.driver.go()
            assert world.at_rest
            edge_ns = t0_ns + world.draw.randrange(-window_ns, window_ns)
            await world.until(edge_ns)
            assert world.at_rest
            world.line(True)
            started = await world.driver.wait_for_start()
            outcome = await world.driver.wait_for_end()
            assert outcome.state == "done", outcome
            made = motions(world, before)
            evidence_holds(world, started, {axis: made[axis].start_ns for axis in made}, "start")
            evidence_holds(world, outcome.ended, {axis: made[axis].end_ns for axis in made}, "end")
            path = [term for term in lowered.terms if term.name != "line"]
            for motion in made.values():
                after_ns = motion.start_ns - edge_ns
                assert sum(term.earliest_ns for term in path) <= after_ns <= sum(term.latest_ns for term in path)
            world.line(False)

    run(name, main, seed)


def test_a_line_that_is_active_already_is_refused_and_a_disarmed_move_does_not_wait_for_it(name: str) -> None:
    async def main(world: World) -> None:
        world.line(False)
        await world.ready()
        if "line" not in world.driver.capabilities.start_classes:
            pytest.skip("this make can not wait for an input")
        how = StartOptions(wait=TriggerWait(input="line", earliest_ns=0, latest_ns=NS_PER_MS))
        profiles = await world.plan(targets(world))
        world.line(True)
        with pytest.raises(Refusal) as caught:
            await world.arm(profiles, how)
        assert caught.value.code == "line-level" and caught.value.remedy
        await world.driver.disarm_move()
        world.line(False)
        for released in (False, True):
            await sleep_ns(world.clock, 2 * NS_PER_MS)  # the input's optocoupler
            await world.arm(profiles, how)
            await world.driver.verify_armed()
            if released:
                await world.driver.go()
                await world.driver.stop(abort=False)
            await world.driver.disarm_move()
            world.line(True)
            await sleep_ns(world.clock, NS_PER_S)
            assert not world.motions
            world.line(False)
        with pytest.raises(Refusal) as caught:
            world.driver.lower_profiles(
                profiles, StartOptions(wait=how.wait and how.wait.model_copy(update={"input": "other"})), None
            )

    run(name, main)


def test_a_line_is_driven_at_its_instant_and_released(name: str) -> None:
    async def main(world: World) -> None:
        world.line(False)
        await world.ready(60)
        hold_ns = 50 * NS_PER_MS
        how = StartOptions(drive=TriggerDrive(output="line", active_ns=hold_ns))
        changes: list[tuple[int, bool]] = []
        for unit in world.units:
            unit.controller.on_output(lambda number, level: changes.append((world.clock.now_ns(), level)))
        for moves in (False, True):
            changes.clear()
            before = len(world.motions)
            profiles = await world.plan(targets(world)) if moves else {}
            lowered, t0_ns = await world.arm(profiles, how)
            assert lowered.edge
            await world.driver.verify_armed()
            await world.driver.go()
            assert not changes
            assert (await world.driver.wait_for_start()).keys() == profiles.keys()
            assert (await world.driver.wait_for_end()).state == "done"
            await world.until(t0_ns + 4 * hold_ns)
            assert [level for _, level in changes] == [True, False]
            (edge_ns, _), (released_ns, _) = changes
            earliest_ns = sum(term.earliest_ns for term in lowered.edge)
            assert earliest_ns <= edge_ns - t0_ns <= sum(term.latest_ns for term in lowered.edge)
            assert released_ns - edge_ns >= hold_ns * 0.99
            assert len(world.motions) - before == len(profiles)
        changes.clear()
        await world.arm({}, how)
        await world.driver.disarm_move()
        lowered, t0_ns = await world.arm({}, how)
        await world.driver.verify_armed()
        await world.driver.go()
        await world.driver.stop(abort=False)
        await world.until(t0_ns + NS_PER_S)
        assert not any(level for _, level in changes)

    run(name, main)


@pytest.mark.parametrize("stage", ["arm", "verify", "go"])
def test_a_disarmed_move_never_starts(name: str, stage: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        before = world.positions()
        lowered, t0_ns = await world.arm(await world.plan(targets(world)))
        if stage != "arm":
            await world.driver.verify_armed()
        if stage == "go":
            await world.driver.go()
        await world.until(min(t0_ns - lowered.costs.disarm_ns, world.clock.now_ns() + 30 * NS_PER_MS))
        await world.driver.disarm_move()
        await world.driver.disarm_move()
        await world.until(t0_ns + 3 * NS_PER_S)
        assert world.positions() == before
        assert world.at_rest
        _, _, outcome, _, _ = await world.move(targets(world))
        assert outcome.state == "done"

    run(name, main)


def test_nothing_starts_without_go(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        before = world.positions()
        _, t0_ns = await world.arm(await world.plan(targets(world)))
        await world.driver.verify_armed()
        await world.until(t0_ns + 3 * NS_PER_S)
        assert world.positions() == before
        await world.driver.disarm_move()
        _, _, outcome, _, _ = await world.move(targets(world))
        assert outcome.state == "done"

    run(name, main)


@pytest.mark.parametrize(
    "when_ms", [-400, -10, 3, 400, *(pytest.param(n, marks=pytest.mark.nightly) for n in (-60, 90))]
)
def test_a_stop_at_any_moment_stops_all_in_the_declared_time(name: str, when_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        for abort, factor in ((False, 1.0), (True, -0.4)):
            lowered, t0_ns = await world.arm(await world.plan(targets(world, 4)))
            await world.driver.verify_armed()
            await world.driver.go()
            following = asyncio.get_running_loop().create_task(follow(world))
            await world.until(max(world.clock.now_ns(), t0_ns + when_ms * NS_PER_MS))
            await world.driver.stop(abort=abort)
            await sleep_ns(world.clock, lowered.costs.stop_ns)
            assert world.at_rest
            rests = world.positions()
            await following
            await world.until(max(world.clock.now_ns(), t0_ns) + 2 * NS_PER_S)
            assert world.positions() == rests
            await world.driver.clear_faults()
            await world.driver.set_enabled(world.axes, on=True)
            await world.poll(5)
            _, _, outcome, _, _ = await world.move(targets(world, factor))
            assert outcome.state == "done"

    run(name, main, seed=when_ms)


@pytest.mark.parametrize(
    "when_ms", [0, 4, 16, 40, 130, *(pytest.param(n, marks=pytest.mark.nightly) for n in (1, 9, 25, 70))]
)
def test_a_stop_at_any_moment_ends_a_homing_or_prevents_its_start(name: str, when_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        found: list[str] = []
        searching = asyncio.get_running_loop().create_task(world.driver.home_axes(world.axes, found.append))
        await sleep_ns(world.clock, when_ms * NS_PER_MS + 1)
        if searching.done():
            return  # a drive whose reference is its present position
        stopped_ns = world.clock.now_ns()
        await world.driver.stop(abort=False)
        with contextlib.suppress(Refusal):
            failed = await searching
            assert sorted([*found, *failed]) == sorted(world.axes)
        await sleep_ns(world.clock, 3 * NS_PER_S)
        assert world.at_rest
        # Bytes that were on the line before the stop may still start a motion, which the stop after them ends.
        assert not [motion for _, motion in world.motions if motion.start_ns > stopped_ns + 100 * NS_PER_MS]
        await world.driver.clear_faults()
        await world.driver.set_enabled(world.axes, on=True)
        await world.poll(5)
        assert await world.driver.home_axes(world.axes, found.append) == {}

    run(name, main, seed=when_ms)


async def follow(world: World) -> None:
    """Wait for the start and the end of a motion, whatever they are, as every caller that has started one does."""
    with contextlib.suppress(ControllerFault, Refusal):
        await world.driver.wait_for_start()
        assert (await world.driver.wait_for_end()).state != "done"


def test_polls_during_a_step_disturb_nothing(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        profiles = await world.plan(targets(world, 3))
        _, t0_ns = await world.arm(profiles)
        await world.driver.verify_armed()
        await world.driver.go()

        async def poll() -> None:
            await world.until(t0_ns + NS_PER_MS)  # nothing polls a member just before T0
            while True:
                await world.poll(1)

        polling = asyncio.get_running_loop().create_task(poll())
        started = await world.driver.wait_for_start()
        outcome = await world.driver.wait_for_end()
        polling.cancel()
        assert outcome.state == "done", outcome
        assert all(times > 20 for times in world.polled_beside.values()), world.polled_beside
        made = motions(world, 0)
        evidence_holds(world, started, {axis: made[axis].start_ns for axis in made}, "start")
        evidence_holds(world, outcome.ended, {axis: made[axis].end_ns for axis in made}, "end")

    run(name, main)


def test_a_jog_keeps_to_its_speed_and_its_end(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        axis, *others = world.axes
        config = world.axis(axis)
        speed, ramp = config.limits.velocity * float(config.scale) / 4, config.limits.acceleration * float(config.scale)
        end = round(speed)
        await world.driver.jog_axis(axis, JogMove(speed, ramp, end))
        fastest = 0.0
        for _ in range(300):
            await sleep_ns(world.clock, 10 * NS_PER_MS)
            fastest = max(fastest, abs(world.velocity(axis)))
            assert world.position(axis) <= end
        assert 0.8 * speed < fastest <= speed * (1 + 1e-4)  # as fast as its crystal is
        assert world.position(axis) == end
        await world.driver.jog_axis(axis, JogMove(-speed, ramp, None))
        for other in others:
            await world.driver.jog_axis(other, JogMove(speed, ramp, None))
        await sleep_ns(world.clock, 300 * NS_PER_MS)
        await world.driver.stop_axes([axis])
        await sleep_ns(world.clock, 400 * NS_PER_MS)
        assert not world.moving(axis)
        assert all(world.moving(other) for other in others)
        await world.driver.stop(abort=False)
        await world.rest(world.driver.capabilities.costs.stop_ns)
        await world.poll(3)
        _, _, outcome, _, _ = await world.move(targets(world))
        assert outcome.state == "done"

    run(name, main)


@pytest.mark.parametrize("call", ["connect", "configure", "poll", "enable", "home", "arm", "verify", "set_output"])
def test_the_link_of_a_silent_controller_is_closed_in_time(name: str, call: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        profiles = await world.plan(targets(world))
        mapping = world.driver.clock_mapping()
        lowered = world.driver.lower_profiles(profiles, StartOptions(), mapping)
        t0_ns = world.clock.now_ns() + 3 * NS_PER_S
        if call == "verify":
            await world.driver.arm_move(lowered, t0_ns, mapping)
        world.hit.wire.cut = True
        calls = {
            "connect": lambda: world.driver.connect(),
            "configure": lambda: world.driver.configure(),
            "poll": lambda: world.driver.poll(),
            "enable": lambda: world.driver.set_enabled(world.axes, on=False),
            "home": lambda: world.driver.home_axes(world.axes, lambda _: None),
            "arm": lambda: world.driver.arm_move(lowered, t0_ns, mapping),
            "verify": lambda: world.driver.verify_armed(),
            "set_output": lambda: world.driver.set_output(1, on=True),
        }
        began_ns = world.clock.now_ns()
        with pytest.raises((ControllerFault, LinkClosed, LinkRefused)) as caught:
            await calls[call]()
        assert world.clock.now_ns() - began_ns < 10 * NS_PER_S
        if isinstance(caught.value, ControllerFault):
            assert caught.value.remedy
        world.hit.wire.cut = False
        await world.leave()
        await world.driver.connect()
        await world.driver.configure()
        await world.driver.disarm_move()
        await world.poll(5)
        assert world.at_rest

    run(name, main)


@pytest.mark.parametrize("seed", range(4))
def test_noise_is_reported_and_survived(name: str, seed: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        before = world.positions()

        def garble(data: bytes) -> bytes:
            return bytes(world.draw.randrange(256) if world.draw.random() < 0.2 else each for each in data)

        world.hit.wire.to_near = garble
        wrong = 0
        for _ in range(20):
            try:
                await world.driver.poll()
            except (ControllerFault, LinkClosed, LinkRefused):
                wrong += 1
                await world.leave()
                with contextlib.suppress(ControllerFault, LinkClosed, LinkRefused):
                    await world.driver.connect()
        assert wrong
        world.hit.wire.to_near = None
        await world.leave()
        await sleep_ns(world.clock, NS_PER_S)
        await world.driver.connect()
        await world.driver.configure()
        reading = await world.driver.poll()
        assert {axis: each.commanded_counts for axis, each in reading.axes.items()} == before
        assert world.positions() == before

    run(name, main, seed)


def test_a_power_cycle_is_noticed_and_leaves_nothing_armed(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        await world.arm(await world.plan(targets(world)))
        await world.driver.verify_armed()
        await world.driver.go()
        world.hit.controller.set_power(on=False)
        await sleep_ns(world.clock, NS_PER_S)
        world.hit.controller.set_power(on=True)
        await sleep_ns(world.clock, 5 * NS_PER_S)
        noticed = False
        for _ in range(5):
            try:
                noticed = noticed or (await world.driver.poll()).restarted
            except (ControllerFault, LinkClosed, LinkRefused):
                # Its links are lost with it; after that it is queried again.
                await world.leave()
                await world.driver.connect()
                await world.driver.configure()
        assert noticed
        assert world.at_rest
        assert not any(motion.end_counts != motion.start_counts for motion in world.hit.controller.commanded_motions)
        await world.driver.set_enabled(world.axes, on=True)
        await world.poll(40)
        _, _, outcome, _, _ = await world.move(targets(world))
        assert outcome.state == "done"

    run(name, main)


def test_a_power_cycle_while_disconnected_is_noticed_once(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        assert await world.driver.home_axes(world.axes, lambda _: None) == {}
        _, _, outcome, _, _ = await world.move(targets(world))
        assert outcome.state == "done"
        before, positions = world.places(), world.positions()
        await world.leave()
        world.hit.controller.set_power(on=False)
        await sleep_ns(world.clock, NS_PER_S)
        world.hit.controller.set_power(on=True)
        await sleep_ns(world.clock, 5 * NS_PER_S)
        # The axes stand where they did, though their controllers report another position now.
        assert world.places() == pytest.approx(before, abs=1) and world.positions() != positions
        for noticed in (True, False):
            # A detected restart is reported although the link breaks before the next poll.
            for _ in range(2 if noticed else 1):
                await world.driver.connect()
                await world.driver.configure()
                await world.leave()
            await world.driver.connect()
            await world.driver.configure()
            assert [(await world.driver.poll()).restarted for _ in range(3)] == [noticed, False, False]
            await world.leave()

    run(name, main)


def test_a_controller_that_is_moved_by_others_is_not_stopped_by_connecting(name: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await world.arm(await world.plan(targets(world, 2)))
        await world.driver.verify_armed()
        await world.driver.go()
        await world.until(t0_ns + 200 * NS_PER_MS)
        await world.leave()
        try:
            await world.driver.connect()
        except ControllerFault as error:
            assert error.remedy
        await world.rest(60 * NS_PER_S)
        if CASES[name].led:
            # It received no further setpoints, and needs no reset for that.
            assert all(0 < abs(place) < abs(targets(world, 2)[axis]) for axis, place in world.positions().items())
            await world.driver.configure()
            assert all(axis.enabled for axis in (await world.driver.poll()).axes.values())
        else:
            # It went where it was going.
            assert world.positions() == targets(world, 2)

    run(name, main)
