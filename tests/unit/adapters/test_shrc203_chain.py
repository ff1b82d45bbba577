"""Chains of prebuffered moves, judged by the simulator's ground truth."""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from random import Random
from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import NAMES, Bench, controller, run

from adapters.shrc203.chain import ChainReport
from adapters.shrc203.chain_axis import ChainMove
from adapters.shrc203.fleetaxes import axis_bounds
from adapters.shrc203.shapes.trapezoid import ShrcTrapezoid, fit_trapezoid
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal
from sim.core.controller import CommandedMotion

CONFIG = controller("xyz", **{"inputs": {"start": {"number": 1}}})
DURATION_S = 0.030


def chain_of(draw: Random, count: int, duration_s: float = DURATION_S) -> list[ChainMove]:
    """Moves of different distances, so that none can be taken for another."""
    moves: list[ChainMove] = []
    for _ in range(count):
        distance = draw.randrange(100, 800) * draw.choice((1, -1))
        shape = fit_trapezoid(abs(distance), duration_s, 0.004, axis_bounds(CONFIG.axes["x"]))
        assert shape is not None
        moves.append(ChainMove(distance, shape))
    return moves


def made(bench: Bench, axis: str) -> list[CommandedMotion]:
    return [each for each in bench.unit.commanded_motions if each.axis == NAMES[axis]]


def executed_once(bench: Bench, moves: Mapping[str, Sequence[ChainMove]]) -> None:
    for axis, each in moves.items():
        ways = [round((m.end_counts or 0) - m.start_counts) for m in made(bench, axis)]
        assert ways == [move.distance for move in each]


@pytest.mark.parametrize("axes", ["x", "xz", "xyz"])
@pytest.mark.parametrize("seed", range(5))
def test_every_move_is_executed_once_in_order_and_without_a_gap(axes: str, seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        moves = {axis: chain_of(draw, draw.randrange(3, 40), 0.025 if len(axes) < 3 else 0.045) for axis in axes}
        said: list[str] = []
        report = await bench.driver.run_chain(moves, said.append)
        assert report.reason == "" and not report.underruns and not said
        assert report.done == {axis: len(each) for axis, each in moves.items()}
        assert report.least_ahead_ns is not None and report.least_ahead_ns > 0
        executed_once(bench, moves)
        for axis in axes:
            motions = made(bench, axis)
            for one, following in pairwise(motions):
                assert one.end_ns is not None and 0 <= following.start_ns - one.end_ns < 2 * NS_PER_MS
        assert len({made(bench, axis)[0].start_ns for axis in axes}) == 1
        reading = await bench.driver.poll()
        for axis, each in moves.items():
            assert reading.axes[axis].commanded_counts == sum(move.distance for move in each)
        await bench.start({"x": 0})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, seed=seed, config=CONFIG, ppm=90.0)


@pytest.mark.parametrize("hold_ms", [0, 16, 60])
@pytest.mark.parametrize("longest_ms", [3, 8])
@pytest.mark.parametrize("axes", ["x", "xyz"])
def test_a_chain_that_runs_dry_is_reported_and_continues_with_no_move_lost(
    axes: str, longest_ms: int, hold_ms: int
) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(hold_ms)
        await bench.ready()
        ways = range(1, longest_ms + 1)  # a pulse takes a millisecond
        moves = {
            axis: [ChainMove(way, ShrcTrapezoid(way, 1000, 1000, 1)) for way in draw.choices(ways, k=12)]
            for axis in axes
        }
        said: list[str] = []
        report = await bench.driver.run_chain(moves, said.append)
        assert report.reason == ""
        assert report.done == {axis: len(each) for axis, each in moves.items()}
        executed_once(bench, moves)
        gaps = 0
        for axis in axes:
            motions = made(bench, axis)
            pairs = pairwise(motions)
            gaps += sum(following.start_ns - (one.end_ns or 0) > 2 * NS_PER_MS for one, following in pairs)
        assert len(report.underruns) == len(said) == gaps > 0
        assert "too late" in said[0]

    run(case, config=CONFIG, hold_ns=hold_ms * NS_PER_MS)


