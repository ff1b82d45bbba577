"""Faults on the SMC-4000's link and in the controller itself, and how its driver handles them."""

from typing import Any, cast

import pytest
from unit.adapters.test_smc4000_bench import FLEET, LIMITS, World, run, trapezoid

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions, TriggerDrive


async def armed(world: World, lead_s: float = 1.0) -> int:
    """A move of 5 mm, loaded."""
    mapping = world.driver.clock_mapping()
    lowered = world.driver.lower_profiles({"x": trapezoid(0, 5000, 20_000, 200_000)}, StartOptions(), mapping)
    t0_ns = world.clock.now_ns() + round(lead_s * NS_PER_S)
    await world.driver.slots.present.load(lowered, t0_ns, mapping)
    return t0_ns


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"question_crlf": True},
        {"sign_column": False},
        {"qr_axis_bytes": 28},
        {"st_halts_programs": False},
        {"strict_packets": True},
        {"control_end": "separate"},
        {"control_end": "required", "strict_packets": True},
        {"upload_line_end": True},
        {"axes": 2},
    ],
)
def test_every_open_point_of_the_manual_is_supported(options: dict[str, Any]):
    async def main(world: World) -> None:
        await world.ready()
        profiles = {"x": trapezoid(0, 5000, 20_000, 200_000), "y": trapezoid(0, -3000, 20_000, 200_000)}
        _, _, outcome, _ = await world.moved(profiles)
        assert outcome.state == "done"
        assert (world.controller.position("X"), world.controller.position("Y")) == (5000, -3000)
        with pytest.raises(Refusal, match="1 Unrecognized command"):
            await world.driver.set_enabled(["x"], on=True)
            await cast(Any, world.driver)._device.session.send_command("bg")
        assert (await world.driver.send_raw("MG _RPX{F6.0}")).strip() == "005000"
        assert "Unrecognized" in await world.driver.send_raw("tpx")

    run(main, options=options)


def test_a_garbled_start_input_refuses_the_step():
    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_far = lambda data: data.replace(b"XLI=0", b"XLI=1")
        with pytest.raises(Refusal, match="XLI reads back as 1, not 0") as refusal:
            await armed(world)
        assert refusal.value.code == "read-back"
        world.wire.to_far = None
        await world.driver.slots.unload()
        assert not world.controller.commanded_motions

    run(main)


@pytest.mark.parametrize("stage", range(30))
def test_a_link_that_is_cut_anywhere_leaves_nothing_armed_after_it_is_back(stage: int):
    async def main(world: World) -> None:
        await world.ready()
        count = 0

        def cut(data: bytes) -> bytes:
            nonlocal count
            count += 1
            world.wire.cut |= count > stage
            return data

        world.wire.to_far = cut
        with pytest.raises((ControllerFault, LinkClosed)) as fault:
            await armed(world, 1.4)
            await world.driver.slots.present.verify()
            await world.driver.slots.present.release()
            for _ in range(30):
                await world.driver.poll()
        if isinstance(fault.value, ControllerFault):
            assert fault.value.code == "no-answer"
        world.wire.to_far, world.wire.cut = None, False
        moving = bool(world.controller.commanded_motions)
        await world.driver.connect()
        await sleep_ns(world.clock, 3 * NS_PER_S)
        assert moving or not world.controller.commanded_motions

    run(main)


@pytest.mark.parametrize("noise", [b"\xff\xfe\x80\r\n", b"GARBAGE\r\n:", b"\x00" * 200])
def test_noise_is_a_fault_that_names_what_was_expected(noise: bytes):
    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_near = lambda data: noise
        with pytest.raises(ControllerFault) as fault:
            await world.driver.poll()
        assert fault.value.code in ("garbage", "no-answer")
        assert "QR" in fault.value.text
        world.wire.to_near = None
        await world.driver.poll()

    run(main)


def test_a_lost_reply_does_not_shift_the_next_ones():
    async def main(world: World) -> None:
        await world.ready()
        world.wire.to_near = lambda data: b""
        with pytest.raises(ControllerFault) as fault:
            await world.driver.send_raw("MG _RPX")
        assert fault.value.code == "no-answer"
        world.wire.to_near = None
        assert float(await world.driver.send_raw("MG 123")) == 123
        for _ in range(3):
            assert not (await world.driver.poll()).restarted

    run(main)


def test_unsolicited_text_between_replies_is_separated():
    async def main(world: World) -> None:
        await world.ready()
        printed = b"HELLO: world\r\n?003 BGX\r\n"
        world.wire.to_near = lambda data: printed + data
        reading = await world.driver.poll()
        assert reading.axes["x"].commanded_counts == 0
        await world.driver.set_enabled(["x"], on=False)
        assert not (await world.driver.poll()).axes["x"].enabled

    run(main)


