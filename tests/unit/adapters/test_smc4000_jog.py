"""Manual motion of an SMC-4000's axes, in virtual time; judged by the simulator's ground truth."""

import asyncio
from itertools import pairwise
from random import Random
from typing import Any

import pytest
from unit.adapters.test_smc4000_bench import World, run, trapezoid
from unit.adapters.watching import Hand, Polling, Watch, at_rest
from unit.random_rounds import share_with_nightly

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal

RAMP = 400_000.0  # counts/s²
EXACT = 1 + 1e-9
STOP_NS = 5 * NS_PER_MS  # from a stop's bytes to the first slower sample, over the LAN of these tests


def jog(speed: float, end: int | None = None, ramp: float = RAMP) -> JogMove:
    return JogMove(speed, ramp, end)


async def rested(world: World, axis: str = "X", within_s: float = 3.0) -> float:
    await at_rest(world.clock, world.controller, axis, round(within_s * NS_PER_S))
    return world.controller.position(axis)


@pytest.mark.parametrize("end", [None, 500_000])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_axis_jogs_at_its_speed_and_stops_by_its_ramp(end: int | None, sign: int):
    async def main(world: World) -> None:
        await world.ready()
        async with Watch(world.clock, world.controller, "XY") as tracks:
            await world.driver.jog_axis("x", jog(sign * 30_001.0, end and sign * end))
            await sleep_ns(world.clock, 500 * NS_PER_MS)
            reading = await world.driver.poll()
            assert reading.axes["x"].moving and not reading.axes["y"].moving
            assert world.controller.velocity("X") * sign == pytest.approx(30_000, abs=8)
            await world.driver.stop_axes(["x"])
            ordered_ns = world.clock.now_ns()
            await rested(world)
        assert tracks["X"].fastest <= 30_001 * EXACT
        assert tracks["X"].steepest() <= RAMP * 1.01
        assert tracks["Y"].fastest == 0
        (motion,) = world.controller.commanded_motions
        assert motion.slowing_ns is not None and motion.end_ns is not None
        assert 0 < motion.slowing_ns - ordered_ns < STOP_NS
        assert motion.end_ns - motion.slowing_ns == pytest.approx(30_000 / RAMP * NS_PER_S, rel=0.02)
        assert not (await world.driver.poll()).axes["x"].moving

    run(main)


@pytest.mark.parametrize(("speed", "end"), [(30_000, 10_000), (-90_000, -25_001), (2_000, 7), (12e6, 3), (5.0, 2)])
def test_a_jog_comes_to_rest_exactly_at_the_end_of_travel_without_another_command(speed: float, end: int):
    async def main(world: World) -> None:
        await world.ready()
        async with Watch(world.clock, world.controller, "X") as tracks:
            await world.driver.jog_axis("x", jog(speed, end))
            world.wire.cut = True
            assert await rested(world, within_s=5) == end
        assert tracks["X"].between(min(0, end), max(0, end))

    run(main)


@pytest.mark.parametrize("end", [None, 90_000])
def test_its_speed_is_changed_while_it_moves(end: int | None):
    async def main(world: World) -> None:
        await world.ready()
        async with Watch(world.clock, world.controller, "X") as tracks:
            for speed in (10_000.0, 40_000.0, 5_000.0, 5_000.0, 20_000.0):
                await world.driver.jog_axis("x", jog(speed, end))
                await sleep_ns(world.clock, 200 * NS_PER_MS)
                assert world.controller.velocity("X") == pytest.approx(speed, abs=10)
        assert len(world.controller.commanded_motions) == 1
        assert tracks["X"].steepest() <= RAMP * 1.01
        await world.driver.stop_axes(["x"])
        assert await rested(world) < 90_000

    run(main)


@pytest.mark.parametrize("ends", [(None, None), (80_000, -3_000), (80_000, None), (None, -3_000)])
def test_its_direction_is_changed(ends: tuple[int | None, int | None]):
    async def main(world: World) -> None:
        await world.ready()
        async with Watch(world.clock, world.controller, "X") as tracks:
            for sign, end in zip((1, -1), ends, strict=True):
                await world.driver.jog_axis("x", jog(sign * 30_000.0, end))
                await sleep_ns(world.clock, 300 * NS_PER_MS)
                assert world.controller.velocity("X") == pytest.approx(sign * 30_000, abs=10)
        assert tracks["X"].steepest() <= RAMP * 1.01
        if ends[1] is not None:
            assert await rested(world) == ends[1]

    run(main)


def test_a_gentler_ramp_and_a_nearer_end_require_a_stop():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.jog_axis("x", jog(40_000.0, 80_000))
        await sleep_ns(world.clock, 300 * NS_PER_MS)
        async with Watch(world.clock, world.controller, "X") as tracks:
            await world.driver.jog_axis("x", jog(40_000.0, 60_000, RAMP / 4))
            began_ns = world.clock.now_ns()
            assert await rested(world) == 60_000
        late = [v for at, v in zip(tracks["X"].at_ns, tracks["X"].velocities, strict=True) if at > began_ns]
        assert max(abs(b - a) for a, b in pairwise(late)) <= RAMP / 4 * 1.01e-3

    run(main)


