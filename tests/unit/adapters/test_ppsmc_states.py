"""States that an operator, another program, the controller or the link may cause, and how the SMC driver handles
them."""

import asyncio
import contextlib
from collections.abc import Sequence
from dataclasses import replace
from random import Random
from typing import Any

import pytest
from unit.adapters.ppsmc_bench import Bench, controller, run

from adapters.ppsmc import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import Link, LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal

CLOSED: dict[str, Any] = {"encoder": True, "encoder_follows": True}


@pytest.mark.parametrize(
    "lines",
    [
        ("tbs1:r5", "tbs2:a7"),
        ("clr", "1:5s500r2000a10", "nl", "end"),
        ("echo2", "pqrf1", "txdel0"),
        ("txdel1", "local", "dcpl1:1"),
        ("us77", "iel1"),
    ],
    ids=str,
)
@pytest.mark.parametrize("serial", [False, True], ids=["tcp", "serial"])
def test_leftovers_never_move_and_do_no_harm(lines: Sequence[str], serial: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.send_as_other_client(*lines)
        await bench.ready()
        assert not bench.moved()
        other = await bench.send_as_other_client("?tb")
        assert b"1:r0;2:r0;3:r0;" in other.raw
        assert bench.unit.unit.local is False
        outcome = await bench.move({"x": 333})
        assert outcome.state == "done", outcome
        assert bench.steps("x") == 333 and bench.steps("y") == 0

    run(case, config=controller(serial=serial))


@pytest.mark.parametrize("half", ["goto1:5", "move1:5.", "tbg", "1:5s500", "fast1+", "q", "block", "run2-"])
def test_an_incomplete_line_on_the_serial_port_is_not_completed(half: str) -> None:
    async def case(bench: Bench) -> None:
        line = await bench.wire.open_link()
        line.write(half.encode())
        await sleep_ns(bench.clock, 100 * NS_PER_MS)

        async def same_line() -> Link:
            return line

        driver = MAKE.create_driver(replace(bench.driver._setup, open_link=same_line))
        await driver.connect()
        await driver.configure()
        await sleep_ns(bench.clock, 200 * NS_PER_MS)
        assert not bench.moved() and not bench.unit.unit.blocked and not bench.unit.unit.memory.list_commands
        await driver.close()

    run(case, config=controller(serial=True))


def test_a_moving_controller_and_a_running_program_are_waited_for_and_not_stopped() -> None:
    async def case(bench: Bench) -> None:
        await bench.send_as_other_client("move1:1", "move2:-1")
        assert bench.moving
        await bench.ready()
        assert bench.steps("x") == 1000 and bench.steps("y") == -1000
        await bench.driver.close()
        await sleep_ns(bench.clock, 20 * NS_PER_MS)
        await bench.send_as_other_client("clr", "1:3s500", "nl", "2:3s500", "nl", "end", "start:")
        await bench.ready()
        assert bench.steps("x") == 4000 and bench.steps("y") == 2000

    run(case)


@pytest.mark.parametrize("lines", [("osc1:5",), ("clr", "in0.1", "nl", "end", "start:"), ("ccount",)], ids=str)
def test_a_controller_that_never_comes_to_rest_is_named(lines: Sequence[str]) -> None:
    async def case(bench: Bench) -> None:
        await bench.send_as_other_client(*lines)
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.connect()
        assert caught.value.code == "busy" and "`q`" in caught.value.remedy
        await bench.send_as_other_client("q", wait_ms=1000)
        await bench.reached_again()

    options = {"busy_wait_s": 3}
    run(case, config=controller(options=options), simulate={"hardware": ["io_port", "counter"]})


@pytest.mark.parametrize(
    ("lines", "config", "named"),
    [
        (("gnum2:500",), controller(), "gnum2"),
        (("gden1:3",), controller(), "gear of axis x"),
        ((), controller(axis={"unit": "um"}), "gear of axis x"),
    ],
)
def test_a_controller_of_another_configuration_is_refused(lines: Sequence[str], config: Any, named: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.send_as_other_client(*lines)
        await bench.driver.connect()
        with pytest.raises(ControllerFault, match=named) as caught:
            await bench.driver.configure()
        assert caught.value.code == "config-mismatch" and caught.value.remedy

    run(case, config=config)


def test_an_axis_that_the_controller_lacks_is_refused() -> None:
    async def case(bench: Bench) -> None:
        with pytest.raises(ControllerFault, match="axis 3"):
            await bench.ready()

    run(case, simulate={"axes": 2})


def test_another_make_is_named() -> None:
    async def case(bench: Bench) -> None:
        bench.wire.to_near = lambda data: data.replace(b"smc", b"xyz")
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.connect()
        assert caught.value.code == "wrong-make"

    run(case)


def test_a_panel_that_was_unlocked_is_locked_again_before_a_step() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.send_as_other_client("local")
        assert bench.unit.unit.local
        await bench.arm({"x": 50})
        assert not bench.unit.unit.local

    run(case)


def test_a_panel_is_left_alone_if_the_fleet_file_demands_it() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 50})
        assert bench.unit.unit.local

    run(case, config=controller(options={"panel": "leave"}))