def test_a_reset_by_command_is_noticed_and_the_program_comes_back():
    async def main(world: World) -> None:
        await world.ready()
        await world.talk("RS")
        reading = await world.driver.poll()
        assert reading.restarted
        assert not reading.axes["x"].enabled
        with pytest.raises(LinkClosed, match="restarted"):
            await world.driver.poll()
        await world.ready()
        assert not (await world.driver.poll()).restarted
        _, _, outcome, _ = await world.moved({"x": trapezoid(0, 5000, 20_000, 200_000)})
        assert outcome.state == "done"

    run(main)


def test_a_power_cycle_is_distinguished_from_a_broken_cable():
    async def main(world: World) -> None:
        await world.ready()
        for power in (False, True):
            if power:
                world.controller.set_power(on=False)
                await sleep_ns(world.clock, 5 * NS_PER_S)
                world.controller.set_power(on=True)
                await sleep_ns(world.clock, 5 * NS_PER_S)
            with pytest.raises((LinkClosed, LinkRefused, ControllerFault)):
                if not power:
                    world.wire.cut = True
                for _ in range(3):
                    await world.driver.poll()
            world.wire.cut = False
            await world.driver.connect()
            await world.driver.configure()
            assert (await world.driver.poll()).restarted is power
            assert not (await world.driver.poll()).restarted

    run(main)


def test_another_program_is_not_destroyed_while_it_runs():
    async def main(world: World) -> None:
        link = await world.wire.open_link()
        for line in (b"DL\r", b"#LOOP;WT 10;JP #LOOP\r\x1a"):
            link.write(line)
            await sleep_ns(world.clock, 100 * NS_PER_MS)
        await world.talk("XQ #LOOP,3")
        with pytest.raises(ControllerFault, match="thread 3") as fault:
            await world.driver.connect()
        assert fault.value.code == "other-program"
        await world.talk("HX3")
        await world.driver.connect()
        await world.driver.poll()

    run(main)


def test_a_program_that_may_not_be_replaced_stays():
    async def main(world: World) -> None:
        link = await world.wire.open_link()
        link.write(b"DL\r")
        link.write(b"#MINE;EN\r\x1a")
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        with pytest.raises(ControllerFault, match="1 lines"):
            await world.driver.connect()
        assert "#MINE" in await world.talk("LS")

    run(main, fleet=FLEET | {"options": {"replace_program": False}})


def test_soft_limits_are_loaded_and_end_a_move_as_a_fault():
    axes = {"x": {"motors": ["A"], "unit": "mm", "scale": 1000, "limits": LIMITS, "soft_limits": {"min": -4, "max": 9}}}

    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.configure()
        await world.driver.load_soft_limits({"x": None})
        assert "-2147483648" in await world.talk("MG _BLX{F10.0}")
        await world.driver.load_soft_limits({"x": (-4000, 9000)})
        assert "9000" in await world.talk("MG _FLX{F10.0}")
        assert "-0000004000" in await world.talk("MG _BLX{F10.0}")
        await world.driver.set_enabled(["x"], on=True)
        await world.driver.poll()
        _, _, outcome, _ = await world.moved({"x": trapezoid(0, 50_000, 20_000, 200_000)})
        assert outcome.state == "fault"
        assert "forward limit" in outcome.reason

    run(main, fleet=FLEET | {"axes": axes})


def test_limit_switches_are_seen_whatever_their_polarity():
    async def main(world: World) -> None:
        for polarity in (-1, 1):
            await world.talk(f"CN {polarity}")
            world.controller.set_limit("X", "none")
            await world.driver.connect()
            await world.driver.configure()
            assert (await world.driver.poll()).axes["x"].limit == "none"
            for which in ("forward", "reverse", "both"):
                world.controller.set_limit("X", which)
                assert (await world.driver.poll()).axes["x"].limit == which
            await world.driver.configure()
            assert (await world.driver.poll()).axes["x"].limit == "both"

    run(main)


@pytest.mark.parametrize("ramp", [600_000, 90_000])
def test_a_stop_in_motion_is_reported_as_a_stop_and_takes_no_longer_than_declared(ramp: int):
    async def main(world: World) -> None:
        await world.ready()
        mapping = world.driver.clock_mapping()
        lowered = world.driver.lower_profiles({"x": trapezoid(0, 90_000, 60_000, ramp)}, StartOptions(), mapping)
        t0_ns = world.clock.now_ns() + NS_PER_S
        await world.driver.slots.present.load(lowered, t0_ns, mapping)
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        await sleep_until_ns(world.clock, t0_ns + 300 * NS_PER_MS)
        await world.driver.stop(abort=False)
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "stopped"
        motion = world.controller.commanded_motions[-1]
        assert motion.end_ns is not None
        assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns
        assert motion.end_ns - (t0_ns + 300 * NS_PER_MS) < lowered.costs.stop_ns

    run(main)