def test_axes_jog_independently_and_stop_alone():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.jog_axis("x", jog(30_000.0, 80_000))
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        await world.driver.jog_axis("y", jog(-20_000.0))
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        await world.driver.stop_axes(["x"])
        await rested(world)
        assert world.controller.velocity("Y") == pytest.approx(-20_000, abs=8)
        await world.driver.jog_axis("x", jog(-10_000.0, -500))
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        await world.driver.stop(abort=False)
        await rested(world)
        await rested(world, "Y")
        assert not world.controller.is_moving("X")

    run(main)


def test_nothing_is_stopped_if_no_axis_is_named():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.jog_axis("x", jog(30_000.0))
        await world.driver.stop_axes([])
        await sleep_ns(world.clock, 500 * NS_PER_MS)
        assert world.controller.is_moving("X")

    run(main)


@pytest.mark.parametrize(
    ("move", "code"),
    [
        (JogMove(1.0, RAMP, None), "too-slow"),
        (JogMove(100.0, 1000.0, None), "too-gentle"),
        (JogMove(100.0, RAMP, 0), "at-end"),
        (JogMove(100.0, RAMP, -40), "at-end"),
        (JogMove(-100.0, RAMP, 40), "at-end"),
    ],
)
def test_an_impossible_jog_is_refused_and_nothing_moves(move: JogMove, code: str):
    async def main(world: World) -> None:
        await world.ready()
        with pytest.raises(Refusal) as refused:
            await world.driver.jog_axis("x", move)
        assert refused.value.code == code
        await sleep_ns(world.clock, NS_PER_S)
        assert not world.controller.commanded_motions

    run(main)


def test_a_refusal_names_what_would_fit():
    async def main(world: World) -> None:
        await world.ready()
        for move in (JogMove(-1.0, RAMP, None), JogMove(900.0, 900.0, None)):
            with pytest.raises(Refusal) as refused:
                await world.driver.jog_axis("x", move)
            least = float(refused.value.remedy.split()[2]) * 1.0001
            fits = JogMove(least, RAMP, None) if move.velocity_counts_s < 0 else JogMove(900.0, least, None)
            await world.driver.jog_axis("x", fits)
            await world.driver.stop_axes(["x"])
            await rested(world)

    run(main)


def test_a_motor_that_is_off_and_an_axis_that_moves_otherwise_are_refused():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_enabled(["x"], on=False)
        with pytest.raises(Refusal, match="motor off"):
            await world.driver.jog_axis("x", jog(1000.0))
        for line in ("PRY=50000", "SPY=20000", "BGY"):
            await world.talk(line)
        with pytest.raises(Refusal, match="is moving"):
            await world.driver.jog_axis("y", jog(1000.0))
        assert [motion.axis for motion in world.controller.commanded_motions] == ["Y"]

    run(main)


@pytest.mark.parametrize("end", [None, 90_000])
def test_a_limit_switch_ends_a_jog_and_allows_the_way_back(end: int | None):
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.jog_axis("x", jog(30_000.0, end))
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        world.controller.set_limit("X", "forward")
        stopped_at = await rested(world)
        reading = await world.driver.poll()
        assert reading.axes["x"].limit == "forward" and not reading.faults
        with pytest.raises(Refusal, match="Limit Switch"):
            await world.driver.jog_axis("x", jog(30_000.0, end))
        await world.driver.jog_axis("x", jog(-30_000.0, end and -end))
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        assert world.controller.position("X") < stopped_at
        assert world.controller.is_moving("X")

    run(main, options={"home_edge": {"X": 3000}})


def test_after_jogs_a_step_and_homing_work_as_before():
    async def main(world: World) -> None:
        await world.ready()
        for end in (None, 20_000):
            await world.driver.jog_axis("x", jog(10_000.0, end))
            await sleep_ns(world.clock, 200 * NS_PER_MS)
            await world.driver.stop_axes(["x"])
            start = round(await rested(world))
            _, _, outcome, _ = await world.moved({"x": trapezoid(start, start + 5000, 80_000, 700_000)})
            assert outcome.state == "done"
            assert world.controller.position("X") == start + 5000
        await world.driver.jog_axis("x", jog(10_000.0))
        with pytest.raises(Refusal):
            await world.driver.home_axes(["x"], lambda _: None)
        await world.driver.stop_axes(["x"])
        await rested(world)
        assert not await world.driver.home_axes(["x"], lambda _: None)
        assert (await world.driver.poll()).axes["x"].commanded_counts == 0

    run(main, options={"home_edge": {"X": 3000}, "index_every": {"X": 2000}})


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("after_us", [*range(0, 12_000, 1500)])
def test_a_stop_at_every_stage_of_a_jog_leaves_it_at_rest(after_us: int, abort: bool):
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.jog_axis("y", jog(5_000.0))
        begun = asyncio.create_task(world.driver.jog_axis("x", jog(20_000.0, 50_000)))
        await sleep_ns(world.clock, after_us * 1000)
        if abort:
            await world.driver.stop(abort=True)
        else:
            await world.driver.stop_axes(["x"])
        (outcome,) = await asyncio.gather(begun, return_exceptions=True)
        assert outcome is None or isinstance(outcome, Refusal)
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        assert not world.controller.is_moving("X")
        assert world.controller.is_moving("Y") != abort
        assert world.controller.position("X") < 700
        await world.driver.jog_axis("x", jog(20_000.0, 50_000))
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert world.controller.is_moving("X")

    run(main, seed=after_us)


