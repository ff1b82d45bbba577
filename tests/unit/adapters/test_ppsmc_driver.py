"""The SMC driver against the simulated controller, judged by the simulator's ground truth: connecting, moving,
stopping."""

import asyncio
import contextlib
from random import Random
from typing import Any

import pytest
from unit.adapters.ppsmc_bench import NAMES, Bench, controller, run

from adapters.contract import ControllerRestarted
from adapters.ppsmc import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions

READINGS: list[dict[str, Any]] = [
    {},
    {"trailing_zeros": True, "dcpl": 6},
    {"dcpl": 1},
    {"txdel": 0},
    {"txdel": 1},
    {"txdel": 2},
    {"echo": 2},
    {"greeting": False},
    {"firmware": "1.2"},
    {"keep_target_buffer": False},
    {"max_clients": 1},
    {"start_skew_us": 100.0},
]


@pytest.mark.parametrize("simulate", READINGS, ids=str)
@pytest.mark.parametrize("serial", [False, True], ids=["tcp", "serial"])
def test_controllers_of_every_reading_are_connected_and_moved(simulate: dict[str, Any], serial: bool) -> None:
    async def case(bench: Bench) -> None:
        identity = await bench.driver.connect()
        assert identity.model == "pp-electronic SMC"
        assert identity.firmware == ("1.2.1093" if simulate.get("firmware") else "1.1.165")
        await bench.driver.configure()
        for target in (12_345, -1, 0):
            outcome = await bench.move({"x": target, "z": -2 * target + 7})
            assert outcome.state == "done", outcome
            reading = await bench.driver.poll()
            assert reading.axes["x"].commanded_counts == target == bench.steps("x")
            assert reading.axes["z"].commanded_counts == -2 * target + 7 == bench.steps("z")
            assert not reading.faults and not reading.restarted

    run(case, simulate=simulate, config=controller(serial=serial))


