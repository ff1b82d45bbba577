"""Jerk-limited moves of the SMC-2000 by contour, against the simulated controller; verdicts by its truth."""

import asyncio
import re
from contextlib import suppress
from random import Random
from typing import Any, cast

import pytest
from unit.adapters.test_smc2000_bench import FLEET, ChainWorld, World, run, run_chain, trapezoid
from unit.adapters.test_smc4000_bench import VELOCITY, jerked
from unit.random_rounds import share_with_nightly

from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.smc2000.options import Smc2000DriverOptions
from adapters.yaskawa.smc2000.program import (
    INTERLEAVED_COMMANDS,
    LETTERS,
    contour_arrays,
    program_lines,
    program_variables,
)
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

MOTORS = {"x": "X", "y": "Y"}
LABELS_MOST, LINES_MOST = 254, 1000  # L3347, L8219


async def armed(world: World, profiles: dict[str, Profile]) -> tuple[Any, int]:
    """Armed with the lead that was declared."""
    mapping = world.driver.clock_mapping()
    lowered = world.driver.lower_profiles(profiles, StartOptions(), mapping)
    t0_ns = world.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + 100 * NS_PER_MS
    await world.driver.slots.present.load(lowered, t0_ns, mapping)
    assert world.clock.now_ns() < t0_ns - lowered.costs.disarm_ns
    return lowered, t0_ns


async def usable(world: World) -> None:
    """Both axes move again, by contour and by registers, without anything between."""
    for shape in ("contour", "trapezoid"):
        for _ in range(3):
            await world.driver.poll()
        here = {axis: round(world.controller.position(motor)) for axis, motor in MOTORS.items()}
        ends = {axis: (at, at + 4000) for axis, at in here.items()}
        if shape == "contour":
            profiles = jerked(ends)
        else:
            profiles = {axis: trapezoid(*way, 20_000, 204_800) for axis, way in ends.items()}
        _, t0_ns = await armed(world, profiles)
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "done", outcome
        assert world.clock.now_ns() > t0_ns
        assert [world.controller.position(motor) for motor in "XY"] == [at + 4000 for at in here.values()]


@pytest.mark.parametrize(
    ("seed", "ppm", "hold_ms"),
    share_with_nightly([(2, 100.0, 0), (3, -100.0, 16), (1, 0.0, 0), (4, 35.0, 16), (5, -100.0, 0)], 2),
)
def test_path_and_evidence_contain_the_truth_over_random_moves_and_crystals(seed: int, ppm: float, hold_ms: int):
    async def main(world: World) -> None:
        draw = Random(seed)
        await world.ready(60)
        at = {"x": 0, "y": 0}
        for _ in range(4):
            await world.driver.poll()
            ends = {axis: draw.randrange(-100_000, 100_000) for axis in at}
            profiles = jerked({axis: (at[axis], ends[axis]) for axis in at}, draw.uniform(0.3, 1.0))
            at = ends
            before = len(world.controller.commanded_motions)
            mapping = world.driver.clock_mapping()
            assert mapping is not None
            lowered, t0_ns = await armed(world, profiles)
            await world.driver.slots.present.verify()
            await world.driver.slots.present.release()

            async def watch() -> tuple[Any, Any]:
                started = await world.driver.slots.present.wait_for_start()
                return started, await world.driver.slots.present.wait_for_end()

            watching = asyncio.get_running_loop().create_task(watch())
            await sleep_until_ns(world.clock, t0_ns + 20 * NS_PER_MS)
            timebase = cast(Any, world.controller).machine.timebase
            start = world.controller.commanded_motions[before]
            first = next(
                n
                for n in range(timebase.current_sample() - 40, timebase.current_sample())
                if timebase.true_ns(n) == start.start_ns
            )
            contour = lowered.load.contour
            plans = {axis: profile.make_evaluator() for axis, profile in profiles.items()}
            for instant in contour.record_ends[5:]:
                await sleep_until_ns(world.clock, timebase.true_ns(first + instant))
                time_s = (mapping.to_host_ns(first + instant) - t0_ns) * 1e-9
                for axis, plan in plans.items():
                    real = world.controller.position(MOTORS[axis]) - profiles[axis].start_counts
                    assert abs(real - plan(time_s).position) <= 1.0
            started, outcome = await watching
            assert outcome.state == "done", outcome
            motions = {motion.axis: motion for motion in world.controller.commanded_motions[before:]}
            for axis, motor in MOTORS.items():
                motion = motions[motor]
                assert motion.end_ns is not None and motion.end_counts == ends[axis]
                assert started[axis].earliest_ns <= motion.start_ns <= started[axis].latest_ns
                assert outcome.ended[axis].earliest_ns <= motion.end_ns <= outcome.ended[axis].latest_ns
                off_ns = motion.start_ns - t0_ns
                assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
                real_s = (motion.end_ns - motion.start_ns) * 1e-9
                assert abs(real_s - lowered.durations_s[axis]) <= lowered.tick_ns * 1e-9 + 1.1e-4 * real_s
                assert 0 <= lowered.durations_s[axis] - profiles[axis].duration_s <= 4 * lowered.tick_ns * 1e-9

    run(main, seed=seed, ppm=ppm, hold_ms=hold_ms)


