"""Manual motion of the SMC's axes: speeds, ends, several at once, stops at every moment."""

import asyncio
import contextlib
from random import Random

import pytest
from unit.adapters.ppsmc_bench import NAMES, Bench, controller, run

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal


@pytest.mark.parametrize("end", [None, 20_000])
@pytest.mark.parametrize("sign", [1, -1])
def test_an_axis_jogs_at_its_speed_and_stops_by_its_ramp_or_at_its_end(sign: int, end: int | None) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("y", JogMove(sign * 8000.0, 40_000.0, None if end is None else sign * end))
        fastest = 0.0
        for _ in range(150):
            await sleep_ns(bench.clock, 10 * NS_PER_MS)
            fastest = max(fastest, abs(bench.unit.velocity("2")) * 1000)
        assert 7900 < fastest <= 8001
        if end is None:
            await bench.driver.stop_axes(["y"])
            await sleep_ns(bench.clock, 300 * NS_PER_MS)
            assert not bench.moving and sign * bench.steps("y") > 8000
        else:
            await bench.rest()
            assert bench.steps("y") == sign * end
            with pytest.raises(Refusal) as caught:
                await bench.driver.jog_axis("y", JogMove(sign * 8000.0, 40_000.0, sign * end))
            assert caught.value.code == "at-end"

    run(case)


def test_axes_jog_independently_and_change_and_stop_alone() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", JogMove(5000.0, 40_000.0, 30_000))
        await bench.driver.jog_axis("y", JogMove(-3000.0, 40_000.0, None))
        assert bench.unit.is_moving("1") and bench.unit.is_moving("2")
        await bench.driver.jog_axis(
            "y", JogMove(3000.0, 40_000.0, None)
        )  # with the same speeds: only y stops in between
        await sleep_ns(bench.clock, 500 * NS_PER_MS)
        assert bench.unit.velocity("2") > 0 and bench.unit.is_moving("1")
        before = len(bench.moved())
        await bench.driver.jog_axis("y", JogMove(3000.0, 40_000.0, None))
        assert len(bench.moved()) == before
        await bench.driver.stop_axes(["y"])
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        assert not bench.unit.is_moving("2") and bench.unit.is_moving("1")
        await bench.rest(20 * NS_PER_S)
        assert bench.steps("x") == 30_000
        await bench.driver.poll()
        assert (await bench.move({"x": 0, "y": 0})).state == "done"

    run(case)


@pytest.mark.parametrize(
    ("move", "code"),
    [
        (JogMove(50.0, 40_000.0, None), "too-slow"),
        (JogMove(-5000.0, 40_000.0, 0), "at-end"),
        (JogMove(-5000.0, 40_000.0, 100), "at-end"),
    ],
)
def test_an_impossible_jog_is_refused_and_nothing_moves(move: JogMove, code: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        with pytest.raises(Refusal) as caught:
            await bench.driver.jog_axis("x", move)
        assert caught.value.code == code and caught.value.remedy
        assert not bench.moved()

    run(case)


def test_another_motion_a_program_a_block_and_the_input_gate_are_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        move = JogMove(5000.0, 40_000.0, None)
        await bench.send_as_other_client("move1:30")
        with pytest.raises(Refusal, match="moving"):
            await bench.driver.jog_axis("x", move)
        await bench.rest(60 * NS_PER_S)
        await bench.send_as_other_client("clr", "in0.1", "nl", "end", "start:")
        with pytest.raises(Refusal, match="program"):
            await bench.driver.jog_axis("x", move)
        await bench.send_as_other_client("q", "emips1:1")
        with pytest.raises(Refusal, match="does not move") as caught:
            await bench.driver.jog_axis("x", move)
        assert caught.value.code == "not-started" and "emips" in caught.value.remedy
        await bench.send_as_other_client("emips1:-1", "block")
        with pytest.raises(Refusal, match="blocked"):
            await bench.driver.jog_axis("x", move)
        await bench.driver.clear_faults()
        await bench.driver.jog_axis("x", move)
        assert bench.unit.is_moving("1")
        await bench.driver.stop(abort=False)

    run(case)


def test_an_armed_step_is_not_started_by_a_jog() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 5000})
        with pytest.raises(Refusal) as caught:
            await bench.driver.jog_axis("y", JogMove(5000.0, 40_000.0, None))
        assert caught.value.code == "busy" and not bench.moved()

    run(case)


