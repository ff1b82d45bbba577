"""Settings of the SMC-4000 that another client changes: found before each step and at rest, and repaired by a reset."""

from contextvars import copy_context
from typing import Any

import pytest
from unit.adapters.settings_at_rest import find_at_rest
from unit.adapters.test_smc4000_bench import FLEET, World, run, trapezoid

from adapters.contract import DriverSetup
from adapters.toolkit.firing import LoopTimedWriter
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.smc4000.driver import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from sim.core.controller import FirmwareTiming
from sim.yaskawa import SMC4000

TURNS = 80  # checks at rest that cover every part of the settings and of the program


CHANGES = [  # command of another user, setting, its value then and before
    ("GAY=X;GRY=0.5", "GRY of axis y", "0.5", "0"),
    ("ITX=0.02", "ITX of axis x", "0.0195", "1"),
    ("KPX=20", "KPX of axis x", "20", "1"),
    ("KDY=3.5", "KDY of axis y", "3.5", "10"),
    ("OFX=1.25", "OFX of axis x", "1.25", "0"),
    ("TLX=5", "TLX of axis x", "5", "9.9988"),
    ("ERX=100", "ERX of axis x", "100", "16384"),
    ("OEX=1", "OEX of axis x", "1", "0"),
    ("FLX=100", "FLX of axis x", "100", "2147483647"),
    ("BLY=-7", "BLY of axis y", "-7", "-2147483648"),
    ("DVX=1", "DVX of axis x", "1", "0"),
    ("LTX=50", "LTX of axis x", "50", "0"),
    ("CN 1", "CN0", "1", "-1"),
    ("CN ,,,1", "CN3", "1", "0"),
    ("PLX=.5", "PLX of axis x", "0.5", "0"),
]


def test_changed_settings_are_found_before_a_step_and_at_rest_and_a_reset_writes_them_again():
    """All at once: none hides another."""

    async def main(world: World) -> None:
        await world.ready(5)
        for command, *_ in CHANGES:
            for part in command.split(";"):
                await world.talk(part)
        differences = await world.driver.check_settings(everything=True)
        assert sorted((each.item, each.found, each.expected) for each in differences) == sorted(
            (item, found, expected) for _, item, found, expected in CHANGES
        )
        assert all(each.repairable for each in differences)
        assert set(await find_at_rest(world.driver, TURNS)) == {item for _, item, _, _ in CHANGES}
        await world.driver.clear_faults()
        assert not await world.driver.check_settings(everything=True)
        assert not await find_at_rest(world.driver, TURNS)

    run(main)


@pytest.mark.parametrize(
    ("command", "back", "item", "moves_reference"),
    [
        ("TM 500", "TM 1000", "TM", False),
        ("MTX=-1", "MTX=1", "MTX of axis x", True),
        ("CEX=2", "CEX=0", "CEX of axis x", True),
    ],
)
def test_what_a_reset_must_not_write_stays_a_difference_until_a_person_corrects_it(
    command: str, back: str, item: str, moves_reference: bool
):
    async def main(world: World) -> None:
        await world.ready(5)
        await world.talk(command)
        (difference,) = await world.driver.check_settings(everything=True)
        assert (difference.item, difference.moves_reference, difference.repairable) == (item, moves_reference, False)
        assert "tutti reset" in difference.remedy
        await world.driver.clear_faults()
        assert [each.item for each in await world.driver.check_settings(everything=True)] == [item]
        await world.talk(back)
        assert not await world.driver.check_settings(everything=True)

    run(main)


def test_a_cam_that_is_enabled_makes_positions_meaningless():
    async def main(world: World) -> None:
        await world.ready(5)
        for command in ("EAX", "EMX=1000", "EMY=100", "EP 10,0", "EB 1"):
            assert (await world.talk(command)).endswith(":")
        (difference,) = await world.driver.check_settings(everything=True)
        assert (difference.item, difference.moves_reference) == ("EB", True)
        await world.driver.clear_faults()
        assert not await world.driver.check_settings(everything=True)

    run(main)


@pytest.mark.parametrize("before", [("GMY=1",), ("SHXY", "JGX=5000", "BGX")])
def test_gearing_of_a_gantry_or_in_motion_is_left_to_a_person(before: tuple[str, ...]):
    async def main(world: World) -> None:
        for command in ("GAY=X", "GRY=0.5", *before):
            await world.talk(command)
        await sleep_ns(world.clock, 400 * NS_PER_MS)
        await world.driver.connect()
        with pytest.raises(ControllerFault, match="gearing") as fault:
            await world.driver.configure()
        assert (fault.value.code, fault.value.axis) == ("config-mismatch", "y")
        assert (await world.talk("MG _GRY{F1.1}")).strip().startswith("0.5")

    run(main)


