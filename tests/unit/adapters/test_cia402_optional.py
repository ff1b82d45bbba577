"""Objects that CiA 402 leaves optional: drives without them are driven, and their EDS files are read."""

import re
from pathlib import Path
from typing import Any

import pytest
from unit.adapters.cia402_bench import Drives, config, run
from unit.adapters.cia402_shapes import EDS as _EDS
from unit.adapters.cia402_shapes import without as leave_out

from adapters.cia402 import MAKE
from orchestrator.clock.base import NS_PER_MS

_OPTIONAL = ("605A", "605B", "605C", "605D", "605E", "6065", "6066", "607C", "607D", "6085", "6086", "609A")


@pytest.mark.parametrize("without", [("605A",), _OPTIONAL])
def test_a_drive_without_optional_objects_is_homed_moved_and_stopped(without: tuple[str, ...], tmp_path: Path) -> None:
    file = tmp_path / "drive.eds"
    file.write_text(leave_out(*without)(_EDS.read_text()))

    async def main(world: Drives) -> None:
        driver = world.driver
        await world.ready()
        await driver.load_soft_limits({"a": (-50_000, 60_000)})
        assert await driver.home_axes(["a"], lambda _: None) == {}
        await world.go(target=20_000)
        await driver.slots.present.wait_for_start()
        assert (await driver.slots.present.wait_for_end()).state == "done"
        for abort in (False, True):
            # Its quick stop has switched it off (605Ah = 2): it is enabled again.
            await world.stop_in_motion(20_000, abort=abort, rest_ms=200)
        # The rest of the cancelled target is not moved to.
        position = world.unit.position("1")
        await world.rest(500)
        assert world.unit.position("1") == position
        assert not await driver.check_settings(everything=True)

    run(main, simulate={"without": list(without)}, homing={"method": "37"}, options={"eds": str(file)})


def test_a_drive_that_its_enable_input_switches_off_in_a_stop_stays_off() -> None:
    async def main(world: Drives) -> None:
        world.unit.set_input(2, level=True)
        await world.ready()
        t0_ns = await world.go()
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 300 * NS_PER_MS)
        await world.driver.stop(abort=True)
        world.unit.set_input(2, level=False)
        await world.driver.slots.present.wait_for_end()
        await world.rest(300)
        assert not (await world.driver.poll()).axes["a"].enabled

    run(main, simulate={"without": ["605A"], "enable_input": 2})


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "cp1252", "cp437"])
def test_an_eds_file_is_read_in_the_encoding_of_its_maker(encoding: str, tmp_path: Path) -> None:
    file = tmp_path / "drive.eds"
    file.write_bytes(_EDS.read_text().replace("VendorName=", "VendorName=Schönaich für ").encode(encoding))
    MAKE.check_config(config(1, {"eds": str(file)}))


@pytest.mark.parametrize("content", [b"", b"\x00\xff\x81\x8d" * 50, b"[DeviceInfo]\nVendorNumber=x\n", b"no ini file"])
def test_a_file_that_is_no_eds_file_is_named(content: bytes, tmp_path: Path) -> None:
    file = tmp_path / "drive.eds"
    file.write_bytes(content)
    with pytest.raises(ValueError, match=r"options\.eds"):
        MAKE.check_config(config(1, {"eds": str(file)}))


@pytest.mark.parametrize(
    ("missing", "options", "axis"),
    [
        ("1000", {}, {}),
        ("1017", {}, {}),
        ("6098", {}, {"homing": {"method": "23"}}),
        ("1601", {}, {}),
        ("1801", {}, {}),
        ("6085", {"quick_stop_acceleration": 1000.0}, {}),
        ("1016", {"watchdog_ms": 500}, {}),
        ("6007", {"watchdog_ms": 500}, {}),
        ("6091", {"gear": "3"}, {}),
        ("60C2", {}, {"limits": {"velocity": 1000, "acceleration": 1000, "jerk": 100_000}}),
        ("1A03", {}, {"limits": {"velocity": 1000, "acceleration": 1000, "jerk": 100_000}}),
    ],
)
def test_an_object_that_will_be_touched_is_missed_offline(
    missing: str, options: dict[str, Any], axis: dict[str, Any], tmp_path: Path
) -> None:
    file = tmp_path / "drive.eds"
    file.write_text(leave_out(missing)(_EDS.read_text()))
    with pytest.raises(ValueError, match=f"{missing}h"):
        MAKE.check_config(config(1, {"eds": str(file), **options}, **axis))


def test_an_object_that_cannot_be_written_is_found_offline(tmp_path: Path) -> None:
    file = tmp_path / "drive.eds"
    text = re.sub(r"(?s)(\[1017\].*?AccessType=)rw", r"\1ro", _EDS.read_text())
    file.write_text(text)
    with pytest.raises(ValueError, match="cannot be written"):
        MAKE.check_config(config(1, {"eds": str(file)}))
