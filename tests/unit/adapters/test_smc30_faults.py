"""SMC30 that are connected in any state, disturbed, refused, garbled, switched off: always a clear fault, never a
wrong move."""

import asyncio
import contextlib
from collections.abc import Mapping
from dataclasses import replace
from random import Random

import pytest
from unit.adapters.restarts import sees_the_restart
from unit.adapters.test_smc30_bench import HOST, World, config, run, wait

from adapters.contract import DriverSetup, JogMove
from adapters.smc30 import MAKE
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_until_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import SimulatedController


def framed(text: str) -> bytes:
    return text.encode() + bytes((sum(text.encode()) % 128,)) + b"\r"


# Connected in any state


def test_a_controller_left_in_programming_mode_with_an_incomplete_line() -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.typed(framed("2PO") + framed("2+500") + b"2+700")
        await world.ready()
        _, _, outcome = await world.move(driver, 300)
        assert outcome.state == "done"
        assert [motion.end_counts for motion in unit.commanded_motions] == [300]

    run(main, (2,))


def test_an_incomplete_motion_command_of_an_operator_is_not_completed() -> None:
    async def main(world: World) -> None:
        _, unit = world.one
        await world.typed(b"+700")
        await world.ready()
        assert not unit.commanded_motions

    run(main, options={"checksum": False})


def test_a_program_that_runs_is_not_stopped_but_waited_for() -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.typed(framed("S100") + framed("T1000") + framed("+3000"), 300)
        assert unit.is_moving("1")
        await driver.connect()
        await driver.configure()
        assert unit.position("1") == 3000
        assert (await driver.poll()).axes["x"].commanded_counts == 3000

    run(main)


def test_a_program_that_does_not_end_is_a_fault_with_a_remedy() -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.typed(b"".join(map(framed, ("PO", "W1", "+700", "E"))), 100)
        await driver.connect()
        with pytest.raises(ControllerFault) as caught:
            await driver.configure()
        assert caught.value.code == "busy"
        assert caught.value.remedy
        assert not unit.commanded_motions

    run(main, options={"busy_wait_s": 2})


def test_a_leftover_factor_changes_no_length() -> None:
    async def main(world: World) -> None:
        driver, unit = world.one
        await world.typed(framed("con=2.3456") + framed("+450"), 2000)
        await world.ready()
        await world.move(driver, 2000)
        assert unit.position("1") == 2000

    run(main)


@pytest.mark.parametrize("switched_on", [True, False])
def test_the_checksum_switch_is_compared(switched_on: bool) -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        with pytest.raises(ControllerFault) as caught:
            await driver.connect()
        assert caught.value.code == "config-mismatch"
        assert f"`checksum: {str(switched_on).lower()}`" in caught.value.remedy

    run(main, (4,), {"checksum": switched_on}, options={"checksum": not switched_on})


@pytest.mark.parametrize(
    "firmware",
    [{"live_verify": True}, {"direct_moves": False}, {"power_up_e1": True}, {"input_poll_ms": 2.0}, {"line_limit": 40}],
)
def test_every_firmware_variant_that_the_manual_allows_works(firmware: dict[str, object]) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        for target in (4000, -2000):
            _, span, outcome = await world.move(driver, target)
            assert outcome.state == "done"
            assert span.earliest_ns <= unit.commanded_motions[-1].start_ns <= span.latest_ns
        assert unit.position("1") == -2000

    run(main, (5,), firmware)


# Before the start


def test_a_plan_from_elsewhere_is_refused_at_arming_and_at_the_promise() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        profiles = await world.plan(driver, 1000)
        lowered = driver.lower_profiles(profiles, HOST, None)
        await driver.send_raw("f+10")
        with pytest.raises(Refusal, match="is at 10") as caught:
            await driver.slots.present.load(lowered, world.t0(lowered), None)
        assert caught.value.code == "other-start"
        await driver.slots.unload()
        await driver.send_raw("f+0")
        await driver.slots.present.load(lowered, world.t0(lowered), None)
        await driver.send_raw("f-1")
        with pytest.raises(Refusal) as caught:
            await driver.slots.present.verify()
        assert caught.value.code == "other-start"
        await driver.slots.unload()
        assert not unit.commanded_motions

    run(main)