def test_a_cam_found_when_connecting_is_refused():
    async def main(world: World) -> None:
        for command in ("EAX", "EMX=1000", "EMY=100", "EP 10,0", "EB 1"):
            await world.talk(command)
        await world.driver.connect()
        with pytest.raises(ControllerFault, match="cam mode"):
            await world.driver.configure()

    run(main)


def test_a_locked_controller_is_reported():
    async def main(world: World) -> None:
        await world.ready(5)
        controller: Any = world.controller
        controller.machine.locked = 2
        found = await world.driver.check_settings(everything=False)
        assert [(each.item, each.repairable) for each in found] == [("the lock (LC)", False)]

    run(main)


def test_the_declared_arming_time_covers_the_check():
    async def main(world: World) -> None:
        await world.ready()
        driver = world.driver
        mapping = driver.clock_mapping()
        assert mapping is not None
        lowered = driver.lower_profiles({"x": trapezoid(0, 40_000, 80_000, 700_000)}, StartOptions(), mapping)
        began_ns = world.clock.now_ns()
        assert not await driver.check_settings(everything=True)
        checked_ns = world.clock.now_ns()
        await driver.slots.present.load(lowered, began_ns + 10**9, mapping)
        assert world.clock.now_ns() - began_ns <= lowered.costs.arm_ns
        assert checked_ns - began_ns < 25 * NS_PER_MS
        await driver.slots.unload()

    run(main)


def test_a_second_client_that_redefines_the_zero_shows_as_a_jump_of_both_counts():
    async def main(world: World) -> None:
        await world.ready()
        await world.moved({"x": trapezoid(0, 40_000, 80_000, 700_000)})
        before = (await world.driver.poll()).axes["x"]
        await world.talk("DPX=50000")
        after = (await world.driver.poll()).axes["x"]
        assert (before.commanded_counts, before.actual_counts) == (40_000, 40_000)
        assert (after.commanded_counts, after.actual_counts) == (50_000, 50_000)
        assert not before.moving and not after.moving
        assert after.velocity_counts_s == 0

    run(main)


def test_a_setting_that_the_firmware_does_not_report_is_not_watched():
    async def main(world: World) -> None:
        await world.driver.connect()
        world.wire.to_far = lambda data: data.replace(b"_TK", b"_Q9")
        await world.driver.configure()
        world.wire.to_far = None
        await world.talk("TKX=3")
        assert not await world.driver.check_settings(everything=True)
        await world.talk("TLX=3")
        assert [each.item for each in await world.driver.check_settings(everything=True)] == ["TLX of axis x"]

    run(main)


def test_over_the_serial_port_the_critical_settings_are_checked_before_a_step_and_the_others_at_rest():
    async def within(clock: VirtualClock) -> None:
        link = {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200}
        config = Controller.model_validate(FLEET | {"link": link})
        timing = FirmwareTiming(decode_ns=500_000, spread_ns=50_000)
        controller = SMC4000.build_controller(clock, {"axes": 2}, timing=timing)
        wire = MemoryWire(clock, serial_wire(19200), controller, "serial", "serial", copy_context())
        chosen = YaskawaOptions.model_validate(config.options)
        driver = MAKE.create_driver(DriverSetup("c", config, chosen, clock, wire.open_link, LoopTimedWriter(clock)))
        await driver.connect()
        await driver.configure()
        world = World(clock, controller, wire, driver, lambda: driver)
        assert not await driver.check_settings(everything=True)
        for command, item, at_arm in (("ITX=0.5", "ITX", True), ("KSX=2", "KSX", False), ("KPX=20", "KPX", False)):
            await driver.send_raw(command)
            began_ns = clock.now_ns()
            found = [each.item for each in await driver.check_settings(everything=True)]
            assert clock.now_ns() - began_ns < driver.capabilities.costs.arm_ns
            assert found == ([f"{item} of axis x"] if at_arm else [])
            assert set(await find_at_rest(world.driver, 240)) == {f"{item} of axis x"}
            await driver.clear_faults()
            assert not await find_at_rest(world.driver, 240)

    run_virtual(within)


def test_a_controller_of_four_axes_gets_its_program_over_the_serial_port():
    """19 kB in either direction: ten seconds each at 19200 baud."""

    async def within(clock: VirtualClock) -> None:
        link = {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200}
        config = Controller.model_validate(FLEET | {"link": link})
        controller = SMC4000.build_controller(clock, {}, timing=FirmwareTiming(decode_ns=500_000, spread_ns=50_000))
        wire = MemoryWire(clock, serial_wire(19200), controller, "serial", "serial", copy_context())
        chosen = YaskawaOptions.model_validate(config.options)
        driver = MAKE.create_driver(DriverSetup("c", config, chosen, clock, wire.open_link, LoopTimedWriter(clock)))
        await driver.connect()
        await driver.configure()
        assert clock.now_ns() < 30 * NS_PER_S

    run_virtual(within)