@pytest.mark.parametrize(
    ("lines", "code"),
    [
        (("move1:1", "sleep0"), "other-start"),
        (("tbc",), "not-loaded"),
        (("tbs1:r1",), "not-loaded"),
        (("tbs3:r1",), "other-targets"),
        (("clr", "in0.1", "nl", "end", "start:"), "busy"),
    ],
)
def test_changes_by_others_between_arming_and_the_promise_are_detected(lines: Sequence[str], code: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 50_000})
        await bench.send_as_other_client(*lines)
        await bench.rest()
        with pytest.raises(Refusal) as caught:
            await bench.driver.slots.present.verify()
        assert caught.value.code == code
        await bench.send_as_other_client("q")
        await bench.driver.slots.unload()
        assert (await bench.move({"x": 20})).state == "done"

    run(case)


def test_a_speed_that_the_controller_rejects_is_refused_while_arming() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        with pytest.raises(Refusal) as caught:
            await bench.arm({"x": 50_000})
        assert caught.value.code == "not-loaded" and "ffast1" in caught.value.text
        await bench.driver.slots.unload()
        assert not bench.moved()

    run(case, simulate={"fmax_hz": 10_000})


def test_a_start_that_the_controller_ignores_is_reported() -> None:
    """emips: an axis does not move while the input port has another value (L614); nothing else shows that."""

    async def case(bench: Bench) -> None:
        await bench.send_as_other_client("emips2:1")
        await bench.ready()
        await bench.start({"x": 5000, "y": 5000})
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started" and caught.value.axis == "y"
        assert "emips" in caught.value.remedy
        await bench.driver.stop(abort=False)
        await bench.rest()

    run(case)


def test_a_limit_on_another_axis_does_not_prevent_the_start_of_a_group() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_limit("3", "reverse")
        assert (await bench.move({"x": 5000})).state == "done"

    run(case)


def test_a_limit_that_changes_after_arming_is_detected() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 5000})
        bench.unit.set_limit("3", "reverse")
        with pytest.raises(Refusal, match="limit switch"):
            await bench.driver.slots.present.verify()
        await bench.driver.slots.unload()

    run(case)


