"""States that an operator, another program or a power cut leaves, and controllers of other kinds."""

import asyncio
from collections.abc import Mapping
from random import Random
from typing import Any

import pytest
from unit.adapters.restarts import sees_the_restart
from unit.adapters.test_shrc203_driver import NAMES, Bench, controller, run

from adapters.shrc203 import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal


async def by_hand(bench: Bench, *lines: str, end: str = "\r\n") -> None:
    """Another client sends commands to the controller, and disconnects."""
    link = await bench.wire.open_link()
    for line in lines:
        link.write((line + end).encode())
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
    await link.close()
    await sleep_ns(bench.clock, 5 * NS_PER_MS)


@pytest.mark.parametrize(
    "lines",
    [
        ("MP:A+P500+P700",),
        ("AP:1+P500",),
        ("KP:A+P1000+P200",),
        ("EP:1A0+P100-P200D90",),
        ("WI:1,1", "G:1", "MP:1+P500"),
        ("WT:A,2000,2000", "G:A", "MP:A+P500+P600"),
        ("WI:W,5,5,5", "G", "AP:W+P500+P600+P700"),
        ("WI:1,1",),
        ("P:R",),
        ("MODE:MANUAL",),
        ("MODE:REMOTE",),
        ("BEC:1", "nonsense"),
    ],
)
@pytest.mark.parametrize("strict", [False, True])
def test_leftovers_never_move_and_are_gone_after_connecting(lines: tuple[str, ...], strict: bool) -> None:
    async def case(bench: Bench) -> None:
        await by_hand(bench, *lines)
        await bench.ready()
        await bench.driver.send_raw("G")
        for number in range(1, 7):
            bench.unit.set_input(number, level=number == 1)
        await sleep_ns(bench.clock, 2 * NS_PER_S)
        assert not bench.moved()
        await bench.start({"x": 2000, "y": -3000})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"
        assert [each.end_counts for each in bench.moved()] in ([2000, -3000], [-3000, 2000])

    run(
        case, simulate={"standby_needs_running": strict, "standby_completion": strict, "standby_reply_deferred": strict}
    )


def test_an_incomplete_line_does_no_harm() -> None:
    async def case(bench: Bench) -> None:
        await by_hand(bench, "M:1+P100", end="")
        await bench.ready()
        assert not bench.moved()
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        await bench.start({"x": 2000})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)


def test_a_moving_controller_is_not_stopped() -> None:
    async def case(bench: Bench) -> None:
        await by_hand(bench, "MP:1+P3000", "G:1")
        await bench.ready()
        (motion,) = bench.moved()
        assert motion.end_counts == 3000

    run(case)


def test_a_controller_that_never_comes_to_rest_is_named() -> None:
    async def case(bench: Bench) -> None:
        await by_hand(bench, "J:1+", "G:1")
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.connect()
        assert caught.value.code == "moving"
        await bench.driver.stop(abort=False)
        await sleep_ns(bench.clock, NS_PER_S)
        assert bench.unit.at_rest()

    run(case, options={"busy_wait_s": 2})


def test_an_emergency_stop_is_reported_and_cleared_by_a_reset_only() -> None:
    async def case(bench: Bench) -> None:
        await by_hand(bench, "L:E")
        await bench.ready()
        reading = await bench.driver.poll()
        assert {fault.code for fault in reading.faults} == {"emergency-stop"}
        await bench.driver.clear_faults()
        reading = await bench.driver.poll()
        assert not reading.faults and not reading.axes["x"].enabled
        await bench.driver.set_enabled(["x"], on=True)
        assert (await bench.driver.poll()).axes["x"].enabled

    run(case)


