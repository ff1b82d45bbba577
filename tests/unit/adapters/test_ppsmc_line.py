"""Starts by an input after a program, and outputs that are switched at T0, judged by the simulator's ground truth."""

import contextlib
from random import Random
from typing import Any

import pytest
from unit.adapters.ppsmc_bench import NAMES, Bench, controller, run

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions, TriggerDrive, TriggerWait

POINTS: dict[str, Any] = {
    "inputs": {"start": {"number": 2}, "low": {"number": 5, "active": "low"}},
    "outputs": {"line": {"number": 3}, "low": {"number": 6, "active": "low"}},
    "options": {"io_port": True},
}
CONFIG = controller("xyz", **POINTS)
WINDOW = TriggerWait(input="start", earliest_ns=-2 * NS_PER_MS, latest_ns=3 * NS_PER_MS)
DRIVE = TriggerDrive(output="line", active_ns=150 * NS_PER_MS)


def raise_at(bench: Bench, at_ns: int, number: int = 2, level: bool = True) -> None:
    bench.clock.call_at_ns(at_ns, lambda: bench.unit.set_input(number, level=level))


@pytest.mark.parametrize("seed", range(8))
def test_the_edge_starts_all_axes_within_the_reported_intervals(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        for _ in range(3):
            bench.unit.set_input(2, level=False)
            targets = {name: draw.randrange(-60_000, 60_000) for name in draw.sample("xyz", draw.randint(1, 3))}
            before = len(bench.moved())
            t0_ns, lowered = await bench.start(targets, StartOptions(wait=WINDOW))
            earliest_ns, latest_ns = lowered.window_ns
            raise_at(bench, t0_ns + draw.randrange(WINDOW.earliest_ns, WINDOW.latest_ns))
            started, outcome = await bench.followed()
            assert outcome.state == "done", outcome
            truth = {each.axis: each for each in bench.moved()[before:]}
            for name, target in targets.items():
                motion = truth[NAMES[name]]
                assert bench.steps(name) == target and motion.end_ns is not None
                assert earliest_ns <= motion.start_ns - t0_ns <= latest_ns
                assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
                assert outcome.ended[name].earliest_ns <= motion.end_ns <= outcome.ended[name].latest_ns

    run(case, seed=seed, config=CONFIG, ppm=Random(seed).uniform(-95, 95))


def test_an_input_that_is_active_low_starts_when_it_falls() -> None:
    async def case(bench: Bench) -> None:
        bench.unit.set_input(5, level=True)
        await bench.ready()
        t0_ns, _ = await bench.start({"y": 3000}, StartOptions(wait=WINDOW.model_copy(update={"input": "low"})))
        raise_at(bench, t0_ns, 5, False)
        assert (await bench.followed())[1].state == "done"

    run(case, config=CONFIG)


def test_an_input_that_is_active_already_is_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_input(2, level=True)
        with pytest.raises(Refusal) as caught:
            await bench.arm({"x": 3000}, StartOptions(wait=WINDOW))
        assert caught.value.code == "line-level" and "start" in caught.value.text
        await bench.driver.slots.unload()
        assert not bench.moved()

    run(case, config=CONFIG)


@pytest.mark.parametrize("stage", ["armed", "verified", "released"])
def test_before_go_and_after_disarm_no_edge_starts_anything(stage: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        if stage == "released":
            await bench.start({"x": 9000, "y": 100}, StartOptions(wait=WINDOW))
            await bench.driver.slots.unload()
        else:
            await bench.arm({"x": 9000, "y": 100}, StartOptions(wait=WINDOW))
            if stage == "verified":
                await bench.driver.slots.present.verify()
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, 2 * NS_PER_S)
        assert not bench.moved() and bench.unit.at_rest()
        await bench.driver.slots.unload()
        bench.unit.set_input(2, level=False)
        assert (await bench.move({"x": 50})).state == "done"

    run(case, config=CONFIG)


def test_an_edge_between_the_promise_and_go_is_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 9000}, StartOptions(wait=WINDOW))
        await bench.driver.slots.present.verify()
        bench.unit.set_input(2, level=True)
        with pytest.raises(Refusal, match="active"):
            await bench.driver.slots.present.release()
        await bench.driver.slots.unload()
        assert not bench.moved()

    run(case, config=CONFIG)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("when_ms", [-400, -20, -1, 8, 200])
