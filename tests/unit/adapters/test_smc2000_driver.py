"""The SMC-2000's driver against the simulated controller, in virtual time; verdicts by the simulator's truth."""

import re
from random import Random

import pytest
from unit.adapters.test_smc2000_bench import World, run, trapezoid
from unit.random_rounds import share_with_nightly

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile


def test_a_step_runs_from_connect_to_its_outcome():
    async def main(world: World) -> None:
        identity = await world.driver.connect()
        assert (identity.model, identity.firmware, identity.serial) == ("SMC-2000-4", "Rev 2.0g", "1")
        await world.ready(connect=False)
        profiles = {"x": trapezoid(0, 40_000, 80_000, 700_000), "y": trapezoid(0, -20_000, 40_000, 350_000)}
        lowered, started, outcome, t0_ns = await world.moved(profiles)
        assert outcome.state == "done", outcome
        motions = {motion.axis: motion for motion in world.controller.commanded_motions}
        for axis, letter in (("x", "X"), ("y", "Y")):
            motion = motions[letter]
            assert started[axis].earliest_ns <= motion.start_ns <= started[axis].latest_ns
            assert outcome.ended[axis].earliest_ns <= motion.end_ns <= outcome.ended[axis].latest_ns
            off_ns = motion.start_ns - t0_ns
            assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
            assert motion.end_counts == profiles[axis].end_counts

    run(main)


@pytest.mark.parametrize(
    ("told", "read"), [(b"XLI=", "XLI"), (b"SP ", "_SPX"), (b"AC ", "_ACX"), (b"DC ", "_DCX"), (b"PA ", "_PRX")]
)
def test_a_value_with_a_garbled_digit_refuses_the_step(told: bytes, read: str):
    def garble(data: bytes) -> bytes:
        return re.sub(rb"(%s)(\d)" % told, lambda found: b"%s%d" % (found[1], int(found[2]) % 9 + 1), data)

    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_far = garble
        mapping = world.driver.clock_mapping()
        lowered = world.driver.lower_profiles({"x": trapezoid(0, 40_000, 80_000, 700_000)}, StartOptions(), mapping)
        with pytest.raises(Refusal, match=f"{read} reads back as") as refusal:
            await world.driver.slots.present.load(lowered, world.clock.now_ns() + 2 * NS_PER_S, mapping)
        assert refusal.value.code == "read-back"
        world.wire.to_far = None
        await world.driver.slots.unload()
        assert not world.controller.commanded_motions

    run(main)


@pytest.mark.parametrize(
    ("seed", "ppm", "hold_ms"),
    share_with_nightly([(2, 100.0, 0), (3, -100.0, 16), (5, -12.0, 2), (1, 0.0, 0), (4, 35.0, 16)], 3),
)
def test_spans_and_budgets_hold_over_random_moves_crystals_and_adapters(seed: int, ppm: float, hold_ms: int):
    async def main(world: World) -> None:
        draw = Random(world.wire.seed)
        await world.ready(60)
        at = {"x": 0, "y": 0}
        for _ in range(12):
            profiles: dict[str, Profile] = {}
            for axis in at:
                end = draw.randrange(-200_000, 200_000)
                speed, ramp = draw.uniform(20_000, 99_000), draw.uniform(50_000, 990_000)
                profiles[axis] = trapezoid(at[axis], end, speed, ramp, draw.uniform(1.0, 1.3))
                at[axis] = end
            before = len(world.controller.commanded_motions)
            lowered, started, outcome, t0_ns = await world.moved(profiles)
            assert outcome.state == "done", outcome
            motions = {motion.axis: motion for motion in world.controller.commanded_motions[before:]}
            for axis, letter in (("x", "X"), ("y", "Y")):
                motion = motions[letter]
                assert started[axis].earliest_ns <= motion.start_ns <= started[axis].latest_ns
                assert outcome.ended[axis].earliest_ns <= motion.end_ns <= outcome.ended[axis].latest_ns
                assert motion.end_ns is not None
                off_ns = motion.start_ns - t0_ns
                assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
                # Up to the next whole sample, plus the uncertainty of the crystal.
                real_s, told_s = (motion.end_ns - motion.start_ns) * 1e-9, lowered.durations_s[axis]
                assert -1e-4 * real_s <= real_s - told_s <= 1e-4 * real_s + lowered.tick_ns * 1e-9 + 1e-5
                # Nothing wider than the clock's own bound and the two samples that the program cannot distinguish.
                clock_ns = lowered.terms[0].latest_ns - lowered.terms[0].earliest_ns
                assert started[axis].latest_ns - started[axis].earliest_ns <= 2 * lowered.tick_ns + clock_ns + 2
                assert clock_ns < 7 * NS_PER_MS
            for _ in range(3):
                await world.driver.poll()

    run(main, seed=seed, ppm=ppm, hold_ms=hold_ms)


def test_disarmed_and_reconnected_controllers_do_not_start():
    async def main(world: World) -> None:
        await world.ready()
        for way in ("disarm", "reconnect"):
            mapping = world.driver.clock_mapping()
            lowered = world.driver.lower_profiles({"x": trapezoid(0, 5000, 20_000, 200_000)}, StartOptions(), mapping)
            t0_ns = world.clock.now_ns() + NS_PER_S
            await world.driver.slots.present.load(lowered, t0_ns, mapping)
            await world.driver.slots.present.release()
            if way == "disarm":
                await world.driver.slots.unload()
                await world.driver.slots.unload()
            else:
                await world.driver.close()
                await sleep_ns(world.clock, NS_PER_MS)
                await world.driver.connect()
            await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
            await world.driver.poll()
            assert not world.controller.commanded_motions

    run(main)


def test_minutes_of_polls_take_seconds_of_cpu_time():
    async def main(world: World) -> None:
        await world.ready()
        for _ in range(1500):  # far more than the estimate keeps
            assert not (await world.driver.poll()).restarted
            await sleep_ns(world.clock, 100 * NS_PER_MS)
        mapping = world.driver.clock_mapping()
        assert mapping is not None
        assert abs(mapping.rate_ppm + 40.0) < 5
        # Half a round trip, and the shift of the middle because commands usually take half a millisecond.
        assert mapping.bound_ns < 1.1 * NS_PER_MS
        assert abs(mapping.rate_ppm + 40.0) < mapping.drift_ppm

    run(main, ppm=40.0)