@pytest.mark.parametrize("error", ["E1", "E2", "E3", "E4", "E5", "E6", "B"])
@pytest.mark.parametrize("nth", range(14))
def test_a_refusal_at_any_point_of_an_arming_leaves_nothing_armed(error: str, nth: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        lowered = driver.lower_profiles(await world.plan(driver, 1000), wait() if nth % 2 else HOST, None)
        count = 0

        def refuse(data: bytes) -> bytes:
            nonlocal count
            count += 1
            return framed(error) if nth <= count - 1 < nth + 3 else data

        world.wire.to_near = refuse
        armed = False
        try:
            await driver.slots.present.load(lowered, world.t0(lowered), None)
            armed = True
        except (Refusal, ControllerFault) as caught:
            assert caught.code
            assert caught.text
        world.wire.to_near = None
        await driver.slots.unload()
        await world.sleep(500)
        unit.set_input(1, level=True)
        await world.sleep(1500)
        assert not unit.commanded_motions, f"armed: {armed}"
        unit.set_input(1, level=False)
        await driver.clear_faults()
        _, _, outcome = await world.move(driver, 1000)
        assert outcome.state == "done"
        assert unit.position("1") == 1000

    run(main, seed=nth)


def test_a_controller_without_current_is_not_moved() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await driver.set_enabled(["x"], on=False)
        with pytest.raises(Refusal) as caught:
            await world.arm(driver, 1000)
        assert caught.value.code == "not-enabled"
        assert not unit.commanded_motions

    run(main)


def test_the_permanent_memory_is_never_written_and_what_is_loaded_is_not_loaded_again() -> None:
    async def main(world: World) -> None:
        said: list[bytes] = []

        def listen(data: bytes) -> bytes:
            said.append(data)
            return data

        world.wire.to_far = listen
        await world.ready()
        driver, _ = world.one
        lowered = driver.lower_profiles(await world.plan(driver, 1000), HOST, None)
        await driver.slots.present.load(lowered, world.t0(lowered), None)
        await driver.slots.unload()
        before = len(said)
        await driver.slots.present.load(lowered, world.t0(lowered), None)
        again = said[before:]
        assert b"6Q\x07\r" in again
        assert not any(line.startswith(b"6PO") for line in again)
        assert not any(line[1:2] in (b"M", b"X") or line[1:3] == b"I6" for line in said)

    run(main, (6,))


# On the way


@pytest.mark.parametrize("seed", range(12))
def test_noise_on_both_ways_never_makes_a_wrong_move(seed: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        draw = Random(seed)

        def spoil(data: bytes) -> bytes:
            # The effect of the line on a character: another one with the wrong parity, or none at all.
            return bytes(draw.randrange(128, 256) if draw.random() < 0.02 else each for each in data)

        wrong = 0
        for target in (500, -700, 900, 100, 1500, -1500):
            await driver.clear_faults()
            profiles = await world.plan(driver, target)
            world.wire.to_far = world.wire.to_near = spoil
            lowered = driver.lower_profiles(profiles, HOST, None)
            try:
                await driver.slots.present.load(lowered, world.t0(lowered), None)
                await driver.slots.present.verify()
                await driver.slots.present.release()
                await driver.slots.present.wait_for_start()
                assert (await driver.slots.present.wait_for_end()).state == "done"
            except (Refusal, ControllerFault):
                wrong += 1
            world.wire.to_far = world.wire.to_near = None
            await driver.slots.unload()
            await world.sleep(2500)
            assert unit.at_rest()
            # It has moved to its target, or part of the distance, or not at all.
            low, high = sorted((profiles["x"].start_counts, target))
            assert low <= unit.position("1") <= high
        assert wrong < 6

    run(main, (1,), seed=seed)


@pytest.mark.parametrize("checksum", [True, False])
def test_two_controllers_with_one_address_are_reported(checksum: bool) -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        world.units[3].set_input(1, level=True)
        await world.sleep(5)
        with pytest.raises(ControllerFault) as caught:
            await driver.connect()
            await driver.configure()
            for _ in range(20):
                await driver.poll()
        assert caught.value.code in ("two-answers", "garbage")
        assert "address" in caught.value.remedy

    run(main, (3, 3), options={"checksum": checksum})


def test_a_controller_that_is_off_is_reported_and_the_others_are_read() -> None:
    async def main(world: World) -> None:
        await world.ready()
        world.units[2].set_power(on=False)
        with pytest.raises(ControllerFault) as caught:
            await world.drivers[2].poll()
        assert caught.value.code == "no-answer"
        assert "unit 2" in caught.value.text
        for address in (1, 3):
            assert not (await world.drivers[address].poll()).axes["x"].moving
        world.units[2].set_power(on=True)
        await sees_the_restart(world.drivers[2])

    run(main, (1, 2, 3))


def test_replies_never_mix_while_all_are_read_and_some_are_stopped() -> None:
    async def main(world: World) -> None:
        await world.ready()
        for address in world.drivers:
            await world.drivers[address].send_raw(f"f+{1000 * (address or 0)}")
        draw = Random(5)
        ended = False

        async def read(address: int) -> int:
            times = 0
            while not ended:
                reading = await world.drivers[address].poll()
                assert reading.axes["x"].commanded_counts == 1000 * address
                times += 1
                await world.sleep(draw.uniform(1, 30))
            return times

        reading = [asyncio.get_running_loop().create_task(read(address)) for address in range(1, 8)]
        for _ in range(20):
            await world.sleep(draw.uniform(50, 400))
            await world.drivers[draw.randrange(1, 8)].stop(abort=draw.random() < 0.5)
        await world.sleep(2000)
        ended = True
        assert min(await asyncio.gather(*reading)) > 5

    run(main, range(1, 8))


@pytest.mark.parametrize("late_ms", [105, 130, 170])
@pytest.mark.parametrize("nth", range(6))
def test_a_reply_later_than_allowed_is_not_taken_for_another_controllers(nth: int, late_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        for address in world.drivers:
            await world.drivers[address].send_raw(f"f+{1000 * (address or 0)}")
        usual, count, faults = world.wire.model, 0, 0

        def delay(data: bytes) -> bytes:
            nonlocal count
            late = count % 20 == nth
            world.wire.model = replace(usual, latency_ns=late_ms * NS_PER_MS) if late else usual
            count += 1
            return data

        async def read(address: int) -> None:
            nonlocal faults
            for _ in range(30):
                try:
                    reading = await world.drivers[address].poll()
                except ControllerFault:
                    faults += 1
                else:
                    assert reading.axes["x"].commanded_counts == 1000 * address
                await world.sleep(5)

        world.wire.to_near = delay
        await asyncio.gather(read(1), read(2), read(3))
        world.wire.to_near, world.wire.model = None, usual
        # Each late reply costs a repetition, and disturbs no later exchange.
        assert not faults

    run(main, (1, 2, 3))


@pytest.mark.parametrize("after_ms", [0, 20, 60, 120, 200, 260])
def test_a_stop_of_one_controller_while_another_is_armed(after_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        one, other = world.drivers[1], world.drivers[2]
        await other.send_raw("T200")
        await other.send_raw("+5000")
        lowered = one.lower_profiles(await world.plan(one, 1000), HOST, None)
        arming = asyncio.get_running_loop().create_task(one.slots.present.load(lowered, world.t0(lowered), None))
        await world.sleep(after_ms)
        await other.stop(abort=False)
        await world.sleep(lowered.costs.stop_ns / NS_PER_MS)
        assert not world.units[2].is_moving("1")
        with contextlib.suppress(Refusal):
            await arming
        await one.slots.unload()
        assert not world.units[1].commanded_motions
        _, _, outcome = await world.move(one, 1000)
        assert outcome.state == "done"

    run(main, (1, 2))


# In a move


def test_power_lost_in_a_move_is_a_fault_and_noticed() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 10_000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await world.sleep(300)
        unit.set_power(on=False)
        with pytest.raises(ControllerFault) as caught:
            await driver.slots.present.wait_for_end()
        assert caught.value.code == "no-answer"
        unit.set_power(on=True)
        await sees_the_restart(driver)
        await driver.set_enabled(["x"], on=True)
        _, _, outcome = await world.move(driver, 500)
        assert outcome.state == "done"

    run(main)


def test_a_power_cycle_in_a_move() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 10_000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await world.sleep(300)
        await world.power_cycle(unit, 50)
        assert (await driver.slots.present.wait_for_end()).state == "fault"
        await sees_the_restart(driver)

    run(main)


def test_a_power_cycle_just_before_the_start_is_no_start() -> None:
    """The controller accepts the start command, has no program any more, and reports another coordinate for its
    position."""

    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.move(driver, 500)
        _, t0_ns = await world.arm(driver, 10_000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns - 80 * NS_PER_MS)
        await world.power_cycle(unit, 40)
        with pytest.raises(ControllerFault, match="restarted before its start") as caught:
            await driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started"
        await sees_the_restart(driver)
        assert len(unit.commanded_motions) == 1

    run(main)


def test_an_end_of_travel_is_a_fault_that_names_the_side() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, _ = world.one
        _, _, outcome = await world.move(driver, 5000)
        assert outcome.state == "fault"
        assert "CW" in outcome.reason
        assert "3000" in outcome.reason
        reading = await driver.poll()
        # Concluded, and shown, but no reason to refuse: only a motion can show whether the switch was released.
        assert (reading.axes["x"].limit, reading.axes["x"].limit_inferred) == ("forward", True)
        _, _, outcome = await world.move(driver, 0)
        assert outcome.state == "done"
        assert (await driver.poll()).axes["x"].limit == "none"

    run(main, simulate={"travel_steps": [-3000, 3000]})


def test_an_active_stop_input_ends_the_move_for_good() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 5000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await world.sleep(300)
        unit.set_input(4, level=True)
        outcome = await driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "Stop input" in outcome.reason
        unit.set_input(4, level=False)
        await world.sleep(3000)
        assert unit.at_rest()
        assert unit.position("1") < 5000
        assert (await driver.poll()).axes["x"].position_lost

    run(main)


def test_a_kill_in_motion_loses_the_position_and_a_ramp_does_not() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        for abort in (False, True):
            await world.arm(driver, 20_000)
            await driver.slots.present.verify()
            await driver.slots.present.release()
            await driver.slots.present.wait_for_start()
            await world.sleep(400)
            await driver.stop(abort=abort)
            assert (await driver.slots.present.wait_for_end()).state == "stopped"
            assert unit.at_rest()
            assert (await driver.poll()).axes["x"].position_lost is abort

    run(main, (3,))


@pytest.mark.parametrize("understood", [True, False])
def test_the_controller_at_address_3_stops_with_or_without_z(understood: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one

        def deaf(data: bytes) -> bytes:
            return data.replace(framed("3Z"), b"3Z#\r")

        await world.arm(driver, 20_000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await world.sleep(400)
        if not understood:
            world.wire.to_far = deaf
        await driver.stop(abort=False)
        await world.sleep(driver.capabilities.costs.stop_ns / NS_PER_MS)
        assert unit.at_rest()
        assert (await driver.slots.present.wait_for_end()).state == "stopped"
        assert (await driver.poll()).axes["x"].position_lost is not understood

    run(main, (3,))


def test_the_counters_end_is_a_fault_until_it_is_cleared() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await driver.send_raw("f+8388000")
        await driver.send_raw("+1000")
        await world.sleep(5000)
        reading = await driver.poll()
        assert [fault.code for fault in reading.faults] == ["counter-overflow"]
        with pytest.raises(Refusal) as caught:
            await world.arm(driver, 0)
        assert caught.value.code == "counter-overflow"
        await driver.slots.unload()
        await driver.clear_faults()
        reading = await driver.poll()
        assert not reading.faults
        assert reading.axes["x"].position_lost
        assert unit.at_rest()

    run(main)


def test_stop_bytes_stop_all_controllers_of_the_line_after_any_incomplete_input() -> None:
    async def main(world: World) -> None:
        link = await world.wire.open_link()
        for address in range(1, 8):
            link.write(framed(f"{address}T500") + framed(f"{address}+9000"))
        await world.sleep(500)
        assert all(unit.is_moving("1") for unit in world.units.values())
        link.write(b"4+12")
        link.write(MAKE.stop_bytes(config(5)))
        await world.sleep(800)
        assert not any(unit.is_moving("1") for unit in world.units.values())

    run(main, range(1, 8))


def test_a_bus_is_stopped_first_by_its_own_line() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 20_000)
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await world.sleep(200)
        await driver.close()
        assert await driver.stop_before_connect()
        await world.sleep(1000)
        assert unit.at_rest()
        assert unit.position("1") < 20_000

    run(main, (1, 2))


def test_a_lost_start_command_is_detected_at_once() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        _, t0_ns = await world.arm(driver, 2000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        world.wire.to_far = lambda data: b"" if data == framed("E") else data
        with pytest.raises(ControllerFault) as caught:
            await driver.slots.present.wait_for_start()
        assert caught.value.code == "not-started"
        await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
        assert not unit.commanded_motions
        await driver.slots.unload()

    run(main)


@pytest.mark.parametrize("late_ms", [0, 4])
def test_a_lost_answer_to_the_start_command_stops_nothing(late_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 2000)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        model = world.wire.model
        world.wire.model = replace(model, latency_ns=model.latency_ns + late_ms * NS_PER_MS)  # the line, too
        world.wire.to_near = lambda data: b"\xff\xff\r" if data == framed("Y") else data
        span = (await driver.slots.present.wait_for_start())["x"]
        assert (await driver.slots.present.wait_for_end()).state == "done"
        assert span.earliest_ns <= unit.commanded_motions[0].start_ns <= span.latest_ns

    run(main)


def test_two_steps_of_one_line_at_one_instant_are_refused() -> None:
    async def main(world: World) -> None:
        await world.ready()
        one, two = world.drivers[1], world.drivers[2]
        lowered, t0_ns = await world.arm(one, 2000)
        second = two.lower_profiles(await world.plan(two, 500), HOST, None)
        # Its slot is the one after; ten milliseconds earlier it is the same.
        await two.slots.present.load(second, t0_ns - 10 * NS_PER_MS, None)
        await one.slots.present.release()
        with pytest.raises(Refusal) as caught:
            await two.slots.present.release()
        assert caught.value.code == "line-busy"
        assert lowered.lead_ns - second.lead_ns == 10 * NS_PER_MS

    run(main, (1, 2))


@pytest.mark.parametrize("how", [HOST, wait()])
@pytest.mark.parametrize("released", [False, True])
def test_a_stop_before_the_step_is_followed_leaves_room_for_the_next(how: StartOptions, released: bool) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        await world.arm(driver, 2000, how)
        await driver.slots.present.verify()
        if released:
            await driver.slots.present.release()
        await driver.stop(abort=False)
        await world.sleep(2000)
        assert not unit.commanded_motions
        _, _, outcome = await world.move(driver, 500)
        assert outcome.state == "done"

    run(main, (2,))


def test_a_step_may_follow_a_jog_whose_end_no_poll_has_observed() -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        lowered = driver.lower_profiles(await world.plan(driver, 500), HOST, None)
        await driver.jog_axis("x", JogMove(1000.0, 25_000.0, 10))
        await world.sleep(500)
        await driver.send_raw("f+0")
        await driver.slots.present.load(lowered, world.t0(lowered), None)
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        assert (await driver.slots.present.wait_for_end()).state == "done"
        assert unit.position("1") == 500

    run(main)


@pytest.mark.parametrize("seed", range(4))
def test_polls_and_settings_keep_out_of_a_program_that_is_being_loaded(seed: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        driver, unit = world.one
        draw, ended = Random(seed), False

        async def beside() -> None:
            on = False
            while not ended:
                await driver.poll()
                await world.sleep(draw.uniform(0, 20))
                on = not on
                with contextlib.suppress(Refusal):  # a program runs
                    await driver.set_output(3, on=on)

        busy = asyncio.get_running_loop().create_task(beside())
        for target in (700, 200, 900):
            lowered = driver.lower_profiles(dict(_profiles(unit, target)), wait(), None)
            await driver.slots.present.load(lowered, world.t0(lowered), None)
            await driver.slots.present.verify()
            await driver.slots.unload()
        ended = True
        await busy

    run(main, (2,), seed=seed)


def _profiles(unit: SimulatedController, target: int) -> Mapping[str, Profile]:
    return plan_step([AxisMove("x", round(unit.position("1")), target, 5000, 25_000)]).profiles


def test_controllers_of_one_line_must_agree_about_the_checksum() -> None:
    async def main(world: World) -> None:
        shared = world.drivers[1]._setup.shared
        other = config(2, options={"checksum": False})
        options = MAKE.options_model.model_validate(other.options)
        setup = DriverSetup(
            "u2", other, options, world.clock, world.wire.open_link, LoopTimedWriter(world.clock), shared
        )
        with pytest.raises(ControllerFault) as caught:
            await MAKE.create_driver(setup).connect()
        assert caught.value.code == "config-mismatch"
        assert "checksum" in caught.value.text

    run(main, (1, 2))
