"""Settings of a drive that another master changes are found, keep it from moving, and are written again."""

import pytest
from unit.adapters.cia402_bench import Drives, run

from adapters.cia402.driver import Cia402Driver
from adapters.contract import SettingDifference
from orchestrator.link.can import CanFrame, decode_frames, encode_frames
from orchestrator.model.errors import Refusal

ROUND = 100
"""Calls of the check at rest within which every object is read."""


async def check_round(driver: Cia402Driver) -> dict[str, SettingDifference]:
    found: dict[str, SettingDifference] = {}
    for _ in range(ROUND):
        found |= {each.item: each for each in await driver.check_settings(everything=False)}
    return found


def put(world: Drives, index: int, sub: int, value: int) -> None:
    """Change an object, as by the SDO of another master."""
    dictionary = world.unit.station.dictionary
    write = dictionary.writes.get((index, sub))
    if write is not None and (index, sub) not in {(0x607E, 0)}:
        write(value)
    dictionary.put_value(index, sub, value)


def test_a_drive_that_nothing_has_changed_has_no_differences() -> None:
    """Also after homing, steps, jogs and soft limits, which change what the drive holds."""

    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.load_soft_limits({"a": (-50_000, 60_000)})
        assert not await check_round(world.driver)
        assert await world.driver.home_axes(["a"], lambda _: None) == {}
        assert not await check_round(world.driver)
        await world.go(target=5000)
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"
        await world.driver.stop(abort=False)
        await world.rest(200)
        await world.driver.load_soft_limits({"a": None})
        assert not await check_round(world.driver)
        assert not await world.driver.check_settings(everything=True)

    run(main, homing={"method": "37"}, options={"watchdog_ms": 500})


CHANGES = [  # index, subindex, value, whether it is read before each step, whether it moves the reference
    (0x607E, 0, 0x80, True, True),
    (0x607C, 0, 500, True, True),
    (0x6091, 1, 3, True, True),
    (0x608F, 1, 4096, False, True),
    (0x6092, 1, 77, False, True),
    (0x6060, 0, 3, False, False),
    (0x607D, 2, 900_000, False, False),
    (0x605A, 0, 2, False, False),
    (0x605B, 0, 1, False, False),
    (0x605C, 0, 0, False, False),
    (0x605D, 0, 2, False, False),
    (0x605E, 0, 1, False, False),
    (0x6007, 0, 2, False, False),
    (0x6065, 0, 123, False, False),
    (0x6066, 0, 77, False, False),
    (0x607F, 0, 1000, False, False),
    (0x60C5, 0, 1000, False, False),
    (0x6085, 0, 1000, False, False),
    (0x6096, 1, 2, False, False),
    (0x1006, 0, 20_000, False, False),
    (0x1016, 1, 0, False, False),
    (0x1017, 0, 1000, False, False),
]


def test_settings_that_another_master_has_changed_are_found_and_written_again() -> None:
    """All at once: none hides another."""

    async def main(world: Drives) -> None:
        driver, dictionary = world.driver, world.unit.station.dictionary
        await driver.connect()
        await driver.configure()
        await driver.load_soft_limits({"a": (-50_000, 60_000)})
        before = {(index, sub): dictionary.get_value(index, sub) for index, sub, *_ in CHANGES}
        for index, sub, value, *_ in CHANGES:
            put(world, index, sub, value)
        found = list(await driver.check_settings(everything=True))
        assert len(found) == sum(at_arm for *_, at_arm, _ in CHANGES)
        at_rest = await check_round(driver)
        assert len(at_rest) == len(CHANGES)
        for index, sub, value, at_arm, moves_reference in CHANGES:
            name = f"{index:04X}h:{sub:02X}"
            (difference,) = (each for each in at_rest.values() if name in each.item)
            assert any(name in each.item for each in found) == at_arm
            assert (difference.found, difference.expected) == (str(value), str(before[index, sub]))
            assert (difference.axis, difference.moves_reference) == ("a", moves_reference)
            assert difference.repairable
        dictionary.writes.pop((0x607E, 0))
        await driver.clear_faults()
        assert {(index, sub): dictionary.get_value(index, sub) for index, sub, *_ in CHANGES} == before
        assert not await check_round(driver)
        assert not await driver.check_settings(everything=True)
        # And it moves as planned.
        await driver.set_enabled(["a"], on=True)
        await world.go(target=5000)
        await driver.slots.present.wait_for_start()
        assert (await driver.slots.present.wait_for_end()).state == "done"

    run(main, options={"watchdog_ms": 500})


