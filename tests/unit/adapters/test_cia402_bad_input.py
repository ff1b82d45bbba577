"""Drives and buses that violate their specification: it is reported in words with a remedy, and nothing continues by
itself."""

from collections.abc import Callable
from contextlib import suppress
from contextvars import copy_context
from random import Random
from typing import Any

import pytest
from unit.adapters.cia402_bench import Drives, config, profiles, run
from unit.adapters.test_cia402_stream import SMOOTH, another, followed, released, smooth

from adapters.cia402 import MAKE
from adapters.cia402.canopen.words import ABORTS, abort_text
from adapters.contract import DriverSetup, JogMove
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import LinkClosed
from orchestrator.link.can import CanFrame, decode_frames, encode_frames
from orchestrator.link.memory import MemoryWire, can_wire
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from sim.cia402 import CIA402
from sim.core.controller import DeviceSpec, FirmwareTiming
from sim.core.oscillator import Oscillator

ANSWER = 0x581


def aborting(code: int, chosen: Callable[[int], bool]) -> Callable[[bytes], bytes]:
    """Makes aborts of answers to SDOs, by their number from 0."""
    number = -1

    def spoil(frame: CanFrame) -> CanFrame:
        nonlocal number
        if frame.id != ANSWER:
            return frame
        number += 1
        spoilt = b"\x80" + frame.data[1:4] + code.to_bytes(4, "little")
        return CanFrame(ANSWER, spoilt) if chosen(number) else frame

    return lambda data: encode_frames(*map(spoil, decode_frames(data)))


def test_every_abort_is_reported_in_words() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        for code in (*ABORTS, 0x1234_5678):
            world.wire.to_near = aborting(code, lambda _: True)
            with pytest.raises(ControllerFault) as caught:
                await world.driver.send_raw("6081:0/32")
            assert caught.value.code == "sdo-abort"
            assert abort_text(code) in caught.value.text
            assert caught.value.remedy

    run(main)


@pytest.mark.parametrize("code", [0x0602_0000, 0x0800_0022, 0x0601_0002, 0x0609_0030, 0x0504_0000])
def test_an_abort_of_any_access_while_connecting_is_reported_or_harmless(code: int) -> None:
    async def main(world: Drives) -> None:
        draw = Random(code)
        said = 0
        for _ in range(12):
            at = draw.randrange(150)
            world.wire.to_near = aborting(code, lambda number, at=at: number == at)
            try:
                await world.driver.connect()
                await world.driver.configure()
            except ControllerFault as error:
                said += 1
                assert error.remedy
            world.wire.to_near = None
            await world.driver.close()
            await world.rest(20)
        assert said
        await world.ready()
        await another(world, 0)

    run(main, **SMOOTH)


@pytest.mark.parametrize("code", [0x0800_0022, 0x0609_0030])
@pytest.mark.parametrize("streamed", [False, True])
def test_an_abort_of_any_access_while_arming_is_reported_and_nothing_moves(streamed: bool, code: int) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        moves = smooth(0, 20_000) if streamed else profiles(0, 20_000)
        lowered = world.driver.lower_profiles(moves, StartOptions(), None)
        for at in range(6):
            world.wire.to_near = aborting(code, lambda number, at=at: number == at)
            with pytest.raises((ControllerFault, Refusal)):
                await world.driver.slots.present.load(lowered, world.clock.now_ns() + 300 * NS_PER_MS, None)
                raise Refusal("armed", "there were not so many accesses")
            world.wire.to_near = None
            await world.driver.slots.unload()
        await world.rest(600)
        assert not world.unit.commanded_motions
        await another(world, 0)

    run(main, **SMOOTH)