def test_a_stop_at_any_moment_leaves_no_program_waiting(when_ms: int, abort: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, lowered = await bench.start({"x": 90_000}, StartOptions(wait=WINDOW))
        raise_at(bench, t0_ns)
        await bench.until(t0_ns + when_ms * NS_PER_MS)
        await bench.driver.stop(abort=abort)
        await sleep_ns(bench.clock, lowered.costs.stop_ns)
        assert bench.unit.at_rest()
        rest = bench.steps("x")
        bench.unit.set_input(2, level=False)
        await sleep_ns(bench.clock, NS_PER_S)
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, NS_PER_S)
        assert bench.steps("x") == rest
        with contextlib.suppress(ControllerFault, Refusal):
            await bench.followed()
        await bench.driver.clear_faults()
        await bench.driver.slots.unload()
        assert (await bench.move({"x": 0 if rest else 10})).state == "done"

    run(case, config=CONFIG, seed=when_ms)


def test_a_missing_trigger_edge_is_reported_and_a_late_one_moves_nothing() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 9000}, StartOptions(wait=WINDOW))
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started" and "start" in caught.value.text
        await bench.driver.stop(abort=False)
        await sleep_ns(bench.clock, NS_PER_S)
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved()

    run(case, config=CONFIG)


@pytest.mark.parametrize("before_ms", [40, 100, 250])
@pytest.mark.parametrize("by_line", [True, False])
def test_a_controller_that_is_reset_before_the_start_reports_none(before_ms: int, by_line: bool) -> None:
    """It reports another position for the same place, which is not the start of the move."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        assert (await bench.move({"x": 500})).state == "done"
        moves = len(bench.moved())
        t0_ns, _ = await bench.start({"x": 9000}, StartOptions(wait=WINDOW if by_line else None))
        raise_at(bench, t0_ns)
        await bench.until(t0_ns - before_ms * NS_PER_MS)
        bench.wire.links[-1].write(b"reset\r")
        with pytest.raises(ControllerFault, match="restarted before its start"):
            await bench.driver.slots.present.wait_for_start()
        assert len(bench.moved()) == moves

    run(case, config=CONFIG)


def test_an_edge_long_before_t0_is_not_taken_for_the_start() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, _ = await bench.start({"x": 9000}, StartOptions(wait=WINDOW))
        raise_at(bench, t0_ns - 300 * NS_PER_MS)
        with pytest.raises(ControllerFault, match="too early"):
            await bench.driver.slots.present.wait_for_start()
        await bench.driver.stop(abort=False)

    run(case, config=CONFIG)


def test_a_program_that_may_not_start_is_refused_by_go() -> None:
    """`start` is refused while any limit switch is active and iel is 0 (L2116)."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_limit("3", "forward")
        await bench.arm({"x": 9000}, StartOptions(wait=WINDOW))
        with pytest.raises(Refusal) as caught:
            await bench.driver.slots.present.release()
        assert caught.value.code == "not-waiting" and "iel1" in caught.value.remedy
        await bench.driver.slots.unload()
        await bench.send_as_other_client("iel1")
        t0_ns, _ = await bench.start({"x": 9000}, StartOptions(wait=WINDOW))
        raise_at(bench, t0_ns)
        assert (await bench.followed())[1].state == "done"

    run(case, config=CONFIG)


