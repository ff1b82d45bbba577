"""Jerk-limited moves of the SMC-4000 by contour, against the simulated controller; verdicts by its truth."""

import asyncio
import re
from random import Random
from typing import Any

import pytest
from unit.adapters.test_smc4000_bench import ACCELERATION, FLEET, LIMITS, World, jerked, run, trapezoid
from unit.random_rounds import share_with_nightly

from adapters.contract import JogMove
from adapters.yaskawa.smc4000.driver import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import FirmwareTiming

MOTORS = {"x": "X", "y": "Y"}


async def armed(world: World, profiles: dict[str, Profile], lead_s: float = 1.5) -> tuple[Any, int]:
    mapping = world.driver.clock_mapping()
    assert mapping is not None
    t0_ns = world.clock.now_ns() + round(lead_s * NS_PER_S)
    lowered = world.driver.lower_profiles(profiles, StartOptions(lead_ns=t0_ns - mapping.host_at_ns), mapping)
    await world.driver.slots.present.load(lowered, t0_ns, mapping)
    return lowered, t0_ns


async def usable(world: World) -> None:
    """Both axes move again, by registers, by jog and by contour, without anything between."""
    mapping = world.driver.clock_mapping()
    assert mapping is not None
    for _ in range(3):
        await world.driver.poll()
    here = {axis: round(world.controller.position(motor)) for axis, motor in MOTORS.items()}
    await world.driver.jog_axis("x", JogMove(5_000.0, 100_000.0, None))
    await sleep_ns(world.clock, 200 * NS_PER_MS)
    await world.driver.stop_axes(["x"])
    await sleep_ns(world.clock, 500 * NS_PER_MS)
    assert round(world.controller.position("X")) > here["x"]
    for shape in ("contour", "trapezoid"):
        here = {axis: round(world.controller.position(motor)) for axis, motor in MOTORS.items()}
        ends = {axis: (at, at + 4000) for axis, at in here.items()}
        if shape == "contour":
            profiles = jerked(ends)
        else:
            profiles = {axis: trapezoid(*way, 20_000, 204_800) for axis, way in ends.items()}
        _, _, outcome, _ = await world.moved(profiles, 1.5)
        assert outcome.state == "done", outcome
        assert [world.controller.position(motor) for motor in "XY"] == [at + 4000 for at in here.values()]


@pytest.mark.parametrize(("seed", "ppm"), share_with_nightly([(2, 100.0), (3, -100.0), (1, 0.0), (4, 35.0)], 2))
def test_path_and_evidence_contain_the_truth_over_random_moves_and_crystals(seed: int, ppm: float):
    async def main(world: World) -> None:
        draw = Random(seed)
        await world.ready(60)
        at = {"x": 0, "y": 0}
        for _ in range(5):
            await world.driver.poll()
            ends = {axis: draw.randrange(-200_000, 200_000) for axis in at}
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
            timebase = world.controller.machine.timebase  # pyright: ignore
            start = next(m for m in world.controller.commanded_motions[before:])
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
                assert motion.end_counts == ends[axis]
                assert started[axis].earliest_ns <= motion.start_ns <= started[axis].latest_ns
                assert outcome.ended[axis].earliest_ns <= motion.end_ns <= outcome.ended[axis].latest_ns
                off_ns = motion.start_ns - t0_ns
                assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
                assert motion.end_ns is not None
                real_s = (motion.end_ns - motion.start_ns) * 1e-9
                assert abs(real_s - lowered.durations_s[axis]) <= lowered.tick_ns * 1e-9 + 1.1e-4 * real_s
                clock_ns = lowered.terms[0].latest_ns - lowered.terms[0].earliest_ns
                assert started[axis].latest_ns - started[axis].earliest_ns <= 2 * lowered.tick_ns + clock_ns + 2
                assert outcome.ended[axis].latest_ns - outcome.ended[axis].earliest_ns <= 8 * lowered.tick_ns + clock_ns

    run(main, seed=seed, ppm=ppm)