def test_a_limit_switch_ends_a_jog_and_allows_the_way_back() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", JogMove(5000.0, 40_000.0, None))
        await bench.rest()
        assert (await bench.driver.poll()).axes["x"].limit == "forward"
        with pytest.raises(Refusal, match="limit"):
            await bench.driver.jog_axis("x", JogMove(5000.0, 40_000.0, None))
        await bench.driver.jog_axis("x", JogMove(-5000.0, 40_000.0, 0))
        await bench.rest()
        assert bench.steps("x") == 0

    run(case, simulate={"travel_steps": {"1": (-3000, 3000)}})


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("after_ms", [0, 10, 40, 90, 150, 240, 400])
def test_a_stop_at_every_stage_of_a_jog_leaves_it_at_rest(after_ms: int, abort: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("y", JogMove(4000.0, 40_000.0, None))
        jogging = asyncio.get_running_loop().create_task(bench.driver.jog_axis("x", JogMove(8000.0, 40_000.0, None)))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        await bench.driver.stop(abort=abort)
        with contextlib.suppress(Refusal, ControllerFault):
            await jogging
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moving
        rests = bench.steps("x"), bench.steps("y")
        await sleep_ns(bench.clock, NS_PER_S)
        assert rests == (bench.steps("x"), bench.steps("y"))
        await bench.driver.clear_faults()
        await bench.driver.jog_axis("x", JogMove(-8000.0, 40_000.0, None))
        await bench.driver.stop(abort=False)

    run(case, seed=after_ms)


@pytest.mark.parametrize("seed", range(6))
def test_random_jogs_never_exceed_the_limit_nor_the_speed(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        allowed = dict.fromkeys(NAMES, 0.0)
        for _ in range(20):
            name = draw.choice("xyz")
            speed = draw.uniform(500, 15_000) * draw.choice((-1, 1))
            allowed[name] = max(allowed[name], abs(speed))
            with contextlib.suppress(Refusal):
                await bench.driver.jog_axis(
                    name, JogMove(speed, draw.uniform(5000, 100_000), 9000 if speed > 0 else -9000)
                )
            for _ in range(draw.randrange(30)):
                await sleep_ns(bench.clock, 10 * NS_PER_MS)
                for other, motor in NAMES.items():
                    assert abs(bench.unit.velocity(motor)) * 1000 <= allowed[other] * (1 + 1e-3)
                    assert abs(bench.unit.position(motor)) * 1000 <= 9000 + 1e-6
            if draw.random() < 0.3:
                await bench.driver.stop_axes([name])
        await bench.driver.stop(abort=False)
        await bench.rest()

    run(case, seed=seed)


def test_an_axis_gentler_than_the_slowest_ramp_jogs_at_a_start_speed() -> None:
    axis = {"limits": {"velocity": 50, "acceleration": 0.5}, "start_rate": {"min": 0.1, "max": 2}}

    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", JogMove(9000.0, 500.0, None))
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        assert bench.unit.velocity("1") == pytest.approx(2.0)
        await bench.driver.stop(abort=False)

    run(case, config=controller(axis=axis))


@pytest.mark.parametrize("cycled", [False, True])
def test_a_controller_that_was_restarted_since_the_last_jog_starts_none(cycled: bool) -> None:
    """It has lost the loaded speeds, and reports its present position as 0."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.jog_axis("x", JogMove(8000.0, 40_000.0, 3000))
        await bench.rest()
        if cycled:
            bench.unit.set_power(on=False)
            bench.unit.set_power(on=True)
        before = len(bench.moved())
        jog = bench.driver.jog_axis("x", JogMove(-8000.0, 40_000.0, -1000))
        if cycled:
            with pytest.raises(Refusal) as caught:
                await jog
            assert caught.value.code == "not-started"
            assert len(bench.moved()) == before and not bench.moving
        else:
            await jog
            await bench.rest()
            assert bench.steps("x") == -1000

    run(case, config=controller(serial=True))
