"""Drives of the shapes that makers give them are homed, moved, stopped and started together, or refused in one line."""

import re
from pathlib import Path
from random import Random

import pytest
from unit.adapters.cia402_bench import Drives, config, run
from unit.adapters.cia402_shapes import EDS, REFUSED, SHAPES, Edit, with_entry, without, write_shape
from unit.adapters.test_cia402_stream import SMOOTH, followed, released, smooth

from adapters.cia402 import MAKE
from adapters.cia402.canopen.commanded import CommandedPosition
from adapters.cia402.needs import NEEDS, ObjectNeed
from adapters.cia402.shapes.trapezoid import DriveBounds, DriveUnits, fit_trapezoid
from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.plan.step import AxisMove, plan_step


async def start_together(world: Drives, targets: tuple[int, ...]) -> list[int]:
    """Move all drives by one SYNC, to their ends; return when each motion began."""
    t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
    begun = world.syncs()
    for number, target in enumerate(targets):
        here = (await world.drivers[number].poll()).axes["a"].commanded_counts
        await world.arm(number, target, t0_ns, begin=here)
    for driver in world.drivers:
        await driver.slots.present.release()
    for driver in world.drivers:
        await driver.slots.present.wait_for_start()
    for driver in world.drivers:
        outcome = await driver.slots.present.wait_for_end()
        assert outcome.state == "done", outcome.reason
    assert world.syncs() == begun + 1
    return [unit.commanded_motions[-1].start_ns for unit in world.units]


async def stop_in_motion(world: Drives, abort: bool) -> None:
    here, axis = await world.stop_in_motion(40_000, abort=abort, rest_ms=300)
    assert here < world.unit.position("1") < here + 40_000
    assert axis.commanded_counts == round(world.unit.position("1"))


@pytest.mark.parametrize("shape", SHAPES)
def test_a_drive_of_another_shape_is_homed_moved_stopped_and_started_with_others(shape: str, tmp_path: Path) -> None:
    file = write_shape(tmp_path, SHAPES[shape])

    async def main(world: Drives) -> None:
        driver = world.driver
        await world.ready()
        if shape == "no homing":
            with pytest.raises(Refusal, match="6098h"):
                await driver.home_axes(["a"], lambda _: None)
        else:
            assert await driver.home_axes(["a"], lambda _: None) == {}
        begins = await start_together(world, (20_000, 30_000))
        assert max(begins) - min(begins) < 400 * NS_PER_US
        assert [unit.position("1") for unit in world.units] == [20_000, 30_000]
        for abort in (False, True):
            await stop_in_motion(world, abort)
        await driver.jog_axis("a", JogMove(-5000, 100_000, 10_000))
        await world.rest(300)
        assert (await driver.poll()).axes["a"].velocity_counts_s == pytest.approx(-5000, rel=0.2)
        await driver.stop_axes(["a"])
        await world.rest(300)
        assert not world.unit.is_moving("1")
        assert not await driver.check_settings(everything=True)
        await driver.close()
        await driver.connect()
        await driver.configure()
        assert not (await driver.poll()).restarted

    run(main, count=2, simulate={"eds": file}, options={"eds": file})


@pytest.mark.parametrize("shape", ["one ramp for both", "mode by SDO"])
def test_positions_are_streamed_to_a_drive_of_another_shape(shape: str, tmp_path: Path) -> None:
    file = write_shape(tmp_path, SHAPES[shape])

    async def main(world: Drives) -> None:
        await world.ready()
        await released(world, {0: smooth(0, 20_000)})
        _, outcome = await followed(world)
        assert outcome.state == "done", outcome.reason
        assert world.unit.position("1") == 20_000

    run(main, simulate={"eds": file}, options={"eds": file}, **SMOOTH)


@pytest.mark.parametrize("shape", REFUSED)
def test_a_drive_whose_pdos_do_not_suffice_is_refused_in_one_line(shape: str, tmp_path: Path) -> None:
    edits, words = REFUSED[shape]
    file = write_shape(tmp_path, edits)
    with pytest.raises(ValueError) as refused:
        MAKE.check_config(config(1, {"eds": file}))
    text = str(refused.value)
    assert f"options.eds: {words}" in text
    assert text.count("options.eds") == text.count(words) == 1 and "; " in text

    async def main(world: Drives) -> None:
        with pytest.raises(ControllerFault) as caught:
            await world.driver.connect()
        # The drive itself answers the same, without a file.
        assert caught.value.code == "pdo-mapping"
        assert words in caught.value.text
        assert caught.value.remedy
        assert not world.unit.commanded_motions

    run(main, simulate={"eds": file})