@pytest.mark.parametrize(
    ("index", "sub", "value"),
    [(0x1400, 2, 255), (0x1402, 1, 0x80000401), (0x1601, 0, 1), (0x1A01, 2, 0x60640010), (0x1800, 5, 1000)],
)
def test_a_changed_pdo_is_mapped_again(index: int, sub: int, value: int) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        world.unit.station.dictionary.put_value(index, sub, value)
        found = await check_round(world.driver)
        assert [f"{index:04X}h:{sub:02X}" in item for item in found] == [True]
        await world.driver.clear_faults()
        assert not await check_round(world.driver)
        await world.go(target=5000)
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"

    run(main)


def test_a_scaling_that_a_powered_drive_does_not_take_needs_it_disabled() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        world.unit.station.dictionary.put_value(0x6091, 1, 3)
        assert await world.driver.check_settings(everything=True)
        with pytest.raises(Refusal) as caught:
            await world.driver.clear_faults()
        assert caught.value.code == "setting-changed" and "disable" in caught.value.remedy
        await world.driver.set_enabled(["a"], on=False)
        await world.driver.clear_faults()
        assert not await world.driver.check_settings(everything=True)

    run(main)


def test_a_drive_without_optional_objects_has_fewer_to_compare() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        assert not await check_round(world.driver)
        assert not await world.driver.check_settings(everything=True)

    run(main, simulate={"without": ["605B", "605C", "605E", "6065", "6091", "608F", "607C", "607E", "60C5", "1006"]})


@pytest.mark.parametrize("code", [0x0601_0001, 0x0800_0000, 0x0800_0022, 0x0800_0024])
def test_an_object_that_cannot_be_read_prevents_nothing(code: int) -> None:
    """It is not compared, and the drive is used all the same."""

    async def main(world: Drives) -> None:
        hidden = {0x6067, 0x60C5, 0x1006}
        world.wire.to_near = lambda data: encode_frames(
            *(
                CanFrame(frame.id, b"\x80" + frame.data[1:4] + code.to_bytes(4, "little"))
                if frame.id == 0x581 and int.from_bytes(frame.data[1:3], "little") in hidden
                else frame
                for frame in decode_frames(data)
            )
        )
        await world.ready()
        assert not await check_round(world.driver)
        assert not await world.driver.check_settings(everything=True)

    run(main)


def test_a_restart_is_no_change_by_another_master() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.load_soft_limits({"a": (-50_000, 60_000)})
        world.unit.set_power(on=False)
        await world.rest(20)
        world.unit.set_power(on=True)
        await world.rest(400)
        assert not await world.driver.check_settings(everything=True)
        assert (await world.driver.poll()).restarted
        assert not await check_round(world.driver)

    run(main)


@pytest.mark.parametrize("everything", [False, True])
def test_the_check_takes_few_frames_and_lets_a_stop_pass(everything: bool) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        frames = len(world.frames)
        began_ns = world.clock.now_ns()
        await world.driver.check_settings(everything=everything)
        took_ns = world.clock.now_ns() - began_ns
        sdos = [each for _, each in world.frames[frames:] if each.id in (0x601, 0x581)]
        assert len(sdos) == 2 * (4 if everything else 2)
        assert took_ns < 5_000_000

    run(main)


def test_limit_switches_are_shown_at_rest() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        for limit in ("forward", "reverse", "both", "none"):
            world.unit.set_limit("1", limit)
            await world.rest(100)
            axis = (await world.driver.poll()).axes["a"]
            assert (axis.limit, axis.moving, axis.velocity_counts_s) == (limit, False, 0.0)

    run(main)


@pytest.mark.parametrize("inhibit_ms", [10, 40])
def test_a_new_coordinate_of_another_master_is_no_motion(inhibit_ms: int) -> None:
    """It shows as a count that jumps at rest, whenever it is read."""

    async def main(world: Drives) -> None:
        await world.ready()
        drive = world.unit.station.drive
        await world.driver.poll()
        for by in range(1, 8):
            drive.servo.offset += 3000
            drive._changed()
            jumped = False
            for _ in range(20):
                axis = (await world.driver.poll()).axes["a"]
                jumped |= axis.commanded_counts == 3000 * by
                assert not axis.moving and axis.velocity_counts_s == 0.0
            assert jumped
            await world.rest(37 * by)

    run(main, options={"inhibit_ms": inhibit_ms})


def test_a_motion_of_another_master_is_shown_as_one_from_its_begin() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.go(target=100)
        await world.driver.slots.present.wait_for_start()
        await world.driver.slots.present.wait_for_end()
        await world.rest(200)
        drive, dictionary = world.unit.station.drive, world.unit.station.dictionary
        for target in (30_000, 100, 9000):
            before = (await world.driver.poll()).axes["a"].commanded_counts
            dictionary.put_value(0x607A, 0, target)
            drive.handle_controlword(0x1F)
            changed = False
            while not changed:
                axis = (await world.driver.poll()).axes["a"]
                changed = axis.commanded_counts != before
                assert axis.moving or not changed
            drive.handle_controlword(0x0F)
            await world.rest(12_000)
            assert not (await world.driver.poll()).axes["a"].moving

    run(main)
