"""The SMC-4000's driver against the simulated controller, in virtual time; verdicts by the simulator's truth."""

from functools import partial
from random import Random
from typing import Any, cast

import pytest
from unit.adapters.test_smc4000_bench import FLEET, World, run, trapezoid
from unit.random_rounds import share_with_nightly

from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

MORE_PERIODS = ((250, 500), (5000, 500), (1000, 3000))  # servo period and decoding time, in µs


def test_a_step_runs_from_connect_to_its_outcome():
    async def main(world: World) -> None:
        identity = await world.driver.connect()
        assert (identity.model, identity.serial) == ("SMC4040", "1")
        await world.ready()
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
    ("seed", "ppm"), share_with_nightly([(2, 90.0), (7, -90.0), (1, 0.0), (4, 35.0), (5, -12.0)], 2)
)
def test_durations_are_predicted_and_spans_hold_over_random_moves_and_drifts(seed: int, ppm: float):
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
                off_ns = motion.start_ns - t0_ns
                assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
                assert motion.end_ns is not None
                real_s = (motion.end_ns - motion.start_ns) * 1e-9
                tick_s = lowered.tick_ns * 1e-9
                # To the sample, at the rate of the clock mapping, which is known to some 10 ppm after a few seconds.
                assert real_s == pytest.approx(lowered.durations_s[axis], abs=tick_s + 1e-5 + 1.2e-5 * real_s)
                assert lowered.durations_s[axis] == pytest.approx(profiles[axis].duration_s, abs=0.501 * tick_s)
                # Nothing wider than the clock's own bound and the two samples that the program cannot distinguish.
                clock_ns = lowered.terms[0].latest_ns - lowered.terms[0].earliest_ns
                assert started[axis].latest_ns - started[axis].earliest_ns <= 2 * lowered.tick_ns + clock_ns + 2
            for _ in range(3):
                await world.driver.poll()

    run(main, seed=seed, ppm=ppm)


@pytest.mark.parametrize(
    ("period_us", "decode_us"),
    [(1000, 500), *(pytest.param(*each, marks=pytest.mark.nightly) for each in ((250, 1500), *MORE_PERIODS))],
)
def test_a_release_at_the_last_moment_starts_in_time_or_not_at_all(period_us: int, decode_us: int):
    begun: list[bool] = []

    async def release(world: World, before_ns: int) -> None:
        moved = len(world.controller.commanded_motions)
        here = round(world.controller.position("X"))
        mapping = world.driver.clock_mapping()
        t0_ns = world.clock.now_ns() + NS_PER_S
        lowered = world.driver.lower_profiles(
            {"x": trapezoid(here, here + 5000, 20_000, 200_000)}, StartOptions(lead_ns=NS_PER_S), mapping
        )
        await world.driver.slots.present.load(lowered, t0_ns, mapping)
        await sleep_until_ns(world.clock, t0_ns - before_ns)
        try:
            await world.driver.slots.present.release()
        except Refusal as refusal:
            assert refusal.code == "late"
        else:
            begun.append(True)
            await world.driver.slots.present.wait_for_start()
            (motion,) = world.controller.commanded_motions[moved:]
            off_ns = motion.start_ns - t0_ns
            assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
            await world.driver.slots.present.wait_for_end()
            return
        begun.append(False)
        await sleep_ns(world.clock, NS_PER_S)
        assert len(world.controller.commanded_motions) == moved
        await world.driver.slots.unload()

    async def main(world: World, instants: range) -> None:
        cast(Any, world.controller).machine.memory.burn_period(period_us)
        await world.ready()
        for k in instants:
            await release(world, release_ns - k * 400_000)

    options = {"servo_period_us": period_us, "decode_us": decode_us + 50, "begin_max_us": 3 * decode_us}
    release_ns = round(
        GateTiming.for_options(YaskawaOptions.model_validate(options)).release_before * period_us * 1000 / 1.024
    )
    for first in range(-20, 40, 10):  # from more than a sample and a half before, with six seeds of the wire
        late = partial(main, instants=range(first, first + 10))
        run(late, seed=first + 20, fleet={**FLEET, "options": options}, decode_ns=1000 * decode_us)
    assert begun[0] and not begun[-1]


def test_disarmed_and_reconnected_controllers_do_not_start():
    async def main(world: World) -> None:
        await world.ready()
        for way in ("disarm", "reconnect", "other"):
            mapping = world.driver.clock_mapping()
            lowered = world.driver.lower_profiles({"x": trapezoid(0, 5000, 20_000, 200_000)}, StartOptions(), mapping)
            t0_ns = world.clock.now_ns() + NS_PER_S
            await world.driver.slots.present.load(lowered, t0_ns, mapping)
            await world.driver.slots.present.release()
            if way == "disarm":
                await world.driver.slots.unload()
                await world.driver.slots.unload()
            elif way == "reconnect":
                await world.driver.close()
                await world.driver.connect()
            else:
                await world.other().connect()
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
        assert abs(mapping.rate_ppm + 40.0) < 20
        assert mapping.bound_ns < NS_PER_MS

    run(main, ppm=40.0)
