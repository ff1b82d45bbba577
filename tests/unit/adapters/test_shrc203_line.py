"""Starts by an input, and an output that is switched at T0, judged by the simulator's ground truth."""

import contextlib
from collections.abc import Mapping
from random import Random
from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import NAMES, Bench, controller, run

from adapters.contract import HostInterval, MoveOutcome
from adapters.shrc203 import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions, TriggerDrive, TriggerWait
from orchestrator.plan.step import AxisMove, plan_step

POINTS: dict[str, Any] = {
    "inputs": {"start": {"number": 2}, "low": {"number": 5, "active": "low"}},
    "outputs": {"line": {"number": 3}, "low": {"number": 6, "active": "low"}},
}
CONFIG = controller("xyz", **POINTS)
WINDOW = TriggerWait(input="start", earliest_ns=-2 * NS_PER_MS, latest_ns=3 * NS_PER_MS)
DRIVE = TriggerDrive(output="line", active_ns=150 * NS_PER_MS)
LEAD_NS = 600 * NS_PER_MS


async def armed(
    bench: Bench, targets: Mapping[str, int], how: StartOptions, lead_ns: int = LEAD_NS
) -> tuple[int, tuple[int, int]]:
    """T0, and the start's window about it."""
    now = (await bench.driver.poll()).axes
    moves = [AxisMove(name, now[name].commanded_counts, to, 100_000.0, 500_000.0) for name, to in targets.items()]
    lowered = bench.driver.lower_profiles(plan_step(moves).profiles if moves else {}, how, None)
    t0_ns = bench.clock.now_ns() + lead_ns
    await bench.driver.slots.present.load(lowered, t0_ns, None)
    return t0_ns, lowered.window_ns


async def released(bench: Bench, targets: Mapping[str, int], how: StartOptions) -> tuple[int, tuple[int, int]]:
    found = await armed(bench, targets, how)
    await bench.driver.slots.present.verify()
    await bench.driver.slots.present.release()
    return found


def raise_at(bench: Bench, at_ns: int, number: int = 2, level: bool = True) -> None:
    bench.clock.call_at_ns(at_ns, lambda: bench.unit.set_input(number, level=level))


async def followed(bench: Bench) -> tuple[Mapping[str, HostInterval], MoveOutcome]:
    started = await bench.driver.slots.present.wait_for_start()
    return started, await bench.driver.slots.present.wait_for_end()


@pytest.mark.parametrize("other_inputs", [(), (1, 6)])
@pytest.mark.parametrize("seed", range(10))
def test_the_edge_starts_all_axes_within_the_reported_intervals(seed: int, other_inputs: tuple[int, ...]) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        for number in other_inputs:
            bench.unit.set_input(number, level=True)
        await bench.ready()
        for _ in range(3):
            bench.unit.set_input(2, level=False)
            targets = {name: draw.randrange(-60_000, 60_000) for name in draw.sample("xyz", draw.randint(1, 3))}
            before = len(bench.moved())
            t0_ns, (earliest_ns, latest_ns) = await released(bench, targets, StartOptions(wait=WINDOW))
            assert not bench.moved()[before:]
            raise_at(bench, t0_ns + draw.randrange(WINDOW.earliest_ns, WINDOW.latest_ns))
            started, outcome = await followed(bench)
            assert outcome.state == "done", outcome
            truth = {each.axis: each for each in bench.moved()[before:]}
            assert len({each.start_ns for each in truth.values()}) == 1
            for name, target in targets.items():
                motion = truth[NAMES[name]]
                assert motion.end_counts == target and motion.end_ns is not None
                assert earliest_ns <= motion.start_ns - t0_ns <= latest_ns
                assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
                assert outcome.ended[name].earliest_ns <= motion.end_ns <= outcome.ended[name].latest_ns

    run(case, seed=seed, config=CONFIG, ppm=Random(seed).uniform(-95, 95))


