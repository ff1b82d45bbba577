"""Manual motion of an SHRC-203's axes, in virtual time; judged by the simulator's ground truth."""

import asyncio
from random import Random
from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import NAMES, Bench, controller, run
from unit.adapters.watching import Hand, Polling, Watch, at_rest
from unit.random_rounds import share_with_nightly

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from sim.core.controller import FirmwareTiming

RAMP = 400_000.0  # pls/s²
STOP_NS = 25 * NS_PER_MS  # a stop's characters, and the decoding of earlier commands
KNOBS = [
    {},
    {"stop_keeps_prebuffer": True},
    {"completion_after_stop": False},
    {"repeat_executed": True},
    {"handover_ms": 10.0},
]


def jog(speed: float, end: int | None = None, ramp: float = RAMP) -> JogMove:
    return JogMove(speed, ramp, end)


async def rested(bench: Bench, axis: str = "1", within_s: float = 3.0) -> float:
    await at_rest(bench.clock, bench.unit, axis, round(within_s * NS_PER_S))
    return bench.unit.position(axis)


@pytest.mark.parametrize("end", [None, 500_000])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_axis_jogs_at_its_speed_and_stops_by_its_ramp(end: int | None, sign: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        async with Watch(bench.clock, bench.unit, "12") as tracks:
            await bench.driver.jog_axis("x", jog(sign * 30_000.9, end and sign * end))
            await sleep_ns(bench.clock, 500 * NS_PER_MS)
            reading = await bench.driver.poll()
            assert reading.axes["x"].moving and not reading.axes["y"].moving
            assert bench.unit.velocity("1") * sign == pytest.approx(30_000)
            await bench.driver.stop_axes(["x"])
            ordered_ns = bench.clock.now_ns()
            await rested(bench)
        assert tracks["1"].fastest <= 30_000.9
        assert tracks["1"].steepest() <= RAMP * 1.01
        assert tracks["2"].fastest == 0
        (motion,) = bench.unit.commanded_motions
        assert motion.slowing_ns is not None and motion.end_ns is not None
        assert 0 < motion.slowing_ns - ordered_ns < STOP_NS
        assert motion.end_ns - motion.slowing_ns == pytest.approx(30_000 / RAMP * NS_PER_S, rel=0.02)
        assert not (await bench.driver.poll()).axes["x"].moving

    run(case)


@pytest.mark.parametrize(("speed", "end"), [(30_000, 10_000), (-90_000, -25_001), (2_000, 7), (1e6, 3), (1.0, 2)])
def test_a_jog_comes_to_rest_exactly_at_the_end_of_travel_without_another_command(speed: float, end: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        async with Watch(bench.clock, bench.unit, "1") as tracks:
            await bench.driver.jog_axis("x", jog(speed, end))
            bench.wire.cut = True
            assert await rested(bench, within_s=5) == end
        assert tracks["1"].between(min(0, end), max(0, end))
        assert tracks["1"].fastest <= abs(speed)

    run(case)


@pytest.mark.parametrize("ends", [(None, None), (90_000, 90_000), (90_000, -14_000), (None, -13_000)])
def test_speed_and_direction_are_changed_by_a_stop(ends: tuple[int | None, int | None]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        signs = (1, 1) if ends[0] == ends[1] else (1, -1)
        async with Watch(bench.clock, bench.unit, "1") as tracks:
            for sign, end, speed in zip(signs, ends, (10_000.0, 30_000.0), strict=True):
                await bench.driver.jog_axis("x", jog(sign * speed, end))
                await sleep_ns(bench.clock, 300 * NS_PER_MS)
                assert bench.unit.velocity("1") == pytest.approx(sign * speed)
        assert tracks["1"].steepest() <= RAMP * 1.01
        if ends[1] is not None:
            assert await rested(bench, within_s=9) == ends[1]

    run(case)


def test_the_same_jog_again_is_no_stop() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for _ in range(5):
            await bench.driver.jog_axis("x", jog(10_000.0, 90_000))
            await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert len(bench.unit.commanded_motions) == 1 and bench.unit.commanded_motions[0].slowing_ns is None

    run(case)


def test_a_ramp_longer_than_the_controller_allows_makes_the_jog_slower() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        async with Watch(bench.clock, bench.unit, "1") as tracks:
            await bench.driver.jog_axis("x", jog(50_000.0, None, 10_000.0))
            await sleep_ns(bench.clock, 1500 * NS_PER_MS)
        assert tracks["1"].fastest == pytest.approx(10_000, rel=1e-3)
        assert tracks["1"].steepest() <= 10_000 * 1.01

    run(case)


def test_axes_jog_independently_and_stop_alone() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", jog(30_000.0, 80_000))
        await bench.driver.jog_axis("y", jog(-20_000.0))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        await bench.driver.stop_axes(["x"])
        await rested(bench)
        assert bench.unit.velocity("2") == pytest.approx(-20_000)
        await bench.driver.jog_axis("x", jog(-10_000.0, -500))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        await bench.driver.stop_axes([])
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert bench.unit.is_moving("2")
        await bench.driver.stop(abort=False)
        await rested(bench)
        await rested(bench, "2")
        assert not bench.unit.is_moving("1")

    run(case)


def test_a_controller_that_moves_one_axis_at_a_time_reports_so() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", jog(10_000.0, 80_000))
        with pytest.raises(Refusal, match="NG"):
            await bench.driver.jog_axis("y", jog(10_000.0, 80_000))
        assert bench.unit.is_moving("1") and not bench.unit.is_moving("2")
        await bench.driver.stop_axes(["x"])
        await rested(bench)
        await bench.driver.jog_axis("y", jog(10_000.0, 3000))
        assert await rested(bench, "2") == 3000

    run(case, simulate={"busy_anywhere": True})


@pytest.mark.parametrize(
    ("move", "code"),
    [
        (JogMove(0.5, RAMP, None), "too-slow"),
        (JogMove(100.0, RAMP, 0), "at-end"),
        (JogMove(100.0, RAMP, -40), "at-end"),
        (JogMove(-100.0, RAMP, 40), "at-end"),
    ],
)
def test_an_impossible_jog_is_refused_and_nothing_moves(move: JogMove, code: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        with pytest.raises(Refusal) as refused:
            await bench.driver.jog_axis("x", move)
        assert refused.value.code == code
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.unit.commanded_motions

    run(case)


def test_below_its_start_rate_an_axis_does_not_jog() -> None:
    axes = {"x": {"motors": ["1"], "unit": "mm", "scale": 1_000_000, "limits": {"velocity": 0.1, "acceleration": 0.5}}}
    axes["x"]["start_rate"] = {"min": 0.0005, "max": 0.001}  # pyright: ignore[reportArgumentType]
    config = controller("x").model_validate({**controller("x").model_dump(), "axes": axes})

    async def case(bench: Bench) -> None:
        await bench.ready()
        with pytest.raises(Refusal) as refused:
            await bench.driver.jog_axis("x", jog(499.0))
        assert refused.value.remedy == "at least 500"
        await bench.driver.jog_axis("x", jog(500.0))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert bench.unit.velocity("1") == 500

    run(case, config=config)


def test_a_motor_that_is_off_an_error_and_another_motion_are_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.set_enabled(["x"], on=False)
        with pytest.raises(Refusal, match="NG"):
            await bench.driver.jog_axis("x", jog(1000.0))
        await bench.driver.send_raw("MP:2+P90000,S1F1000R10")
        await bench.driver.send_raw("G:2")
        with pytest.raises(Refusal, match="is moving"):
            await bench.driver.jog_axis("y", jog(1000.0))
        await bench.driver.stop(abort=True)
        with pytest.raises(Refusal, match="emergency"):
            await bench.driver.jog_axis("z", jog(1000.0))
        assert [motion.axis for motion in bench.unit.commanded_motions] == ["2"]

    run(case)


def test_an_armed_step_is_not_started_by_a_jog() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 5000})
        with pytest.raises(Refusal, match="loaded"):
            await bench.driver.jog_axis("x", jog(1000.0))
        await bench.driver.slots.unload()
        await bench.driver.jog_axis("x", jog(-1000.0, -100))
        assert await rested(bench) == -100

    run(case)


@pytest.mark.parametrize("end", [None, 90_000])
def test_a_limit_switch_ends_a_jog_and_allows_the_way_back(end: int | None) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", jog(30_000.0, end))
        await sleep_ns(bench.clock, 200 * NS_PER_MS)
        bench.unit.set_limit("1", "forward")
        stopped_at = await rested(bench)
        reading = await bench.driver.poll()
        assert reading.axes["x"].limit == "forward" and not reading.faults
        await bench.driver.jog_axis("x", jog(30_000.0, end))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert bench.unit.position("1") == stopped_at
        await bench.driver.jog_axis("x", jog(-30_000.0, end and -end))
        await sleep_ns(bench.clock, 200 * NS_PER_MS)
        assert bench.unit.position("1") < stopped_at and bench.unit.is_moving("1")

    run(case)


@pytest.mark.parametrize("simulate", KNOBS)
def test_after_jogs_a_step_and_homing_work_as_before(simulate: dict[str, Any]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for end in (None, 20_000, 4_000):
            await bench.driver.jog_axis("x", jog(10_000.0, end))
            await sleep_ns(bench.clock, 200 * NS_PER_MS)
            await bench.driver.stop_axes(["x"])
            start = round(await rested(bench))
            seen = len(bench.unit.commanded_motions)
            await bench.start({"x": start - 2000, "y": 500 + start})
            await bench.driver.slots.present.wait_for_start()
            outcome = await bench.driver.slots.present.wait_for_end()
            assert outcome.state == "done", outcome
            assert bench.unit.position("1") == start - 2000
            assert len(bench.unit.commanded_motions) == seen + 2
        await bench.driver.jog_axis("x", jog(10_000.0))
        with pytest.raises(Refusal):
            await bench.driver.home_axes(["x"], lambda _: None)
        await bench.driver.stop_axes(["x"])
        await rested(bench)
        assert not await bench.driver.home_axes(["x"], lambda _: None)
        assert (await bench.driver.poll()).axes["x"].commanded_counts == 0

    run(case, simulate=simulate)


def test_inputs_outputs_and_motors_are_read_while_axes_jog() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", jog(10_000.0))
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, 10 * NS_PER_MS)
        reading = await bench.driver.poll()
        assert reading.inputs == {number: number == 2 for number in range(1, 7)}
        await bench.driver.set_output(1, on=True)
        assert (await bench.driver.poll()).outputs[1]
        assert bench.unit.is_moving("1")

    run(case, config=controller(inputs={"door": {"number": 2}}, outputs={"lamp": {"number": 1}}))


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("after_ms", range(0, 75, 3))
def test_a_stop_at_every_stage_of_a_jog_leaves_it_at_rest(after_ms: int, abort: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("y", jog(5_000.0))
        begun = asyncio.create_task(bench.driver.jog_axis("x", jog(20_000.0, 50_000)))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        if abort:
            await bench.driver.stop(abort=True)
        else:
            await bench.driver.stop_axes(["x"])
        (outcome,) = await asyncio.gather(begun, return_exceptions=True)
        assert outcome is None or isinstance(outcome, Refusal)
        await sleep_ns(bench.clock, 200 * NS_PER_MS)
        assert not bench.unit.is_moving("1")
        assert bench.unit.is_moving("2") != abort
        assert bench.unit.position("1") < 1500
        if abort:
            await bench.driver.clear_faults()
            await bench.driver.set_enabled(["x"], on=True)
        await bench.driver.jog_axis("x", jog(20_000.0, 50_000))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        assert bench.unit.is_moving("1")

    run(case, seed=after_ms)


@pytest.mark.parametrize("after_ms", range(1, 100, 7))
@pytest.mark.parametrize("cancel", [False, True])
def test_a_change_of_direction_that_is_stopped_or_cancelled_leaves_the_driver_usable(
    after_ms: int, cancel: bool
) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", jog(5_000.0, 50_000))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        turned = asyncio.create_task(bench.driver.jog_axis("x", jog(-5_000.0, -50_000)))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        if cancel:
            turned.cancel()
            await asyncio.gather(turned, return_exceptions=True)
        await bench.driver.stop_axes(["x"])
        await asyncio.gather(turned, return_exceptions=True)
        await sleep_ns(bench.clock, 200 * NS_PER_MS)
        assert not bench.unit.is_moving("1")
        await bench.driver.poll()
        await bench.driver.jog_axis("x", jog(20_000.0, 2_000))
        assert await rested(bench) == 2_000

    run(case, seed=after_ms)


@pytest.mark.parametrize("lose", [b"OK\r\n", b"S1F2"])
def test_a_lost_answer_never_leaves_an_axis_running(lose: bytes) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.wire.to_near = lambda data: b"" if lose in data else data
        (outcome,) = await asyncio.gather(bench.driver.jog_axis("x", jog(20_000.0, 50_000)), return_exceptions=True)
        assert outcome is not None
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        assert not bench.unit.is_moving("1")
        bench.wire.to_near = None
        await bench.driver.jog_axis("x", jog(20_000.0, 5_000))
        assert await rested(bench) == 5_000

    run(case)


@pytest.mark.parametrize("seed", range(40))
def test_a_noisy_line_never_sends_an_axis_past_its_end(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()

        def garble(data: bytes) -> bytes:
            if (b"A:" not in data and b"D:" not in data) or draw.random() < 0.3:
                return data
            at = draw.randrange(len(data) - 2)
            return data[:at] + str(draw.randrange(10)).encode() + data[at + 1 :]

        async with Watch(bench.clock, bench.unit, "123", 5 * NS_PER_MS) as tracks:
            for _ in range(5):
                bench.wire.to_far = garble
                await asyncio.gather(bench.driver.jog_axis("x", jog(20_000.0, 3_000)), return_exceptions=True)
                await sleep_ns(bench.clock, 300 * NS_PER_MS)
                bench.wire.to_far = None
                await bench.driver.stop_axes(["x"])
                await rested(bench)
                await bench.driver.poll()
        assert tracks["1"].between(0, 3_000) and tracks["1"].fastest <= 20_000
        assert tracks["2"].fastest == tracks["3"].fastest == 0

    run(case, seed=seed)


def hands(bench: Bench, names: str, seed: int) -> list[Hand]:
    return [
        Hand(bench.clock, bench.driver, bench.unit, name, NAMES[name], Random(f"{seed}{name}"), RAMP, STOP_NS)
        for name in names
    ]


@pytest.mark.parametrize("seed", share_with_nightly(range(75), 15))
def test_random_jogs_never_exceed_the_limit_nor_the_speed(seed: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        (hand,) = hands(bench, "x", seed)
        watch = Watch(bench.clock, bench.unit, "1", 2 * NS_PER_MS)
        async with watch as tracks, Polling(bench.clock, bench.driver.poll):
            await hand.play(15)
        await hand.check(tracks["1"])

    run(case, seed=seed, simulate=KNOBS[seed % len(KNOBS)], timing=FirmwareTiming(1_000_000, seed % 3 * 1_000_000))


@pytest.mark.parametrize("seed", share_with_nightly(range(30), 10))
def test_three_jogs_and_a_stop_of_all(seed: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        all_three = hands(bench, "xyz", seed)
        watch = Watch(bench.clock, bench.unit, "123", 2 * NS_PER_MS)
        stops = Polling(bench.clock, lambda: bench.driver.stop(abort=False), 0.5 + seed % 2)
        async with watch as tracks, stops, Polling(bench.clock, bench.driver.poll):
            await asyncio.gather(*(hand.play(12, alone=False) for hand in all_three))
        for hand in all_three:
            await hand.check(tracks[hand.motor])

    run(case, seed=seed, simulate=KNOBS[seed % len(KNOBS)])