@pytest.mark.parametrize("hold_ms", [0, 16])
def test_the_declared_time_is_a_tight_bound_of_the_arming_time(hold_ms: int):
    async def main(world: World) -> None:
        await world.ready()
        for ends in ({"x": (0, 90_000)}, {"x": (0, -200_000), "y": (0, 300_000)}):
            mapping = world.driver.clock_mapping()
            lowered = world.driver.lower_profiles(jerked(ends), StartOptions(), mapping)
            began_ns = world.clock.now_ns()
            t0_ns = began_ns + lowered.costs.arm_ns + lowered.costs.disarm_ns + 100 * NS_PER_MS
            assert not await world.driver.check_settings(everything=True)
            await world.driver.slots.present.load(lowered, t0_ns, mapping)
            took_ns = world.clock.now_ns() - began_ns
            assert 0.5 * lowered.costs.arm_ns < took_ns <= lowered.costs.arm_ns
            await world.driver.slots.unload()
            assert not world.controller.commanded_motions

    run(main, hold_ms=hold_ms, fleet=FLEET | {"options": {"hold_us": 1000 * hold_ms}})


@pytest.mark.parametrize("before_ms", [300, 100, 75, None])
def test_nothing_starts_after_a_disarm_or_a_connection_and_the_axes_are_free(before_ms: int | None):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 20_000), "y": (0, 10_000)}))
        await world.driver.slots.present.release()
        if before_ms is not None:
            await sleep_until_ns(world.clock, t0_ns - before_ms * NS_PER_MS)
            await world.driver.slots.unload()
            await world.driver.slots.unload()
        else:
            await world.driver.close()
            await sleep_ns(world.clock, NS_PER_MS)
            await world.driver.connect()
        await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
        assert not world.controller.commanded_motions
        await usable(world)

    run(main)


@pytest.mark.parametrize(("abort", "halts"), [(False, True), (False, False), (True, True)])  # AB always halts programs
@pytest.mark.parametrize(
    "after_ms",
    [-60, -15, 0, 3, 600, 1100, *(pytest.param(n, marks=pytest.mark.nightly) for n in (-200, -38, -5, 150, 1040))],
)
def test_a_stop_in_every_phase_is_a_stop_and_leaves_the_axes_free(after_ms: int, abort: bool, halts: bool):
    async def main(world: World) -> None:
        await world.ready()
        # 1.06 s
        lowered, t0_ns = await armed(world, jerked({"x": (0, 90_000), "y": (0, 30_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + after_ms * NS_PER_MS)
        at = world.controller.position("X")
        await world.driver.stop(abort=abort)
        await sleep_ns(world.clock, lowered.costs.stop_ns)
        assert world.controller.at_rest()
        # The line takes some milliseconds, and a record that is being executed is completed.
        assert world.controller.position("X") - at <= VELOCITY * 0.03
        if after_ms < -30:
            assert not world.controller.commanded_motions
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        await usable(world)

    run(main, options={"st_halts_programs": halts})


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("after_ms", [50, 300, 433, 900, 1300])
def test_a_stop_while_arming_refuses_the_step(after_ms: int, abort: bool):
    async def main(world: World) -> None:
        await world.ready()
        arming = asyncio.get_running_loop().create_task(armed(world, jerked({"x": (0, 90_000), "y": (0, 30_000)})))
        await sleep_ns(world.clock, after_ms * NS_PER_MS)
        await world.driver.stop(abort=abort)
        with suppress(Refusal, ControllerFault):
            await arming
        await world.driver.slots.unload()
        await sleep_ns(world.clock, 3 * NS_PER_S)
        assert not world.controller.commanded_motions
        await usable(world)

    run(main)


def test_a_move_whose_adapter_is_lost_is_stopped_by_the_controller_itself():
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 400_000)}))
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        await sleep_until_ns(world.clock, t0_ns + 3 * NS_PER_S)
        assert world.controller.at_rest()
        assert 0 < world.controller.position("X") < 300_000
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "stopped"
        assert "watchdog" in outcome.reason
        await usable(world)

    run(main)