@pytest.mark.parametrize("before_ms", [900, 60, 38, 36, 30, 21, 10])
@pytest.mark.parametrize("way", ["disarm", "reconnect", "other"])
def test_nothing_starts_after_a_disarm_and_the_axes_are_free(before_ms: int, way: str):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 20_000), "y": (0, 10_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns - before_ms * NS_PER_MS)
        if way == "disarm":
            await world.driver.slots.unload()
            await world.driver.slots.unload()
        elif way == "reconnect":
            await world.driver.close()
            await world.driver.connect()
        else:
            await world.other().connect()
        await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
        assert before_ms < 21 or not world.controller.commanded_motions
        await usable(world)

    run(main)


@pytest.mark.parametrize(("abort", "halts"), [(False, True), (False, False), (True, True)])  # AB always halts programs
@pytest.mark.parametrize(
    "after_ms",
    [
        -60,
        -30,
        -2,
        0,
        2,
        600,
        1100,
        *(pytest.param(n, marks=pytest.mark.nightly) for n in (-300, -38, 1, 3, 150, 1040)),
    ],
)
def test_a_stop_in_every_phase_is_a_stop_and_leaves_the_axes_free(after_ms: int, abort: bool, halts: bool):
    async def main(world: World) -> None:
        await world.ready()
        # 1.06 s
        lowered, t0_ns = await armed(world, jerked({"x": (0, 90_000), "y": (0, 30_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + after_ms * NS_PER_MS)
        speeds = {motor: abs(world.controller.velocity(motor)) for motor in "XY"}
        at = {motor: world.controller.position(motor) for motor in "XY"}
        await world.driver.stop(abort=abort)
        await sleep_ns(world.clock, lowered.costs.stop_ns)
        assert not any(world.controller.is_moving(motor) for motor in "XY")
        for motor in "XY":
            way = abs(world.controller.position(motor) - at[motor])
            assert way <= speeds[motor] * 0.005 + (0 if abort else speeds[motor] ** 2 / 2 / ACCELERATION * 1.05) + 100
        if after_ms < -21:
            assert not world.controller.commanded_motions
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        await usable(world)

    run(main, options={"st_halts_programs": halts})


@pytest.mark.parametrize("halts", [True, False])
@pytest.mark.parametrize("after_ms", [-300, -35, 1, 300])
def test_a_guardians_bytes_stop_running_and_waiting_contours(after_ms: int, halts: bool):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 90_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + after_ms * NS_PER_MS)
        link = await world.wire.open_link()
        link.write(MAKE.stop_bytes(Controller.model_validate(FLEET)))
        await sleep_ns(world.clock, NS_PER_S)
        assert world.controller.at_rest()
        assert abs(world.controller.position("X")) < 50_000
        await usable(world)

    run(main, options={"st_halts_programs": halts})


@pytest.mark.parametrize(
    "options",
    [
        {"question_crlf": True},
        {"sign_column": False},
        {"qr_axis_bytes": 28},
        {"strict_packets": True},
        {"late_contour_error": True},
        {"axes": 2},
    ],
)
def test_every_open_point_of_the_manual_is_supported(options: dict[str, Any]):
    async def main(world: World) -> None:
        await world.ready()
        _, _, outcome, _ = await world.moved(jerked({"x": (0, 70_000), "y": (0, -3_000)}), 1.5)
        assert outcome.state == "done", outcome
        assert (world.controller.position("X"), world.controller.position("Y")) == (70_000, -3_000)

    run(main, options=options)


@pytest.mark.parametrize("contour", [True, False])
def test_a_move_whose_adapter_is_lost_is_stopped_by_the_controller_itself(contour: bool):
    async def main(world: World) -> None:
        await world.ready()
        ends = {"x": (0, 400_000), "y": (0, 200_000)}
        profiles = jerked(ends) if contour else {a: trapezoid(*way, 50_000, 512_000) for a, way in ends.items()}
        lowered, t0_ns = await armed(world, profiles)
        assert lowered.commands[0].startswith("contour" if contour else "PA")
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        watching = asyncio.get_running_loop().create_task(world.driver.slots.present.wait_for_end())
        await sleep_until_ns(world.clock, t0_ns + 1500 * NS_PER_MS)
        world.wire.cut = True
        await sleep_ns(world.clock, 1000 * NS_PER_MS)
        assert world.controller.is_moving("X")
        await sleep_ns(world.clock, 400 * NS_PER_MS)
        assert not world.controller.is_moving("X") and not world.controller.is_moving("Y")
        assert 0 < world.controller.position("X") < 300_000
        world.wire.cut = False
        with pytest.raises(ControllerFault):
            await watching
        await world.driver.connect()
        await usable(world)

    run(main)


def test_a_tripped_watchdog_is_named():
    async def main(world: World) -> None:
        await world.ready()
        await armed(world, jerked({"x": (0, 400_000)}))
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        await sleep_ns(world.clock, 1500 * NS_PER_MS)
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "stopped"
        assert "watchdog" in outcome.reason

    run(main)


def test_a_long_move_that_is_watched_is_left_alone():
    async def main(world: World) -> None:
        await world.ready()
        _, _, outcome, _ = await world.moved(jerked({"x": (0, 600_000), "y": (0, 10)}, 0.5), 4.0)
        assert outcome.state == "done", outcome
        assert world.controller.position("X") == 600_000

    run(main)


@pytest.mark.parametrize("other", [False, True])
def test_a_contour_that_an_earlier_client_left_is_stopped_by_its_ramps_at_connect(other: bool):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 400_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + 700 * NS_PER_MS)
        if not other:
            await world.driver.close()
        await (world.other() if other else world.driver).connect()
        motion = world.controller.commanded_motions[0]
        await sleep_ns(world.clock, 500 * NS_PER_MS)
        assert motion.slowing_ns is not None and motion.end_ns is not None
        # 100,000 counts/s with 1,000,000 counts/s²
        assert 90 * NS_PER_MS < motion.end_ns - motion.slowing_ns < 110 * NS_PER_MS
        await world.driver.connect()
        await usable(world)

    run(main)


@pytest.mark.parametrize("refuses", [False, True])
def test_a_contour_that_is_fed_too_slowly_is_a_fault(refuses: bool):
    async def main(world: World) -> None:
        await world.ready()
        lowered, _ = await armed(world, jerked({"x": (0, 90_000)}), 3.0)
        assert lowered.load.contour.interval == 3
        world.controller.machine.delay.timing = FirmwareTiming(decode_ns=2_500_000)  # pyright: ignore
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == ("stopped" if refuses else "fault"), outcome
        assert ("program had failed" if refuses else "records came too slowly") in outcome.reason
        world.controller.machine.delay.timing = FirmwareTiming(decode_ns=500_000)  # pyright: ignore
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        await usable(world)

    run(main, options={"late_contour_error": refuses})


def test_a_limit_switch_in_a_contour_is_a_fault_of_its_axis():
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 90_000), "y": (0, 90_000)}))
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        watching = asyncio.get_running_loop().create_task(world.driver.slots.present.wait_for_end())
        await sleep_until_ns(world.clock, t0_ns + 300 * NS_PER_MS)
        world.controller.set_limit("X", "forward")
        outcome = await watching
        assert outcome.state == "fault"
        assert "axis x stopped by the forward limit switch" in outcome.reason
        assert not world.controller.is_moving("Y")

    run(main)


