"""Homing, jogs, limits, stops and the power stage of a drive by its driver."""

import asyncio

import pytest
from unit.adapters.cia402_bench import ACCELERATION, VELOCITY, Drives, run
from unit.random_rounds import share_with_nightly

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal

SWITCH = {"home_switch": [-3000, -2000], "travel": [-20_000, 60_000]}


@pytest.mark.parametrize(
    ("method", "place"),
    [("home_switch_negative", None), ("23", None), ("negative_limit", -20_000), ("current_position", 0), ("33", 0)],
)
def test_the_reference_is_found_by_its_method(method: str, place: float | None) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        found: list[str] = []
        assert await world.driver.home_axes(["a"], found.append) == {}
        assert found == ["a"]
        assert not world.unit.is_moving("1")
        if place is None:
            # At one of the edges of the switch, which is 0 now.
            assert world.unit.position("1") == 0
            assert round(world.unit.station.drive.servo.mechanical_position) in (-3000, -2000)
        # And a step can start there.
        here = (await world.driver.poll()).axes["a"].commanded_counts
        t0_ns = world.clock.now_ns() + 200 * NS_PER_MS
        await world.arm(0, here + 3000, t0_ns, begin=here)
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"

    run(main, simulate=SWITCH, homing={"method": method, "speed": 8000})


@pytest.mark.parametrize("inhibit_ms", share_with_nightly([10, 100, 20, 40], 2))
@pytest.mark.parametrize("method", ["current_position", "23", "negative_limit"])
def test_a_drive_that_has_found_its_reference_is_at_rest(method: str, inhibit_ms: int) -> None:
    """Its position is another one by then, which is no motion."""

    async def main(world: Drives) -> None:
        await world.ready()
        here = (await world.driver.poll()).axes["a"].commanded_counts
        await world.arm(0, here + 3000, world.clock.now_ns() + 200 * NS_PER_MS, begin=here)
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        assert (await world.driver.slots.present.wait_for_end()).state == "done"
        assert await world.driver.home_axes(["a"], lambda _: None) == {}
        reading = (await world.driver.poll()).axes["a"]
        assert not reading.moving and not world.unit.is_moving("1")
        assert abs(reading.commanded_counts) <= 1 or method == "negative_limit"

    run(main, simulate=SWITCH, options={"inhibit_ms": inhibit_ms}, homing={"method": method, "speed": 8000})


def test_a_homing_ends_when_its_drive_is_disconnected() -> None:
    """The drive may have become silent on a bus that others still have open: its homing gets no further messages."""

    async def main(world: Drives) -> None:
        await world.ready()
        searching = asyncio.ensure_future(world.driver.home_axes(["a"], lambda _: None))
        await world.rest(200)
        assert world.unit.is_moving("1") and not searching.done()
        await world.driver.close()
        with pytest.raises(LinkClosed):
            await asyncio.wait_for(searching, 0.01)

    run(main, simulate=SWITCH, homing={"method": "home_switch_negative", "speed": 2000})


def test_a_missing_reference_is_reported() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        failed = await world.driver.home_axes(["a"], lambda _: None)
        assert failed["a"].code == "homing-failed"
        assert failed["a"].remedy

    run(main, simulate={"travel": [-5000, 5000]}, homing={"method": "23", "speed": 8000})


def test_a_method_that_the_drive_does_not_have_is_refused() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        with pytest.raises(Refusal) as caught:
            await world.driver.home_axes(["a"], lambda _: None)
        assert caught.value.code == "homing-method"
        assert "invalid value" in caught.value.text

    run(main, homing={"method": "15"})


@pytest.mark.parametrize("cancelled", [False, True])
def test_homing_ends_with_a_stop_or_with_the_timeout_of_its_caller(cancelled: bool) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        homing = asyncio.get_running_loop().create_task(world.driver.home_axes(["a"], lambda _: None))
        await world.rest(300)
        assert world.unit.is_moving("1")
        if cancelled:
            homing.cancel()
            with pytest.raises(asyncio.CancelledError):
                await homing
        else:
            await world.driver.stop(abort=False)
            assert "stopped" in str((await homing)["a"])
        await world.rest(400)
        assert not world.unit.is_moving("1")
        axis = (await world.driver.poll()).axes["a"]
        assert axis.enabled
        assert not axis.moving

    run(main, simulate={"home_switch": [-90_000, -80_000]}, homing={"method": "27", "speed": 8000})