@pytest.mark.parametrize("in_a_row", [1, 2, 5])
@pytest.mark.parametrize("lose", range(1, 6))
def test_lost_completion_lines_lose_no_move(lose: int, in_a_row: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        moves = {"x": chain_of(Random(lose), 5)}
        left = lose

        def one_lost(data: bytes) -> bytes:
            nonlocal left
            left -= data == b"1\r\n"
            return b"" if -in_a_row < left <= 0 and data == b"1\r\n" else data

        bench.wire.to_near = one_lost
        report = await bench.driver.run_chain(moves)
        bench.wire.to_near = None
        assert report.reason == ""
        assert report.done == {"x": 5}
        executed_once(bench, moves)

    run(case, config=CONFIG)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("after_ms", [1, 40, 90, 105, 111])
@pytest.mark.parametrize("simulate", [{}, {"stop_keeps_prebuffer": True}, {"completion_after_stop": False}], ids=str)
def test_a_stop_ends_the_chain_and_leaves_nothing_queued(simulate: dict[str, Any], after_ms: int, abort: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        moves = {"x": chain_of(Random(1), 50), "y": chain_of(Random(2), 50)}
        task = bench.clock.loop.create_task(bench.driver.run_chain(moves))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        await bench.driver.stop(abort=abort)
        stopped_ns = bench.clock.now_ns()
        reason = ""
        try:
            reason = (await task).reason
        except Refusal as error:
            assert not bench.moved(), error
        await bench.driver.clear_faults()
        await bench.driver.set_enabled(["x", "y", "z"], on=True)
        await bench.driver.poll()
        await bench.driver.poll()
        before = len(bench.unit.commanded_motions)
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        assert not [each for each in bench.unit.commanded_motions[before:] if each.end_counts != each.start_counts]
        assert all(each.start_ns < stopped_ns + 40 * NS_PER_MS for each in bench.moved())
        assert reason == "stopped on request" or not bench.moved()
        await bench.start({"x": 0})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, config=CONFIG, simulate=simulate)


def test_a_limit_switch_breaks_the_chain() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        shape = fit_trapezoid(3000, 0.05, 0.01, axis_bounds(CONFIG.axes["x"]))
        assert shape is not None
        task = bench.clock.loop.create_task(bench.driver.run_chain({"x": [ChainMove(3000, shape)] * 30}))
        await sleep_ns(bench.clock, 400 * NS_PER_MS)
        bench.unit.set_limit("1", "forward")
        report: ChainReport = await task
        assert "limit" in report.reason and report.done["x"] < 30

    run(case, config=CONFIG)


@pytest.mark.parametrize("moves", [{}, {"x": []}, {"w": [ChainMove(5, ShrcTrapezoid(5, 100, 100, 1))]}], ids=str)
def test_an_empty_chain_is_refused_and_leaves_the_controller_free(moves: dict[str, list[ChainMove]]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        with pytest.raises(Refusal) as caught:
            await bench.driver.run_chain(moves)
        assert caught.value.code == "bad-chain" and caught.value.remedy
        await bench.start({"x": 100})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, config=CONFIG)


def test_nothing_else_is_armed_or_jogged_while_a_chain_runs() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        task = bench.clock.loop.create_task(bench.driver.run_chain({"x": chain_of(Random(3), 30)}))
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        with pytest.raises(Refusal) as caught:
            await bench.arm({"y": 500})
        assert caught.value.code == "busy"
        assert (await bench.driver.poll()).axes["x"].moving
        assert (await task).reason == ""

    run(case, config=CONFIG)


@pytest.mark.parametrize("axes", ["x", "xyz"])
@pytest.mark.parametrize("seed", range(4))
def test_a_continuously_polled_chain_makes_every_move(seed: int, axes: str) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        moves = {
            axis: [ChainMove(way, ShrcTrapezoid(way, 1000 - way, 1000, 2)) for way in draw.choices(range(12, 18), k=60)]
            for axis in axes
        }
        task = bench.clock.loop.create_task(bench.driver.run_chain(moves))
        while not task.done():
            await bench.driver.poll()
            await sleep_ns(bench.clock, draw.randrange(60) * NS_PER_MS)
        report = await task
        assert report.reason == ""
        executed_once(bench, moves)

    run(case, seed=seed, config=CONFIG)


def test_a_controller_with_one_axis_chains_moves_of_a_few_pulses() -> None:
    """There the answers to queries of distances would read like completion lines."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        moves = {"x": [ChainMove(way, ShrcTrapezoid(way, 30, 60, 2)) for way in (1, 2, 3, 1, 2, 3)]}
        report = await bench.driver.run_chain(moves)
        assert report.reason == ""
        executed_once(bench, moves)

    run(case, config=controller("x"), simulate={"controllable": [1]})


@pytest.mark.parametrize(
    ("move", "code"),
    [
        (ChainMove(500, ShrcTrapezoid(400, 100, 1000, 10)), "bad-move"),
        (ChainMove(500, ShrcTrapezoid(500, 100, 200_000, 1000)), "ok"),
        (ChainMove(90_000, ShrcTrapezoid(90_000, 100, 200_000, 1)), "velocity-limit"),
        (ChainMove(500, ShrcTrapezoid(500, 90_000, 90_000, 1)), "velocity-limit"),
        (ChainMove(5000, ShrcTrapezoid(5000, 100, 50_000, 10)), "acceleration-limit"),
        (ChainMove(-5000, ShrcTrapezoid(5000, 100, 10_000, 50)), "soft-limit"),
    ],
)
def test_a_chain_beyond_the_limits_is_refused_before_it_starts(move: ChainMove, code: str) -> None:
    config = CONFIG.model_copy(deep=True)
    axis = config.axes["x"].model_validate(
        {**config.axes["x"].model_dump(), "soft_limits": {"min": -0.001, "max": 1.0}}
    )
    config = config.model_copy(update={"axes": {**config.axes, "x": axis}})

    async def case(bench: Bench) -> None:
        await bench.ready()
        if code == "ok":
            assert (await bench.driver.run_chain({"x": [move]})).reason == ""
            return
        with pytest.raises(Refusal) as caught:
            await bench.driver.run_chain({"x": [move]})
        assert caught.value.code == code
        assert not bench.moved()

    run(case, config=config)


@pytest.mark.parametrize("axes", ["x", "xyz"])
@pytest.mark.parametrize("nth", range(1, 5))
def test_a_garbled_load_is_detected_and_the_chain_ends(nth: int, axes: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        moves = {axis: [ChainMove(300, ShrcTrapezoid(300, 1000, 20_000, 45))] * 8 for axis in axes}
        left = nth

        def garble(data: bytes) -> bytes:
            nonlocal left
            left -= data.startswith(b"MP:1")
            return data.replace(b"P300", b"P900") if left == 0 and data.startswith(b"MP:1") else data

        bench.wire.to_far = garble
        if nth == 1:
            with pytest.raises(Refusal) as caught:
                await bench.driver.run_chain(moves)
            assert caught.value.code == "load-garbled" and not bench.moved()
            return
        report = await bench.driver.run_chain(moves)
        bench.wire.to_far = None
        assert "900" in report.reason and report.done["x"] < 8
        assert not [each for each in made(bench, "x") if (each.end_counts or 0) - each.start_counts > 400]

    run(case, config=CONFIG)


@pytest.mark.parametrize("seed", range(12))
def test_on_a_noisy_line_a_chain_reports_where_it_broke_or_has_made_every_move(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        moves = {axis: chain_of(draw, 20, 0.05) for axis in "xy"}

        def garble(data: bytes) -> bytes:
            return bytes(draw.randrange(256) if draw.random() < 0.002 else each for each in data)

        bench.wire.to_far = bench.wire.to_near = garble
        try:
            reason = (await bench.driver.run_chain(moves)).reason
        except (Refusal, ControllerFault) as error:
            reason = str(error)
        bench.wire.to_far = bench.wire.to_near = None
        await sleep_ns(bench.clock, 3 * NS_PER_S)
        if not reason:
            executed_once(bench, moves)
        assert bench.unit.at_rest()
        await bench.driver.slots.unload()
        before = len(bench.unit.commanded_motions)
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        assert not [each for each in bench.unit.commanded_motions[before:] if each.end_counts != each.start_counts]

    run(case, config=CONFIG)