def test_outputs_inputs_and_homing():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.set_output(3, on=True)
        world.controller.set_input(2, level=False)
        reading = await world.driver.poll()
        assert reading.outputs[3] and not reading.outputs[2]
        assert not reading.inputs[2] and reading.inputs[1]
        await world.driver.home_axes(["x"], lambda _: None)
        reading = await world.driver.poll()
        assert reading.axes["x"].commanded_counts == 0
        assert not reading.axes["x"].moving

    run(main, options={"home_edge": {"X": 3000}, "index_every": {"X": 2000}})


@pytest.mark.parametrize(
    ("method", "options"), [("edge", {"home_edge": {"X": 3000}}), ("index", {"index_every": {"X": 2000}})]
)
def test_homing_methods(method: str, options: dict[str, Any]):
    axis = {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": LIMITS, "homing": {"method": method}}

    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.configure()
        await world.driver.set_enabled(["x"], on=True)
        await world.driver.home_axes(["x"], lambda _: None)
        assert world.controller.commanded_motions
        assert (await world.driver.poll()).axes["x"].commanded_counts == 0

    run(main, fleet=FLEET | {"axes": {"x": axis}}, options=options)


def test_a_moving_controller_is_connected_to_without_being_stopped():
    async def main(world: World) -> None:
        await world.ready()
        for line in ("PA 60000", "SP 20000", "BGX"):
            await world.talk(line)
        await sleep_ns(world.clock, 500 * NS_PER_MS)
        driver = world.other()
        await driver.connect()
        await driver.configure()
        assert (await driver.poll()).axes["x"].moving
        with pytest.raises(Refusal, match="while running"):
            await driver.set_enabled(["x"], on=False)
        await sleep_ns(world.clock, 4 * NS_PER_S)
        assert world.controller.position("X") == 60_000

    run(main)


def test_refusals_before_anything_moves():
    async def main(world: World) -> None:
        with pytest.raises(Refusal) as refusal:
            world.driver.lower_profiles({"x": trapezoid(0, 5000, 20_000, 200_000)}, StartOptions(), None)
        assert refusal.value.code == "no-clock"
        await world.ready()
        mapping = world.driver.clock_mapping()
        for code, profile, start in (
            ("start-class", trapezoid(0, 5000, 20_000, 200_000), StartOptions(start_class="host")),
            ("too-far", trapezoid(0, 2**31, 20_000, 200_000), StartOptions()),
        ):
            with pytest.raises(Refusal) as refusal:
                world.driver.lower_profiles({"x": profile}, start, mapping)
            assert refusal.value.code == code
        await world.driver.set_enabled(["x"], on=False)
        with pytest.raises(Refusal) as refusal:
            await armed(world)
        assert refusal.value.code == "not-enabled"
        await world.driver.set_enabled(["x"], on=True)
        with pytest.raises(Refusal) as refusal:
            await armed(world, 0.02)
        assert refusal.value.code == "late"
        await world.talk("DP 77")
        with pytest.raises(Refusal) as refusal:
            await armed(world)
        assert refusal.value.code == "other-start"

    run(main)


def test_a_stop_that_is_not_yet_executed_halts_no_step_that_is_armed_after_it():
    async def main(world: World) -> None:
        await world.ready()
        driver, controller = world.driver, world.controller
        edges: list[tuple[int, bool]] = []
        controller.on_output(lambda number, on: edges.append((number, on)))
        way = StartOptions(drive=TriggerDrive(output="start", active_ns=50 * NS_PER_MS))
        for abort in (False, True):
            edges.clear()
            for _ in range(4):  # of several clients: each command takes its half millisecond
                await driver.stop(abort=abort)
            await driver.slots.unload()
            t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
            await driver.slots.present.load(
                driver.lower_profiles({}, way, driver.clock_mapping()), t0_ns, driver.clock_mapping()
            )
            await driver.slots.present.verify()
            await driver.slots.present.release()
            await sleep_until_ns(world.clock, t0_ns + 200 * NS_PER_MS)
            assert edges == [(1, True), (1, False)]

    run(main, fleet=FLEET | {"outputs": {"start": {"number": 1}}})