def test_arrays_that_differ_from_the_loaded_data_refuse_the_step():
    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_far = lambda data: data.replace(b"\x1a", b"7\x1a")
        with pytest.raises((Refusal, ControllerFault)):
            await armed(world, jerked({"x": (0, 90_000)}))
        world.wire.to_far = None
        await world.driver.slots.unload()
        await usable(world)

    run(main)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"contour_upload_s": 3}, r"would take \d+ s to load.*raise contour_sag_counts.*at most [\d.]+ s of motion"),
        ({"contour_upload_s": 0.5}, r"to load over this line, allowed are 0.5 s.*at most [\d.]+ s of motion"),
        ({"contour_upload_s": 3, "contour_sag_counts": 1000}, None),
    ],
)
def test_the_refusal_of_a_too_long_upload_names_what_would_fit(options: dict[str, Any], words: str | None):
    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.poll()
        profiles = jerked({"x": (0, 600_000), "y": (0, 200_000)})
        if words is None:
            lowered = world.driver.lower_profiles(profiles, StartOptions(), world.driver.clock_mapping())
            assert re.search(r"records of (16|32|64) samples", lowered.commands[0])
            return
        with pytest.raises(Refusal) as refusal:
            world.driver.lower_profiles(profiles, StartOptions(), world.driver.clock_mapping())
        assert refusal.value.code == "upload-too-long"
        text = f"{refusal.value.text} {refusal.value.remedy}"
        assert re.search(words, text), text

    run(main, fleet=FLEET | {"options": options})


def test_trapezoids_use_the_registers_regardless_of_their_deviation():
    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.poll()
        for speed in (30.0, 700.0, 20_000.0):
            profiles = {"x": trapezoid(0, round(3 * speed), speed, 2 * speed)}
            lowered = world.driver.lower_profiles(profiles, StartOptions(), world.driver.clock_mapping())
            assert lowered.commands[0].startswith("PA")

    run(main)


def test_a_controller_of_a_chain_is_armed_while_the_others_are_polled():
    async def main(world: ChainWorld) -> None:
        await world.ready()
        driver = world.drivers[1]
        mapping = driver.clock_mapping()
        lowered = driver.lower_profiles(jerked({"x": (0, 50_000)}), StartOptions(), mapping)
        longest_ns = 0

        async def polls() -> None:
            nonlocal longest_ns
            while True:
                began_ns = world.clock.now_ns()
                await world.drivers[0].poll()
                longest_ns = max(longest_ns, world.clock.now_ns() - began_ns)
                await sleep_ns(world.clock, 100 * NS_PER_MS)

        polling = asyncio.get_running_loop().create_task(polls())
        t0_ns = world.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + 100 * NS_PER_MS
        await driver.slots.present.load(lowered, t0_ns, mapping)
        assert longest_ns < 200 * NS_PER_MS
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        outcome = await driver.slots.present.wait_for_end()
        polling.cancel()
        assert outcome.state == "done", outcome
        assert world.units[1].position("X") == 50_000

    run_chain(main)


@pytest.mark.parametrize("chained", [False, True])
@pytest.mark.parametrize("count", range(1, 7))
def test_the_resident_program_fits_into_the_controller(count: int, chained: bool):
    axes = tuple(range(len(LETTERS) - count, len(LETTERS)))
    lines = program_lines(
        axes,
        chained=chained,
        inputs=3,
        outputs=1,
        gate=GateTiming.for_options(Smc2000DriverOptions(servo_period_us=250, decode_us=2000), INTERLEAVED_COMMANDS),
    )
    assert len(lines) <= LINES_MOST
    assert any(line.startswith("#F") for line in lines) == (count <= 3 and not chained)
    assert all(len(line) <= MAX_LINE for line in lines)
    labels = [line.split(";")[0] for line in lines if line.startswith("#")]
    assert len(labels) == len(set(labels)) <= LABELS_MOST
    assert all(len(label) <= 8 for label in labels)
    assert any(line.startswith("CM ") for line in lines) == (count <= 4)
    assert all(len(name) <= 8 for name in (*program_variables(axes, chained=chained), *contour_arrays(axes)))