@pytest.mark.parametrize("after_us", [*range(0, 30_000, 2100)])
def test_a_stop_while_the_direction_is_changed_leaves_it_at_rest(after_us: int):
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.jog_axis("x", jog(5_000.0, 50_000))
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        turned = asyncio.create_task(world.driver.jog_axis("x", jog(-5_000.0, -50_000)))
        await sleep_ns(world.clock, after_us * 1000)
        await world.driver.stop_axes(["x"])
        await asyncio.gather(turned, return_exceptions=True)
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert not world.controller.is_moving("X")

    run(main, seed=after_us)


@pytest.mark.parametrize("after_us", [*range(100, 12_000, 2100)])
def test_a_jog_that_is_cancelled_and_stopped_leaves_the_driver_usable(after_us: int):
    async def main(world: World) -> None:
        await world.ready()
        begun = asyncio.create_task(world.driver.jog_axis("x", jog(20_000.0, 50_000)))
        await sleep_ns(world.clock, after_us * 1000)
        begun.cancel()
        await asyncio.gather(begun, return_exceptions=True)
        await world.driver.stop_axes(["x"])
        await sleep_ns(world.clock, 300 * NS_PER_MS)
        assert not world.controller.is_moving("X")
        await world.driver.poll()
        await world.driver.jog_axis("x", jog(20_000.0, 50_000))
        assert await rested(world, within_s=5) == 50_000

    run(main, seed=after_us)


def test_a_cancelled_jog_start_stops_by_itself():
    async def main(world: World) -> None:
        await world.ready()

        def gone(data: bytes) -> bytes:
            if b"BGX" in data:
                world.wire.to_near = lambda _: b""
                asyncio.get_running_loop().call_later(0.01, begun.cancel)
            return data

        world.wire.to_far = gone
        begun = asyncio.create_task(world.driver.jog_axis("x", jog(20_000.0)))
        await asyncio.gather(begun, return_exceptions=True)
        assert begun.cancelled()
        await sleep_ns(world.clock, 300 * NS_PER_MS)
        assert world.controller.commanded_motions and not world.controller.is_moving("X")

    run(main)


KNOBS: list[dict[str, Any]] = [{}, {"qr_axis_bytes": 28, "question_crlf": True}, {"sign_column": False}, {"axes": 2}]


def hands(world: World, names: str, seed: int) -> list[Hand]:
    return [
        Hand(world.clock, world.driver, world.controller, name, name.upper(), Random(f"{seed}{name}"), RAMP, STOP_NS)
        for name in names
    ]


@pytest.mark.parametrize("seed", share_with_nightly(range(100), 4))
def test_random_jogs_never_exceed_the_limit_nor_the_speed(seed: int):
    async def main(world: World) -> None:
        await world.ready(3)
        (hand,) = hands(world, "x", seed)
        watch = Watch(world.clock, world.controller, "X", 2 * NS_PER_MS)
        async with watch as tracks, Polling(world.clock, world.driver.poll):
            await hand.play(25)
        await hand.check(tracks["X"])

    run(main, seed=seed, ppm=Random(seed).uniform(-95, 95), options=KNOBS[seed % len(KNOBS)])


@pytest.mark.parametrize("seed", [*range(5), *(pytest.param(n, marks=pytest.mark.nightly) for n in range(5, 50))])
def test_two_jogs_and_a_stop_of_all(seed: int):
    async def main(world: World) -> None:
        await world.ready(3)
        both = hands(world, "xy", seed)
        watch = Watch(world.clock, world.controller, "XY", 2 * NS_PER_MS)
        stops = Polling(world.clock, lambda: world.driver.stop(abort=False), 1.0 + seed % 3)
        async with watch as tracks, stops, Polling(world.clock, world.driver.poll):
            await asyncio.gather(*(hand.play(20, alone=False) for hand in both))
        for hand in both:
            await hand.check(tracks[hand.motor])

    run(main, seed=seed, ppm=Random(seed).uniform(-95, 95))