@pytest.mark.parametrize(
    "simulate",
    [{"standby_completion": True}, {"standby_reply_deferred": True}, {"completion_after_stop": False}],
    ids=str,
)
def test_controllers_of_other_readings_start_by_trigger_line_as_well(simulate: dict[str, Any]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for target in (70_000, 69_000, 0):
            bench.unit.set_input(2, level=False)
            t0_ns, _ = await released(bench, {"x": target}, StartOptions(wait=WINDOW))
            raise_at(bench, t0_ns)
            started, outcome = await followed(bench)
            assert outcome.state == "done", outcome
            motion = bench.moved()[-1]
            assert motion.end_counts == target and motion.end_ns is not None
            assert started["x"].earliest_ns <= motion.start_ns <= started["x"].latest_ns
            assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns
            await bench.driver.poll()

    run(case, config=CONFIG, simulate=simulate)


def test_an_input_that_is_active_low_starts_when_its_current_stops() -> None:
    async def case(bench: Bench) -> None:
        bench.unit.set_input(5, level=True)
        await bench.ready()
        how = StartOptions(wait=WINDOW.model_copy(update={"input": "low"}))
        t0_ns, _ = await released(bench, {"y": 3000}, how)
        raise_at(bench, t0_ns, 5, False)
        _, outcome = await followed(bench)
        assert outcome.state == "done"

    run(case, config=CONFIG)


@pytest.mark.parametrize("before_ms", [10, 30, 60, 120, 250, 400])
@pytest.mark.parametrize("off_ms", [5, 40])
@pytest.mark.parametrize("by_line", [True, False])
def test_a_power_cycle_before_the_start_is_no_start(before_ms: int, off_ms: int, by_line: bool) -> None:
    """Its prebuffers are as empty as after execution, and its position has another coordinate."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 1000})
        await followed(bench)
        t0_ns, _ = await released(bench, {"x": 30_000}, StartOptions(wait=WINDOW if by_line else None))
        raise_at(bench, t0_ns)
        await sleep_until_ns(bench.clock, t0_ns - before_ms * NS_PER_MS)
        bench.unit.set_power(on=False)
        await sleep_ns(bench.clock, off_ms * NS_PER_MS)
        bench.unit.set_power(on=True)
        with pytest.raises((ControllerFault, LinkClosed)):
            await bench.driver.slots.present.wait_for_start()
        assert len(bench.moved()) == 1

    run(case, config=CONFIG)


def test_an_input_that_is_active_already_is_refused_and_nothing_waits() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_input(2, level=True)
        with pytest.raises(Refusal) as caught:
            await armed(bench, {"x": 3000}, StartOptions(wait=WINDOW))
        assert caught.value.code == "line-level"
        assert "start" in caught.value.text and caught.value.remedy
        await bench.driver.slots.unload()
        assert bench.unit.at_rest()

    run(case, config=CONFIG)


def test_another_input_that_changes_before_the_promise_is_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, _ = await armed(bench, {"x": 3000}, StartOptions(wait=WINDOW))
        bench.unit.set_input(4, level=True)
        with pytest.raises(Refusal) as caught:
            await bench.driver.slots.present.verify()
        assert caught.value.code == "other-inputs" and "IN4" in caught.value.text
        await bench.driver.slots.unload()
        bench.unit.set_input(2, level=True)
        bench.unit.set_input(4, level=False)
        await sleep_until_ns(bench.clock, t0_ns + NS_PER_S)
        assert not bench.moved() and bench.unit.at_rest()

    run(case, config=CONFIG)


@pytest.mark.parametrize("stage", ["arm", "verify", "go"])
@pytest.mark.parametrize(
    "simulate",
    [{}, {"stop_keeps_prebuffer": True}, {"standby_completion": True}, {"standby_reply_deferred": True}],
    ids=str,
)
def test_a_disarmed_move_never_starts_on_any_trigger_edge(stage: str, simulate: dict[str, Any]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, _ = await armed(bench, {"x": 5000, "z": -4000}, StartOptions(wait=WINDOW))
        if stage != "arm":
            await bench.driver.slots.present.verify()
        if stage == "go":
            await bench.driver.slots.present.release()
        assert not (await bench.driver.poll()).axes["x"].moving
        await bench.driver.slots.unload()
        await bench.driver.slots.unload()
        assert bench.unit.at_rest()
        raise_at(bench, t0_ns)
        await sleep_until_ns(bench.clock, t0_ns + NS_PER_S)
        assert not bench.moved()
        bench.unit.set_input(2, level=False)
        t0_ns, _ = await released(bench, {"x": 3000}, StartOptions(wait=WINDOW))
        raise_at(bench, t0_ns)
        assert (await followed(bench))[1].state == "done"

    run(case, config=CONFIG, simulate=simulate)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("when_ms", [-500, -300, -60, -5, 2, 40])
@pytest.mark.parametrize("simulate", [{}, {"standby_completion": True}], ids=str)
def test_a_stop_at_any_moment_leaves_nothing_waiting(when_ms: int, abort: bool, simulate: dict[str, Any]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, _ = await released(bench, {"x": 90_000, "y": -80_000}, StartOptions(wait=WINDOW))
        following = bench.clock.loop.create_task(followed(bench))
        raise_at(bench, t0_ns)
        await sleep_until_ns(bench.clock, t0_ns + when_ms * NS_PER_MS)
        await bench.driver.stop(abort=abort)
        try:
            _, outcome = await following
        except (ControllerFault, Refusal):
            assert when_ms <= 40
        else:
            assert outcome.state == ("fault" if abort else "stopped"), outcome
            assert when_ms > 0
        await sleep_until_ns(bench.clock, t0_ns + NS_PER_S)
        if when_ms < -50:  # later its characters are still on the line when the edge comes
            assert not bench.moved()
        await bench.driver.clear_faults()
        await bench.driver.set_enabled(["x", "y", "z"], on=True)
        for _ in range(2):
            await bench.driver.poll()
        assert bench.unit.at_rest()
        before = len(bench.moved())
        for level in (False, True, False):
            bench.unit.set_input(2, level=level)
            await sleep_ns(bench.clock, 50 * NS_PER_MS)
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        assert len(bench.moved()) == before
        t0_ns, _ = await released(bench, {"x": 3000}, StartOptions(wait=WINDOW))
        raise_at(bench, t0_ns)
        assert (await followed(bench))[1].state == "done"

    run(case, config=CONFIG, simulate=simulate)


def test_a_missing_trigger_edge_is_reported_and_a_late_one_moves_nothing_after_the_stop() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await released(bench, {"x": 5000}, StartOptions(wait=WINDOW))
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started" and "IN2" in caught.value.text
        await bench.driver.stop(abort=False)
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved() and bench.unit.at_rest()

    run(case, config=CONFIG)


def test_an_edge_long_before_t0_is_not_taken_for_the_start() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await armed(bench, {"x": 50_000}, StartOptions(wait=WINDOW))
        await bench.driver.slots.present.verify()
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, 5 * NS_PER_MS)
        await bench.driver.slots.present.release()
        with pytest.raises(ControllerFault, match="before T0"):
            await bench.driver.slots.present.wait_for_start()

    run(case, config=CONFIG)


def test_a_controller_without_standby_at_rest_is_refused_before_anything_is_armed() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert bench.driver.capabilities.start_classes == ("host",)
        with pytest.raises(Refusal) as caught:
            await armed(bench, {"x": 5000}, StartOptions(wait=WINDOW))
        assert caught.value.code == "start-class"
        await bench.start({"x": 500})
        assert (await followed(bench))[1].state == "done"

    run(case, config=CONFIG, simulate={"standby_needs_running": True})


@pytest.mark.parametrize(
    ("how", "named"),
    [
        (StartOptions(wait=WINDOW.model_copy(update={"input": "other"})), "other"),
        (StartOptions(drive=DRIVE.model_copy(update={"output": "other"})), "other"),
        (StartOptions(start_class="line"), "line"),
        (StartOptions(start_class="clock"), "clock"),
    ],
)
def test_a_trigger_line_that_is_not_in_the_fleet_file_is_refused(how: StartOptions, named: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert bench.driver.capabilities.start_classes == ("host", "line")
        with pytest.raises(Refusal) as caught:
            await armed(bench, {"x": 5000}, how)
        assert caught.value.code == "start-class" and named in caught.value.text

    run(case, config=CONFIG)


@pytest.mark.parametrize("waits", [True, False])
def test_a_guardians_stop_ends_waiting_and_running_moves(waits: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        how = StartOptions(wait=WINDOW) if waits else StartOptions()
        t0_ns, _ = await released(bench, {"x": 90_000, "y": -500}, how)
        if not waits:
            await sleep_until_ns(bench.clock, t0_ns + 300 * NS_PER_MS)
        link = await bench.wire.open_link()  # the host is dead
        link.write(MAKE.stop_bytes(CONFIG))
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        bench.unit.set_input(2, level=True)
        await sleep_ns(bench.clock, NS_PER_S)
        await link.close()
        assert bench.unit.at_rest()
        assert [each.axis for each in bench.moved()] == ([] if waits else ["1", "2"])
        assert waits or bench.unit.position("1") < 90_000

    run(case, config=CONFIG)


# Driving a line


class Edges:
    """The edges of an output."""

    def __init__(self, bench: Bench, number: int) -> None:
        self.seen: list[tuple[bool, int]] = []

        def note(changed: int, level: bool) -> None:
            if changed == number:
                self.seen.append((level, bench.clock.now_ns()))

        bench.unit.on_output(note)


@pytest.mark.parametrize("targets", [{}, {"x": 30_000}, {"x": 90_000, "y": 500}])
@pytest.mark.parametrize("output", ["line", "low"])
@pytest.mark.parametrize("seed", range(5))
def test_the_output_is_switched_within_the_reported_interval_and_back(
    seed: int, output: str, targets: dict[str, int]
) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        number, active = (3, True) if output == "line" else (6, False)
        await bench.driver.set_output(1, on=True)
        await bench.driver.set_output(6, on=True)
        edges = Edges(bench, number)
        drive = DRIVE.model_copy(update={"output": output})
        reading = await bench.driver.poll()
        moves = [AxisMove(name, reading.axes[name].commanded_counts, to, 1e5, 5e5) for name, to in targets.items()]
        lowered = bench.driver.lower_profiles(
            plan_step(moves).profiles if moves else {}, StartOptions(drive=drive), None
        )
        t0_ns = bench.clock.now_ns() + LEAD_NS
        await bench.driver.slots.present.load(lowered, t0_ns, None)
        await bench.driver.slots.present.verify()
        await sleep_ns(bench.clock, 50 * NS_PER_MS)
        assert not edges.seen
        await bench.driver.slots.present.release()
        started, outcome = await followed(bench)
        assert outcome.state == "done", outcome
        (on, on_ns), (off, off_ns) = edges.seen
        assert (on, off) == (active, not active)
        earliest_ns = sum(each.earliest_ns for each in lowered.edge)
        latest_ns = sum(each.latest_ns for each in lowered.edge)
        assert earliest_ns <= on_ns - t0_ns <= latest_ns
        assert drive.active_ns <= off_ns - on_ns < drive.active_ns + 50 * NS_PER_MS
        assert bench.unit.output_level(1)
        for name in targets:
            (motion,) = [each for each in bench.moved() if each.axis == NAMES[name]]
            assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns

    run(case, seed=seed, config=CONFIG)


def test_an_output_that_is_active_already_is_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.set_output(3, on=True)
        with pytest.raises(Refusal) as caught:
            await armed(bench, {}, StartOptions(drive=DRIVE))
        assert caught.value.code == "line-level" and "OUT3" in caught.value.text

    run(case, config=CONFIG)


@pytest.mark.parametrize("by_stop", [False, True])
@pytest.mark.parametrize("when_ms", [-400, -30, -2, 1, 20, 300])
def test_disarmed_or_stopped_the_output_is_passive_at_once(when_ms: int, by_stop: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        edges = Edges(bench, 3)
        t0_ns, _ = await released(bench, {"x": 90_000}, StartOptions(drive=DRIVE))
        following = bench.clock.loop.create_task(followed(bench))
        await sleep_until_ns(bench.clock, t0_ns + when_ms * NS_PER_MS)
        acted_ns = bench.clock.now_ns()
        if by_stop or when_ms > -10:
            await bench.driver.stop(abort=False)
        if not by_stop:
            await bench.driver.slots.unload()
        with contextlib.suppress(ControllerFault, Refusal):
            await following
        await sleep_ns(bench.clock, 20 * NS_PER_MS)
        assert not bench.unit.output_level(3)
        if edges.seen:
            assert edges.seen[-1][1] - acted_ns < 30 * NS_PER_MS or when_ms == 300
        await sleep_ns(bench.clock, NS_PER_S)
        for _ in range(2):
            await bench.driver.poll()
        assert not bench.unit.output_level(3) and bench.unit.at_rest()
        if when_ms < -10:
            assert not edges.seen and not bench.moved()

    run(case, config=CONFIG)


def test_a_controller_that_drives_the_trigger_line_may_wait_for_it_too() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.on_output(lambda number, level: bench.unit.set_input(2, level=level) if number == 3 else None)
        for target in (30_000, 0):
            edge = bench.driver.lower_profiles({}, StartOptions(drive=DRIVE), None).edge
            wait = window(sum(e.earliest_ns for e in edge), sum(e.latest_ns for e in edge))
            before = len(bench.moved())
            t0_ns, (earliest_ns, latest_ns) = await released(
                bench, {"x": target, "y": target}, StartOptions(wait=wait, drive=DRIVE)
            )
            started, outcome = await followed(bench)
            assert outcome.state == "done", outcome
            for motion in bench.moved()[before:]:
                assert earliest_ns <= motion.start_ns - t0_ns <= latest_ns
                assert started["x"].earliest_ns <= motion.start_ns <= started["x"].latest_ns
            assert len(bench.moved()) == before + 2

    run(case, config=CONFIG)


def window(earliest_ns: int, latest_ns: int) -> TriggerWait:
    return WINDOW.model_copy(update={"earliest_ns": earliest_ns, "latest_ns": latest_ns})


@pytest.mark.parametrize("seed", range(16))
def test_on_a_noisy_line_nothing_moves_but_what_was_released(seed: int) -> None:
    """One byte in about 300 is garbled, both ways: steps may fail, but no axis moves anywhere else, or by itself."""

    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()

        def garble(data: bytes) -> bytes:
            return bytes(draw.randrange(256) if draw.random() < 0.003 else each for each in data)

        allowed = {0}
        for _ in range(8):
            bench.unit.set_input(2, level=False)
            targets = {name: draw.randrange(-20_000, 20_000) for name in draw.sample("xyz", 2)}
            before, go = len(bench.moved()), False
            bench.wire.to_far = bench.wire.to_near = garble
            try:
                t0_ns, _ = await armed(bench, targets, StartOptions(wait=WINDOW))
                await bench.driver.slots.present.verify()
                await bench.driver.slots.present.release()
                go = True
                allowed |= set(targets.values())
                raise_at(bench, t0_ns)
                await followed(bench)
            except (Refusal, ControllerFault):
                bench.wire.to_far = bench.wire.to_near = None
                await bench.driver.stop(abort=False)
                await bench.driver.slots.unload()
            bench.wire.to_far = bench.wire.to_near = None
            for level in (False, True):
                bench.unit.set_input(2, level=level)
                await sleep_ns(bench.clock, 2 * NS_PER_S)
            assert go or len(bench.moved()) == before
            assert bench.unit.at_rest()
        ends = {each.end_counts for each in bench.moved()}
        assert ends <= allowed or any(each.slowing_ns is not None for each in bench.moved())

    run(case, seed=seed, config=CONFIG)