def test_a_jog_ends_by_itself_is_changed_and_reversed() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.jog_axis("a", JogMove(10_000, ACCELERATION, 5000))
        await world.rest(100)
        assert (await world.driver.poll()).axes["a"].moving
        await world.driver.jog_axis("a", JogMove(20_000, ACCELERATION, 5000))
        await world.rest(1000)
        assert world.unit.position("1") == 5000
        assert not (await world.driver.poll()).axes["a"].moving
        with pytest.raises(Refusal) as caught:
            await world.driver.jog_axis("a", JogMove(20_000, ACCELERATION, 5000))
        assert caught.value.code == "at-end"
        await world.driver.jog_axis("a", JogMove(20_000, ACCELERATION, None))
        await world.rest(300)
        await world.driver.jog_axis("a", JogMove(-20_000, ACCELERATION, None))
        await world.rest(300)
        assert world.unit.velocity("1") == pytest.approx(-20_000, rel=1e-3)
        await world.driver.stop_axes(["a"])
        await world.rest(300)
        assert not world.unit.is_moving("1")

    run(main)


def test_a_jog_is_over_for_a_drive_that_was_switched_off_and_on() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.jog_axis("a", JogMove(10_000, ACCELERATION, None))
        await world.rest(100)
        world.unit.set_power(on=False)
        await world.rest(20)
        world.unit.set_power(on=True)
        await world.rest(500)
        assert (await world.driver.poll()).restarted
        await world.driver.set_enabled(["a"], on=True)
        assert not (await world.driver.poll()).axes["a"].moving
        assert await world.driver.home_axes(["a"], lambda _: None) == {}

    run(main)


def test_a_step_is_refused_while_jogging_and_a_jog_while_a_step_is_loaded() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.jog_axis("a", JogMove(10_000, ACCELERATION, None))
        await world.rest(50)
        with pytest.raises(Refusal) as caught:
            await world.arm(0, 50_000, world.clock.now_ns() + 500 * NS_PER_MS)
        assert caught.value.code == "busy"
        await world.driver.stop(abort=False)
        await world.rest(300)
        here = (await world.driver.poll()).axes["a"].commanded_counts
        await world.arm(0, 50_000, world.clock.now_ns() + 500 * NS_PER_MS, begin=here)
        with pytest.raises(Refusal) as caught:
            await world.driver.jog_axis("a", JogMove(10_000, ACCELERATION, None))
        assert caught.value.code == "busy"

    run(main)


def test_limits_are_loaded_and_removed() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.load_soft_limits({"a": (-1000, 3000)})
        assert await world.driver.send_raw("607D:2/32") == "3000"
        await world.driver.jog_axis("a", JogMove(10_000, ACCELERATION, None))
        await world.rest(1500)
        assert world.unit.position("1") == 3000
        await world.driver.load_soft_limits({"a": None})
        await world.driver.jog_axis("a", JogMove(10_000, ACCELERATION, 4000))
        await world.rest(1500)
        assert world.unit.position("1") == 4000

    run(main)


@pytest.mark.parametrize("abort", [False, True])
def test_a_stop_clears_the_target_and_leaves_the_motor_on(abort: bool) -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        t0_ns = await world.go(target=200_000)
        await world.driver.slots.present.wait_for_start()
        await world.until(t0_ns + 700 * NS_PER_MS)
        begun_ns = world.clock.now_ns()
        await world.driver.stop(abort=abort)
        outcome = await world.driver.slots.present.wait_for_end()
        assert outcome.state == "stopped"
        took_ms = (world.unit.commanded_motions[-1].end_ns - begun_ns) / NS_PER_MS
        # By the ramp of the profile, or by the quick stop ramp of the fleet file.
        ramp_ms = 1000 * VELOCITY / 2 / (2_000_000 if abort else ACCELERATION / 2)
        assert ramp_ms <= took_ms <= ramp_ms + 5
        await world.rest(1000)
        assert len(world.unit.commanded_motions) == 1
        assert (await world.driver.poll()).axes["a"].enabled

    run(main, options={"quick_stop_acceleration": 2_000_000})


def test_outputs_are_written_and_inputs_and_limit_switches_read() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        world.unit.set_input(3, level=True)
        world.unit.set_limit("1", "forward")
        await world.rest(20)
        reading = await world.driver.poll()
        assert reading.inputs[3]
        assert not reading.inputs[4]
        assert reading.axes["a"].limit == "forward"
        world.unit.set_limit("1", "both")
        await world.rest(20)
        assert (await world.driver.poll()).axes["a"].limit == "both"

    run(main)