@pytest.mark.parametrize(
    ("how", "named"),
    [
        (StartOptions(wait=WINDOW.model_copy(update={"input": "gate"})), "start, low"),
        (StartOptions(drive=TriggerDrive(output="gate")), "line, low"),
        (StartOptions(start_class="line"), "line"),
        (StartOptions(start_class="clock"), "clock"),
    ],
)
def test_a_trigger_line_that_cannot_be_used_is_refused(how: StartOptions, named: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        with pytest.raises(Refusal, match=named) as caught:
            await bench.lowered({"x": 100}, how)
        assert caught.value.code == "start-class" and caught.value.remedy

    run(case, config=CONFIG)


def test_without_the_port_there_is_no_start_by_trigger_line() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert bench.driver.capabilities.start_classes == ("host",)
        with pytest.raises(Refusal, match="io_port"):
            await bench.lowered({"x": 100}, StartOptions(wait=WINDOW))
        with pytest.raises(Refusal, match="no i/o port"):
            await bench.driver.set_output(1, on=True)

    run(case)


@pytest.mark.parametrize("targets", [{}, {"x": 40_000}, {"x": -3000, "z": 20_000}], ids=str)
@pytest.mark.parametrize("output", ["line", "low"])
@pytest.mark.parametrize("seed", range(3))
def test_the_output_is_switched_within_the_reported_interval_and_back(
    seed: int, output: str, targets: dict[str, int]
) -> None:
    number, active = (3, True) if output == "line" else (6, False)

    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.send_as_other_client("dout65")  # bit 6, which is active low, and bit 0 of another client
        edges: list[tuple[int, int, bool]] = []
        bench.unit.on_output(lambda bit, level: edges.append((bench.clock.now_ns(), bit, level)))
        how = StartOptions(drive=DRIVE.model_copy(update={"output": output}))
        t0_ns, lowered = await bench.start(targets, how)
        started, outcome = await bench.followed()
        assert outcome.state == "done", outcome
        assert [(bit, level) for _, bit, level in edges] == [(number, active), (number, not active)]
        earliest_ns, latest_ns = (
            sum(each.earliest_ns for each in lowered.edge),
            sum(each.latest_ns for each in lowered.edge),
        )
        assert earliest_ns <= edges[0][0] - t0_ns <= latest_ns
        assert edges[1][0] - edges[0][0] >= DRIVE.active_ns
        for motion in bench.moved():
            name = next(name for name, axis in NAMES.items() if axis == motion.axis)
            assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
            assert lowered.window_ns[0] <= motion.start_ns - t0_ns <= lowered.window_ns[1]
        assert {motion.axis for motion in bench.moved()} == {NAMES[name] for name in targets}

    run(case, seed=seed, config=CONFIG)


def test_an_output_that_is_active_already_is_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.send_as_other_client("dout8")
        with pytest.raises(Refusal) as caught:
            await bench.arm({"x": 100}, StartOptions(drive=DRIVE))
        assert caught.value.code == "line-level" and "line" in caught.value.text

    run(case, config=CONFIG)


@pytest.mark.parametrize("targets", [{}, {"x": 40_000}], ids=str)
@pytest.mark.parametrize("by_stop", [False, True])
@pytest.mark.parametrize("when_ms", [-300, -3, 40])
def test_disarmed_or_stopped_the_output_is_passive(when_ms: int, by_stop: bool, targets: dict[str, int]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        how = StartOptions(drive=DRIVE.model_copy(update={"hold_ns": 20 * NS_PER_S}))
        t0_ns, lowered = await bench.start(targets, how)
        await bench.until(t0_ns + when_ms * NS_PER_MS)
        await (bench.driver.stop(abort=False) if by_stop else bench.driver.slots.unload())
        await sleep_ns(bench.clock, lowered.costs.stop_ns)
        assert not bench.unit.output_level(3) and not bench.moving
        with contextlib.suppress(ControllerFault, Refusal):
            await bench.followed()
        await bench.driver.slots.unload()
        assert not bench.unit.output_level(3)

    run(case, config=CONFIG)


def test_a_controller_that_drives_the_trigger_line_may_wait_for_it_too() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.on_output(lambda bit, level: bench.unit.set_input(2, level=level) if bit == 3 else None)
        wide = TriggerWait(input="start", earliest_ns=-10 * NS_PER_MS, latest_ns=15 * NS_PER_MS)
        _, lowered = await bench.start({"x": 4000, "y": -4000}, StartOptions(wait=wide, drive=DRIVE))
        assert lowered.start_class == "line" and lowered.edge
        started, outcome = await bench.followed()
        assert outcome.state == "done", outcome
        for motion in bench.moved():
            name = next(name for name, axis in NAMES.items() if axis == motion.axis)
            assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns

    run(case, config=CONFIG)