@pytest.mark.parametrize("anew", [False, True])
def test_the_queue_of_an_axis_in_an_error_is_emptied_after_the_reset(anew: bool) -> None:
    """A limit switch as it receives its start: the controller accepts no command in this error, and can be reached
    nevertheless."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 5000})
        bench.unit.set_limit("1", "both")
        with pytest.raises(ControllerFault):
            await bench.driver.slots.present.wait_for_start()
        await bench.driver.slots.unload()
        if anew:
            await bench.driver.close()
            await bench.driver.connect()
            await bench.driver.configure()
        assert {fault.code for fault in (await bench.driver.poll()).faults} == {"limit-error"}
        bench.unit.set_limit("1", "none")
        await bench.driver.clear_faults()
        for _ in range(2):
            assert not (await bench.driver.poll()).faults
        bench.wire.links[-1].write(b"G:1\r\n")
        await sleep_ns(bench.clock, 500 * NS_PER_MS)
        assert not bench.unit.is_moving("1") and not any(each.end_counts for each in bench.unit.commanded_motions)
        await bench.driver.poll()
        await bench.start({"x": 1234})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)


@pytest.mark.parametrize("when", ["idle", "armed", "released", "moving"])
def test_a_restart_on_an_open_line_is_noticed(when: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        if when == "armed":
            await bench.arm({"x": 5000})
        elif when != "idle":
            t0_ns = await bench.start({"x": 80_000})
            if when == "moving":
                await bench.driver.slots.present.wait_for_start()
                await sleep_ns(bench.clock, t0_ns + 200 * NS_PER_MS - bench.clock.now_ns())
        bench.wire.links[-1].write(b"RESET:\r\n")
        if when == "armed":
            await sleep_ns(bench.clock, 3500 * NS_PER_MS)
            with pytest.raises(Refusal):
                await bench.driver.slots.present.verify()
        elif when == "released":
            with pytest.raises(ControllerFault):
                await bench.driver.slots.present.wait_for_start()
                await bench.driver.slots.present.wait_for_end()
        await sleep_ns(bench.clock, 3500 * NS_PER_MS)
        await sees_the_restart(bench.driver)
        await bench.driver.slots.unload()
        await bench.start({"x": 1234})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)


@pytest.mark.parametrize("names", ["x", "z", "xz", "yz"])
@pytest.mark.parametrize("fixed", [None, 2])
def test_controllers_with_fewer_controllable_axes(names: str, fixed: int | None) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(names)
        await bench.ready()
        for _ in range(4):
            targets = {name: draw.randrange(-9000, 9000) for name in names}
            await bench.start(targets)
            await bench.driver.slots.present.wait_for_start()
            await bench.driver.poll()
            assert (await bench.driver.slots.present.wait_for_end()).state == "done"
            reading = await bench.driver.poll()
            assert {name: axis.commanded_counts for name, axis in reading.axes.items()} == targets
        await bench.driver.home_axes(list(names), lambda _: None)

    simulate = {"controllable": [int(NAMES[name]) for name in names], "fixed_decimals": fixed}
    run(case, config=controller(names), simulate=simulate)


@pytest.mark.parametrize(
    ("simulate", "options", "said"),
    [
        ({"controllable": [1, 2]}, {}, "controllable"),
        ({"divide": 200}, {}, "nm per pulse"),
        ({}, {"nm_per_pulse": 10}, "nm_per_pulse"),
    ],
)
def test_a_controller_of_another_configuration_is_refused(
    simulate: Mapping[str, Any], options: Mapping[str, Any], said: str
) -> None:
    async def case(bench: Bench) -> None:
        await bench.driver.connect()
        with pytest.raises(ControllerFault, match=said) as caught:
            await bench.driver.configure()
        assert caught.value.code == "config-mismatch"

    run(case, simulate=simulate, options=options)


def test_inputs_and_outputs() -> None:
    config = controller(inputs={"door": {"number": 2}}, outputs={"lamp": {"number": 1}, "valve": {"number": 4}})

    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_input(2, level=True)
        await bench.driver.set_output(4, on=True)
        await bench.driver.set_output(1, on=True)
        await bench.driver.set_output(4, on=False)
        reading = await bench.driver.poll()
        assert reading.inputs[2] and not reading.inputs[1]
        assert reading.outputs[1] and not reading.outputs[4]
        assert bench.unit.output_level(1) and not bench.unit.output_level(4)
        await bench.start({"x": 40_000, "y": 8_000})
        await bench.driver.slots.present.wait_for_start()
        for _ in range(6):  # the input word is 2 while completions 1 and 2 are expected
            reading = await bench.driver.poll()
            assert reading.inputs[2] and not reading.inputs[1]
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, config=config)


@pytest.mark.parametrize("settle_ms", [0, 40])
def test_a_closed_loop(settle_ms: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 20_000})
        await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "done"
        (motion,) = bench.moved()
        assert motion.end_ns is not None
        assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns

    run(case, simulate={"scales": True, "settle_ms": settle_ms}, options={"loop": "closed"})


def test_a_stop_with_one_motor_off_stops_the_others() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.set_enabled(["z"], on=False)
        await bench.start({"x": 90_000, "y": 80_000})
        await bench.driver.slots.present.wait_for_start()
        await bench.driver.stop(abort=False)
        assert (await bench.driver.slots.present.wait_for_end()).state == "stopped"
        with pytest.raises(Refusal):
            await bench.arm({"z": 100})
        await bench.driver.slots.unload()

    run(case)


def test_a_stop_from_a_link_of_its_own() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 90_000, "y": 80_000})
        await bench.driver.slots.present.wait_for_start()
        link = await bench.wire.open_link()
        link.write(MAKE.stop_bytes(bench.config))
        await sleep_ns(bench.clock, 500 * NS_PER_MS)
        assert bench.unit.at_rest()
        assert (await bench.driver.slots.present.wait_for_end()).state == "fault"

    run(case)


@pytest.mark.parametrize("seed", range(6))
def test_stops_at_any_moment_leave_nothing_that_moves(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        for _ in range(4):
            t0_ns = await bench.start({"x": draw.randrange(5_000), "y": draw.randrange(-5_000, 0)})
            await sleep_ns(bench.clock, max(0, t0_ns - bench.clock.now_ns()) + draw.randrange(-5, 8) * NS_PER_MS)
            await bench.driver.stop(abort=False)
            await bench.driver.slots.unload()
            await sleep_ns(bench.clock, NS_PER_S)
            count = len(bench.moved())
            await bench.driver.send_raw("G")
            await sleep_ns(bench.clock, NS_PER_S)
            assert len(bench.moved()) == count

    run(case, seed=seed, simulate={"stop_keeps_prebuffer": bool(seed % 2)})


def test_a_stop_while_armed_is_cleaned_up_by_the_next_poll() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 5000})
        await bench.driver.stop(abort=False)
        await bench.driver.poll()
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved()
        with pytest.raises(Refusal):
            await bench.driver.slots.present.release()

    run(case)


def test_concurrent_polls_disturb_nothing() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()

        async def poll() -> None:
            while True:
                await bench.driver.poll()

        task = asyncio.get_running_loop().create_task(poll())
        draw = Random(5)
        for _ in range(8):
            targets = {name: draw.randrange(-20_000, 20_000) for name in "xyz"}
            seen = len(bench.unit.commanded_motions)
            t0_ns = await bench.start(targets)
            started = await bench.driver.slots.present.wait_for_start()
            assert (await bench.driver.slots.present.wait_for_end()).state == "done"
            for motion in bench.unit.commanded_motions[seen:]:
                assert started["x"].earliest_ns <= motion.start_ns <= started["x"].latest_ns
                assert -1 * NS_PER_MS < motion.start_ns - t0_ns < 2.3 * NS_PER_MS
        task.cancel()

    run(case)


def test_a_withdrawn_start_is_not_waited_for() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 5000})
        waiting = asyncio.get_running_loop().create_task(bench.driver.slots.present.wait_for_start())
        await sleep_ns(bench.clock, NS_PER_MS)
        await bench.driver.stop(abort=False)
        with pytest.raises(ControllerFault, match="cancelled"):
            await waiting

    run(case)


def test_an_axis_that_does_not_settle_is_a_fault() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 20_000})
        await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "does not settle" in outcome.reason

    run(case, simulate={"scales": True, "settle_ms": 10_000}, options={"loop": "closed"})


@pytest.mark.parametrize("seed", range(16))
def test_a_noisy_line_moves_nothing_but_what_was_armed(seed: int) -> None:
    """One byte in about 300 is garbled, both ways: steps may fail, but no axis moves anywhere else."""

    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()

        def garble(data: bytes) -> bytes:
            return bytes(draw.randrange(256) if draw.random() < 0.003 else each for each in data)

        allowed = {0}
        for _ in range(10):
            targets = {name: draw.randrange(-20_000, 20_000) for name in draw.sample("xyz", 2)}
            allowed |= set(targets.values())
            bench.wire.to_far = bench.wire.to_near = garble
            try:
                await bench.start(targets)
                await bench.driver.slots.present.wait_for_start()
                await bench.driver.slots.present.wait_for_end()
            except (Refusal, ControllerFault):
                bench.wire.to_far = bench.wire.to_near = None
                await bench.driver.slots.unload()
            bench.wire.to_far = bench.wire.to_near = None
            await sleep_ns(bench.clock, 3 * NS_PER_S)
        assert {each.end_counts for each in bench.unit.commanded_motions} <= allowed

    run(case, seed=seed)