@pytest.mark.parametrize("stage", ["rest", "homing", "jog", "trapezoid", "stream"])
def test_an_emergency_at_any_stage_is_reported_and_stops_the_drive(stage: str) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        drive = world.unit.station.drive
        world.clock.call_at_ns(world.clock.now_ns() + 600 * NS_PER_MS, lambda: drive.enter_fault(0x3210, 0))
        if stage == "homing":
            ((_, why),) = (await world.driver.home_axes(["a"], lambda _: None)).items()
            assert "3210h" in why.text
        elif stage == "jog":
            await world.driver.jog_axis("a", JogMove(5_000, 100_000, None))
        elif stage != "rest":
            await released(world, {0: smooth(0, 40_000) if stage == "stream" else profiles(0, 40_000)})
            _, outcome = await followed(world)
            assert outcome.state == "fault"
            assert "DC link under-voltage" in outcome.reason or "3210h" in outcome.reason
        await world.rest(900)
        assert world.unit.at_rest()
        reading = await world.driver.poll()
        assert "3210h" in reading.faults[0].text and reading.faults[0].remedy
        assert not reading.axes["a"].enabled
        await world.driver.clear_faults()
        await world.driver.set_enabled(["a"], on=True)
        await another(world, 0)

    run(main, simulate={"home_switch": [-90_000, -80_000]}, homing={"method": "home_switch_negative"}, **SMOOTH)


@pytest.mark.parametrize("streamed", [False, True])
def test_a_drive_under_local_control_is_reported(streamed: bool) -> None:
    async def main(world: Drives) -> None:
        world.unit.set_input(2, level=True)
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000) if streamed else profiles(0, 40_000)})
        world.clock.call_at_ns(t0_ns + 300 * NS_PER_MS, lambda: world.unit.set_input(2, level=False))
        _, outcome = await followed(world)
        assert outcome.state == "fault"
        assert "enable input" in outcome.reason
        assert not (await world.driver.poll()).axes["a"].enabled

    run(main, simulate={"enable_input": 2}, **SMOOTH)


def test_a_burst_of_error_frames_disturbs_no_stream() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000), 1: smooth(0, 40_000)})
        for after_ms in (100, 300, 500):
            world.clock.call_at_ns(t0_ns + after_ms * NS_PER_MS, lambda: world.bus.disturb_frames(8))
        for number in (0, 1):
            _, outcome = await followed(world, number)
            assert outcome.state == "done", outcome.reason
            assert world.units[number].position("1") == 40_000

    run(main, count=2, **SMOOTH)


def test_another_client_stops_a_stream_with_the_makes_stop_bytes() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await released(world, {0: smooth(0, 40_000)})
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 300 * NS_PER_MS)
        link = await world.wire.open_link()
        link.write(MAKE.stop_bytes(config(1)))
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "fault"
        assert "another master" in outcome.reason
        await world.rest(300)
        assert world.unit.at_rest()
        assert 0 < world.unit.position("1") < 40_000
        await world.driver.set_enabled(["a"], on=True)
        await another(world, 0)

    run(main, **SMOOTH)


def test_two_drives_with_one_node_number_are_detected() -> None:
    async def main(clock: VirtualClock) -> None:
        branches = [
            DeviceSpec(1, {}, Oscillator(0, 0.0), FirmwareTiming(300 * NS_PER_US, 200 * NS_PER_US), seed)
            for seed in (1, 2)
        ]
        segment, units = CIA402.build_shared(clock, branches)
        wire = MemoryWire(clock, can_wire(), segment, "can", "can can0", copy_context(), 3)
        its, shared = config(1), dict[str, Any]()
        setup = DriverSetup(
            "d1", its, MAKE.options_model.model_validate({}), clock, wire.open_link, LoopTimedWriter(clock), shared
        )
        driver = MAKE.create_driver(setup)
        with pytest.raises((ControllerFault, LinkClosed)) as caught:
            await driver.connect()
            await driver.configure()
            while clock.now_ns() < 5000 * NS_PER_MS:
                await driver.poll()
                await driver.send_raw("6064:0/32")
                await sleep_ns(clock, 50 * NS_PER_MS)
        assert isinstance(caught.value, ControllerFault)
        assert "node number" in caught.value.remedy
        assert not any(unit.commanded_motions for unit in units)
        with suppress(ControllerFault):
            await driver.close()

    run_virtual(main)