@pytest.mark.parametrize("stalled", [False, True])
def test_closed_loop(stalled: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.send_as_other_client(
            *(f"{name}1:{value}" for name, value in (("edev", 0.01), ("prt", 5), ("prst", 0.3)))
        )
        await bench.ready()
        if stalled:
            bench.unit.set_stalled("1", stalled=True)
        before = len(bench.moved())
        await bench.start({"x": 2000})
        started, outcome = await bench.followed()
        motion = bench.moved()[before]
        assert started["x"].earliest_ns <= motion.start_ns <= started["x"].latest_ns
        reading = await bench.driver.poll()
        if stalled:
            assert outcome.state == "fault" and "encoder" in outcome.reason
            assert [fault.code for fault in reading.faults] == ["unit-error"]
            assert reading.axes["x"].actual_counts == 0.0
        else:
            assert outcome.state == "done", outcome
            assert motion.end_ns is not None
            assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns
            assert reading.axes["x"].actual_counts == reading.axes["x"].commanded_counts == 2000

    run(case, simulate=CLOSED, config=controller("x", options={"loop": {"x": "closed"}}))


def test_a_loop_mode_is_loaded_or_left() -> None:
    async def case(bench: Bench) -> None:
        await bench.send_as_other_client("ecl1:1", "ecl2:1")
        await bench.ready()
        settings = [axis.settings.ecl for axis in bench.unit.machine.axes]
        assert settings == [0, 1, 0]

    run(case, simulate=CLOSED, config=controller(options={"loop": {"x": "open"}}))


def test_an_axis_that_does_not_settle_is_a_fault() -> None:
    """The end never comes: the closed loop pauses for minutes between its attempts."""

    async def case(bench: Bench) -> None:
        await bench.send_as_other_client("edev1:0.01", "prt1:5", "prst1:300")
        await bench.ready()
        bench.unit.set_stalled("1", stalled=True)
        outcome = await bench.move({"x": 2000})
        assert outcome.state == "fault" and "does not come to rest" in outcome.reason

    run(case, simulate=CLOSED, config=controller("x", options={"loop": {"x": "closed"}}))


def test_an_axis_that_is_oscillated_by_others_is_read() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.move({"x": 600})
        await bench.driver.poll()
        await bench.send_as_other_client("osc1:5")
        reading = await bench.driver.poll()
        assert reading.axes["x"].moving and reading.axes["x"].commanded_counts == 600
        with pytest.raises(Refusal):
            await bench.arm({"y": 100})

    run(case)


@pytest.mark.parametrize("seed", range(6))
def test_a_noisy_line_moves_nothing_but_what_was_armed(seed: int) -> None:
    """Bytes garbled both ways, on a serial port without any check; whatever is received, nothing else starts."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        draw = Random(seed)

        def garble(data: bytes) -> bytes:
            return bytes(draw.randrange(32, 127) if draw.random() < 0.01 else each for each in data)

        for _ in range(12):
            bench.wire.to_near = bench.wire.to_far = garble
            before = len(bench.moved())
            targets = {name: draw.randrange(-3000, 3000) for name in draw.sample("xyz", 2)}
            started = False
            try:
                await bench.start(targets)
                started = True
                await bench.followed()
            except (Refusal, ControllerFault, LinkClosed, LinkRefused):
                bench.wire.to_near = bench.wire.to_far = None
                with contextlib.suppress(ControllerFault):
                    await bench.driver.stop(abort=False)
                await sleep_ns(bench.clock, 3 * NS_PER_S)
                await bench.driver.slots.unload()
            bench.wire.to_near = bench.wire.to_far = None
            await bench.rest(30 * NS_PER_S)
            moved = {motion.axis for motion in bench.moved()[before:]}
            assert started or not moved
        await sleep_ns(bench.clock, NS_PER_S)
        await bench.driver.clear_faults()
        reading = await bench.driver.poll()
        assert {n: each.commanded_counts for n, each in reading.axes.items()} == {n: bench.steps(n) for n in "xyz"}

    run(case, seed=seed, config=controller(serial=True))


def test_concurrent_polls_disturb_nothing() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()

        async def poll() -> None:
            while True:
                await bench.driver.poll()
                await sleep_ns(bench.clock, 30 * NS_PER_MS)

        polling = asyncio.get_running_loop().create_task(poll())
        for target in (20_000, -20_000, 5):
            t0_ns, lowered = await bench.start({"x": target, "y": target // 2})
            started, outcome = await bench.followed()
            assert outcome.state == "done", outcome
            for motion in bench.moved()[-2:]:
                name = "x" if motion.axis == "1" else "y"
                assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
                assert lowered.window_ns[0] <= motion.start_ns - t0_ns <= lowered.window_ns[1]
        polling.cancel()

    run(case)


def test_an_encoder_that_is_only_read_shows_where_the_stage_is() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_stalled("1", stalled=True)
        assert (await bench.move({"x": 4000})).state == "done"
        reading = await bench.driver.poll()
        assert reading.axes["x"].commanded_counts == 4000 and reading.axes["x"].actual_counts == 0.0
        assert reading.axes["y"].actual_counts == reading.axes["y"].commanded_counts

    run(case, simulate=CLOSED, config=controller(options={"encoders": ["x"]}))


@pytest.mark.parametrize("lead_ms", [320, 200, 120, 80, 50, 30])
def test_a_poll_in_progress_never_delays_a_start(lead_ms: int) -> None:
    """A query without an answer yet would be executed before the start command: the start waits for it, or is late."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        lowered = await bench.lowered({"x": 3000})
        t0_ns = bench.clock.now_ns() + lowered.costs.arm_ns
        await bench.driver.slots.present.load(lowered, t0_ns, None)
        await bench.driver.slots.present.verify()
        await bench.until(t0_ns - lead_ms * NS_PER_MS)
        polling = asyncio.get_running_loop().create_task(bench.driver.poll())
        await sleep_ns(bench.clock, NS_PER_MS)
        try:
            await bench.driver.slots.present.release()
        except Refusal as error:
            assert error.code == "late" and lead_ms < 200
            await bench.driver.slots.unload()
            assert not bench.moved()
        else:
            await bench.followed()
            earliest_ns, latest_ns = lowered.window_ns
            assert earliest_ns <= bench.moved()[-1].start_ns - t0_ns <= latest_ns
        await polling

    run(case)