@pytest.mark.parametrize("seed", range(8))
def test_starts_and_ends_are_within_the_reported_intervals(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        for _ in range(3):
            targets = {name: draw.randrange(-60_000, 60_000) for name in draw.sample("xyz", draw.randint(1, 3))}
            before = len(bench.moved())
            t0_ns, lowered = await bench.start(targets)
            started, outcome = await bench.followed()
            assert outcome.state == "done", outcome
            truth = {each.axis: each for each in bench.moved()[before:]}
            earliest_ns, latest_ns = lowered.window_ns
            for name, target in targets.items():
                motion = truth[NAMES[name]]
                assert bench.steps(name) == target and motion.end_ns is not None
                assert earliest_ns <= motion.start_ns - t0_ns <= latest_ns
                assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
                assert outcome.ended[name].earliest_ns <= motion.end_ns <= outcome.ended[name].latest_ns

    run(case, seed=seed, ppm=Random(seed).uniform(-95, 95))


def test_the_same_targets_are_never_moved_to_twice() -> None:
    """The buffer may keep its targets after tbg: they are absolute, and cleared."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        assert (await bench.move({"x": 5000})).state == "done"
        await bench.driver.poll()
        other = await bench.send_as_other_client("?tb")
        assert b"1:r0;2:r0;3:r0;" in other.raw
        await bench.send_as_other_client("tbg", wait_ms=2000)
        assert bench.steps("x") == 5000

    run(case)


@pytest.mark.parametrize("gear", [1, 7, 400, 10_000])
def test_steps_are_exact_with_any_gear(gear: int) -> None:
    axis = {
        "scale": gear,
        "limits": {"velocity": 20_000 / gear, "acceleration": 100_000 / gear},
        "start_rate": None,
        "homing": {},
    }

    async def case(bench: Bench) -> None:
        await bench.ready()
        for target in (3331, -7777, 1, 0):
            outcome = await bench.move({"x": target})
            assert outcome.state == "done", outcome
            assert bench.steps("x") == target == (await bench.driver.poll()).axes["x"].commanded_counts

    run(case, gear=gear, config=controller("x", axis=axis))


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("when_ms", [-500, -40, -6, 2, 30, 400])
def test_a_stop_at_any_moment_leaves_nothing_that_moves(when_ms: int, abort: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, lowered = await bench.start({"x": 90_000, "y": -50_000})
        following = asyncio.get_running_loop().create_task(_follow(bench))
        await bench.until(t0_ns + when_ms * NS_PER_MS)
        await bench.driver.stop(abort=abort)
        await sleep_ns(bench.clock, lowered.costs.stop_ns)
        assert not bench.moving
        await following
        rests = [bench.steps(name) for name in "xyz"]
        reading = await bench.driver.poll()
        assert abort == any(fault.code == "blocked" for fault in reading.faults)
        await sleep_ns(bench.clock, 3 * NS_PER_S)
        assert [bench.steps(name) for name in "xyz"] == rests
        await bench.driver.clear_faults()
        assert not (await bench.driver.poll()).faults
        assert (await bench.move({"x": 100, "y": 100})).state == "done"

    run(case, seed=when_ms)


async def _follow(bench: Bench) -> None:
    with contextlib.suppress(ControllerFault, Refusal):
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "stopped"


def test_a_stop_does_not_wait_for_a_blocked_first_connection() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        # The controller itself delays commands of this connection from now on (L2787).
        bench.wire.links[0].write(b"sleep20\r\n")
        other = await bench.send_as_other_client("ffast1:20000", "goto1:80", wait_ms=300)
        assert bench.unit.is_moving("1") and other.raw
        asking = asyncio.get_running_loop().create_task(bench.driver.poll())
        await sleep_ns(bench.clock, 50 * NS_PER_MS)
        began_ns = bench.clock.now_ns()
        await bench.driver.stop(abort=False)
        assert bench.clock.now_ns() == began_ns
        await bench.rest(3 * NS_PER_S)
        assert 0 < bench.steps("x") < 80_000
        with pytest.raises(ControllerFault) as caught:
            await asking
        assert caught.value.code == "no-answer" and caught.value.remedy
        await sleep_ns(bench.clock, 25 * NS_PER_S)
        await bench.driver.poll()

    run(case)


@pytest.mark.parametrize("stage", ["idle", "armed", "moving"])
def test_a_blocked_controller_is_reported_and_a_reset_unblocks_it(stage: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        following = None
        if stage == "armed":
            await bench.arm({"x": 30_000})
        elif stage == "moving":
            t0_ns, _ = await bench.start({"x": 90_000})
            following = asyncio.get_running_loop().create_task(bench.followed())
            await bench.until(t0_ns + 300 * NS_PER_MS)
        await bench.send_as_other_client("block")
        if stage == "armed":
            with pytest.raises(Refusal) as refused:
                await bench.driver.slots.present.verify()
            assert refused.value.code == "blocked" and "unblock" in refused.value.remedy
            await bench.driver.slots.unload()
        if following is not None:
            _, outcome = await following
            assert outcome.state == "fault" and "not at its target" in outcome.reason
        reading = await bench.driver.poll()
        assert [fault.code for fault in reading.faults] == ["blocked"]
        assert reading.axes["x"].commanded_counts == bench.steps("x")
        lowered = bench.driver.lower_profiles({}, StartOptions(), None)
        with pytest.raises((Refusal, ControllerFault), match="blocked"):
            await bench.driver.slots.present.load(lowered, bench.clock.now_ns() + NS_PER_S, None)
        # Reconnected while it is blocked, it is not taken for another make, and is not unblocked by that.
        await bench.driver.close()
        await sleep_ns(bench.clock, 20 * NS_PER_MS)
        assert (await bench.driver.connect()).firmware == "1.1.165"
        await bench.driver.configure()
        assert [fault.code for fault in (await bench.driver.poll()).faults] == ["blocked"]
        await bench.driver.clear_faults()
        assert not (await bench.driver.poll()).faults
        assert (await bench.move({"x": 10})).state == "done"

    run(case)


@pytest.mark.parametrize("restart", ["reset", "reboot", "power"])
@pytest.mark.parametrize("stage", ["idle", "armed", "moving"])
def test_a_restart_is_noticed_and_leaves_nothing_armed(restart: str, stage: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        if stage == "armed":
            await bench.start({"x": 90_000})
        elif stage == "moving":
            t0_ns, _ = await bench.start({"x": 90_000})
            await bench.driver.slots.present.wait_for_start()
            await bench.until(t0_ns + 200 * NS_PER_MS)
        if restart == "power":
            bench.unit.set_power(on=False)
            await sleep_ns(bench.clock, 100 * NS_PER_MS)
            bench.unit.set_power(on=True)
        else:
            await bench.send_as_other_client(restart)
        if stage == "moving":
            with contextlib.suppress(ControllerFault, LinkClosed):
                assert (await bench.driver.slots.present.wait_for_end()).state == "fault"
        noticed = False
        for _ in range(12):
            try:
                noticed = noticed or (await bench.driver.poll()).restarted
                break
            except (ControllerFault, LinkClosed, LinkRefused):
                await sleep_ns(bench.clock, NS_PER_S)
                with contextlib.suppress(ControllerFault, LinkClosed, LinkRefused):
                    await bench.reached_again_quietly()
        assert noticed
        before = len(bench.moved())
        await sleep_ns(bench.clock, 3 * NS_PER_S)
        assert len(bench.moved()) == before and bench.unit.at_rest()
        assert not (await bench.driver.poll()).restarted
        assert (await bench.move({"x": bench.steps("x") + 500})).state == "done"

    run(case)


def test_a_restart_is_reported_before_the_controller_is_compared_with_the_fleet_file_again() -> None:
    """The comparison takes more than a second on a serial line, and others continue to move meanwhile."""

    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_power(on=False)
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        bench.unit.set_power(on=True)
        began_ns = bench.clock.now_ns()
        with pytest.raises(ControllerRestarted):
            await bench.driver.poll()
        assert bench.clock.now_ns() - began_ns < 300 * NS_PER_MS
        await bench.reached_again_quietly()
        assert [(await bench.driver.poll()).restarted for _ in range(2)] == [True, False]

    run(case, config=controller(serial=True))


def test_a_peer_that_vanishes_is_reported_at_once() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        asking = asyncio.get_running_loop().create_task(bench.driver.poll())
        await sleep_ns(bench.clock, NS_PER_MS)
        for link in list(bench.wire.links):
            link.hang_up()
        with pytest.raises(LinkClosed):
            await asking
        with pytest.raises(LinkClosed):
            await bench.driver.stop(abort=False)
        await bench.reached_again()
        assert (await bench.move({"x": 10})).state == "done"

    run(case)


def test_the_connection_for_stops_is_reopened() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert len(bench.wire.links) == 2
        bench.wire.links[1].hang_up()
        await sleep_ns(bench.clock, 10 * NS_PER_MS)
        await bench.driver.stop(abort=False)
        await bench.driver.poll()
        assert len(bench.wire.links) == 2

    run(case)


def test_garbage_silence_and_mixed_replies_are_never_taken_for_an_answer() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.move({"x": 777})
        draw, wrong, right = Random(5), 0, 0
        bench.wire.to_near = lambda data: b"" if draw.random() < 0.15 else data
        for _ in range(60):
            try:
                reading = await bench.driver.poll()
            except ControllerFault as error:
                assert error.code in ("no-answer", "garbage") and error.remedy
                wrong += 1
            else:
                right += 1
                assert reading.axes["x"].commanded_counts == 777 and not reading.restarted and not reading.faults
        assert wrong and right
        bench.wire.to_near = None
        assert (await bench.driver.poll()).axes["x"].commanded_counts == 777

    run(case)


def test_a_guardian_stops_a_move_over_a_link_of_its_own() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns, _ = await bench.start({"x": 90_000})
        await bench.until(t0_ns + 300 * NS_PER_MS)
        link = await bench.wire.open_link()
        link.write(MAKE.stop_bytes(bench.config))
        await sleep_ns(bench.clock, NS_PER_S)
        assert bench.unit.at_rest() and 0 < bench.steps("x") < 90_000

    run(case)
    assert MAKE.stop_bytes(controller()) == b"\r\nq\r\nq\r\n"
    assert MAKE.stop_bytes(controller(serial=True)) == b"!\r\nq\r\nq\r\n"


def test_outputs_and_inputs_are_read_and_written() -> None:
    points = {"inputs": {"door": {"number": 3}}, "outputs": {"lamp": {"number": 5}}, "options": {"io_port": True}}

    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.send_as_other_client("dout2")
        await bench.driver.set_output(5, on=True)
        assert bench.unit.output_level(5) and bench.unit.output_level(1)
        bench.unit.set_input(3, level=True)
        reading = await bench.driver.poll()
        assert reading.outputs[5] and reading.outputs[1] and not reading.outputs[0]
        assert reading.inputs[3] and not reading.inputs[2]
        await bench.driver.set_output(5, on=False)
        assert not bench.unit.output_level(5) and bench.unit.output_level(1)

    run(case, config=controller(**points))


def test_raw_lines_are_answered() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert await bench.driver.send_raw("?p1") == "1:0;"
        assert await bench.driver.send_raw("?err") == "1:0\n2:0\n3:0"
        assert await bench.driver.send_raw("us5") == ""
        assert not (await bench.driver.poll()).restarted
        await bench.driver.send_raw("txdel1")
        await bench.driver.poll()
        with pytest.raises(Refusal):
            await bench.driver.send_raw("goto1:5\rgoto2:5")

    run(case)