def test_a_power_cycle_clears_a_contour():
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await armed(world, jerked({"x": (0, 90_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + 300 * NS_PER_MS)
        world.controller.set_power(on=False)
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        world.controller.set_power(on=True)
        await world.driver.connect()
        await world.driver.set_enabled(["x", "y"], on=True)
        await sleep_ns(world.clock, 2 * NS_PER_S)
        assert len(world.controller.commanded_motions) == 1
        await usable(world)

    run(main)


@pytest.mark.parametrize("stage", range(0, 60, 5))
def test_a_link_that_is_cut_anywhere_leaves_nothing_armed_after_it_is_back(stage: int):
    async def main(world: World) -> None:
        await world.ready()
        count = 0

        def cut(data: bytes) -> bytes:
            nonlocal count
            count += 1
            world.wire.cut |= count > stage
            return data

        world.wire.to_far = cut
        with pytest.raises(ControllerFault):
            await armed(world, jerked({"x": (0, 90_000)}), 2.0)
            await world.driver.slots.present.verify()
            await world.driver.slots.present.release()
            for _ in range(40):
                await world.driver.poll()
        world.wire.to_far, world.wire.cut = None, False
        moving = bool(world.controller.commanded_motions)
        await world.driver.connect()
        await sleep_ns(world.clock, 3 * NS_PER_S)
        assert moving or not world.controller.commanded_motions
        await usable(world)

    run(main)


def test_arrays_that_differ_from_the_loaded_data_refuse_the_step():
    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_far = lambda data: data.replace(b"\x1a", b"7\x1a")
        with pytest.raises(Refusal) as refusal:
            await armed(world, jerked({"x": (0, 90_000)}))
        world.wire.to_far = None
        assert refusal.value.code == "read-back"
        await world.driver.slots.unload()
        await usable(world)

    run(main)


def test_arrays_and_number_formats_of_others_are_left_as_they_are():
    async def main(world: World) -> None:
        await world.ready()
        await world.talk("DM MINE[14800]")
        await world.talk("PF -8.2")
        _, _, outcome, _ = await world.moved(jerked({"x": (0, 90_000)}), 1.5)
        assert outcome.state == "done"
        assert "-008.2" in await world.talk("MG _PF{F3.1}")
        with pytest.raises(Refusal) as refusal:
            await armed(world, jerked({"x": (90_000, 500_000)}))
        assert refusal.value.code == "array-space"
        assert "14800" in await world.talk("LA")

    run(main)


@pytest.mark.parametrize(
    ("way", "options", "code", "words"),
    [
        ({"x": (0, 6_000_000)}, {"array_elements": 4000}, "contour-too-long", "axis x.*at most 31.2 s"),
        ({"x": (0, 6_000_000), "y": (0, 100)}, {"array_elements": 4000}, "contour-too-long", "at most 15.6 s"),
        ({"x": (0, 6_000_000)}, {"array_elements": 400, "contour_sag_counts": 1e9}, None, ""),
    ],
)
def test_the_refusal_of_a_move_that_does_not_fit_names_what_would(
    way: dict[str, tuple[int, int]], options: dict[str, Any], code: str | None, words: str
):
    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.poll()
        if code is None:
            lowered = world.driver.lower_profiles(jerked(way), StartOptions(), world.driver.clock_mapping())
            assert "records of 256 samples" in lowered.commands[0]
            return
        with pytest.raises(Refusal) as refusal:
            world.driver.lower_profiles(jerked(way), StartOptions(), world.driver.clock_mapping())
        assert refusal.value.code == code
        text = f"{refusal.value.text} {refusal.value.remedy}"
        assert re.search(words, text), text

    run(main, fleet=FLEET | {"options": options})


def test_a_speed_beyond_what_a_record_can_hold_is_refused():
    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.poll()
        fast = dict(plan_step([AxisMove("x", 0, 10**8, 9e6, 6e7, 1e9, order=3)]).profiles)
        with pytest.raises(Refusal) as refusal:
            world.driver.lower_profiles(fast, StartOptions(), world.driver.clock_mapping())
        assert refusal.value.code == "record-range"
        assert "axis x" in refusal.value.text
        assert "at most 4095" in refusal.value.remedy

    limits = LIMITS | {"velocity": 1e4, "acceleration": 6e4}
    axes = {"x": {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": limits}}
    run(main, fleet=FLEET | {"axes": axes})