def test_two_rpdos_are_refused_only_where_positions_are_streamed(tmp_path: Path) -> None:
    file = write_shape(tmp_path, [without("1402", "1602", "1403", "1603")])
    MAKE.check_config(config(1, {"eds": file}))
    with pytest.raises(ValueError, match="two RPDOs, four are needed to stream positions") as refused:
        MAKE.check_config(config(1, {"eds": file}, **SMOOTH))
    assert "remove `jerk`" in str(refused.value)


@pytest.mark.parametrize("edit", [without("60FD"), with_entry(["60FD"], "PDOMapping", "0")])
def test_named_inputs_need_digital_inputs_in_a_pdo(edit: Edit, tmp_path: Path) -> None:
    file = write_shape(tmp_path, [edit])
    MAKE.check_config(config(1, {"eds": file}))
    with pytest.raises(ValueError, match="remove `inputs`"):
        MAKE.check_config(config(1, {"eds": file}, inputs={"door": {"number": 1}}))


def test_a_drive_without_deceleration_is_planned_with_equal_ramps_in_the_planned_time() -> None:
    draw, units = Random(3), DriveUnits(1.0, 1.0)
    bounds = DriveBounds(80_000, 400_000, equal_ramps=True)
    for _ in range(100):
        velocity = 80_000 * draw.uniform(0.02, 0.9)
        acceleration = min(velocity / draw.uniform(0.05, 1.0), 360_000)
        way = draw.randrange(500, 400_000)
        profile = plan_step([AxisMove("a", 0, way, velocity, acceleration)]).profiles["a"]
        shape = fit_trapezoid(way, profile.duration_s, profile.peak_velocity, bounds, units)
        assert shape is not None
        assert shape.acceleration == shape.deceleration
        assert abs(shape.duration_s - profile.duration_s) < 200e-6


def test_the_commanded_position_of_a_drive_at_rest_is_not_that_of_its_jitter() -> None:
    commanded, draw = CommandedPosition(10), Random(1)
    commanded.begin_motion(1000)
    seen = [commanded.estimate(counts) for counts in (0, 300, 600, 900)]
    assert seen == [0, 300, 600, 900]
    assert {commanded.estimate(1000 + draw.randrange(-9, 10)) for _ in range(50)} == {1000}
    # A short move goes to its target, not to where it was.
    commanded.begin_motion(1004)
    assert {commanded.estimate(1004 + draw.randrange(-5, 6)) for _ in range(50)} == {1004}
    assert commanded.estimate(700) == 700  # pushed, or moved by another master
    assert {commanded.estimate(700 + draw.randrange(-9, 10)) for _ in range(50)} == {700}


@pytest.mark.parametrize("mark", ["utf-16", "utf-16-le", "utf-16-be", "utf-32"])
def test_a_file_in_utf_16_is_refused_as_any_other_file_is(mark: str, tmp_path: Path) -> None:
    file = tmp_path / "drive.eds"
    text = EDS.read_text() if mark in ("utf-16", "utf-32") else "\ufeff" + EDS.read_text()
    file.write_bytes(text.encode(mark))
    with pytest.raises(ValueError, match=r"is UTF-(16|32) text; save it as UTF-8"):
        MAKE.check_config(config(1, {"eds": str(file)}))


@pytest.mark.parametrize(
    ("section", "key", "value"),
    [("6083", "DefaultValue", "1_0"), ("1400sub1", "DefaultValue", "$NODEID+0x2_00"), ("6061", "PDOMapping", "0_1")],
)
def test_a_number_that_is_none_is_refused_with_its_line(section: str, key: str, value: str, tmp_path: Path) -> None:
    file = write_shape(tmp_path, [with_entry([section], key, value)])
    lines = Path(file).read_text().splitlines()
    line = lines.index(f"{key}={value}") + 1
    with pytest.raises(ValueError, match=f"line {line}: {key} is {re.escape(value)}, which is no number"):
        MAKE.check_config(config(1, {"eds": file}))


def test_a_text_may_look_like_a_number(tmp_path: Path) -> None:
    MAKE.check_config(config(1, {"eds": write_shape(tmp_path, [with_entry(["1008"], "DefaultValue", "1_0")])}))


def test_the_table_of_the_page_is_that_of_the_code() -> None:
    page = Path(__file__).parents[3] / "docs" / "reference" / "controllers" / "cia402.md"
    _, _, section = page.read_text(encoding="utf-8").partition("| object | needed for | without it |\n|---|---|---|\n")
    rows = section.partition("\n\n")[0].splitlines()
    assert rows == [f"| {list_indices(need)} | {need.purpose} | {need.without} |" for need in NEEDS]


def list_indices(need: ObjectNeed) -> str:
    return ", ".join(dict.fromkeys(f"{obj.index:04X}h" for obj in need.objects))
