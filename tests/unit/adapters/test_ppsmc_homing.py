"""Homing of the SMC by all its documented methods, and the results."""

import asyncio
import contextlib
from typing import Any

import pytest
from unit.adapters.ppsmc_bench import Bench, controller, run

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal

SWITCHES: dict[str, Any] = {
    "encoder": True,
    "encoder_follows": True,
    "travel_steps": dict.fromkeys("123", (-20000, 20000)),
    "org_steps": dict.fromkeys("123", (-6000, -4000)),
    "sd_steps": dict.fromkeys("123", (-3000, -2000)),
    "index_steps": dict.fromkeys("123", (-1010, -1000)),
}
# By method and direction: the mechanical place where it ends.
PLACES = {
    ("default", "negative"): -3999,
    ("org", "positive"): -6001,
    ("ref", "negative"): -3999,
    # Its first search overshoots: the index is found again from beyond it.
    ("index", "negative"): -1010,
    ("index", "positive"): -1000,
    ("switch", "negative"): -6001,
    ("switch", "positive"): -3999,
    ("slowdown", "negative"): -3001,
    ("limit", "negative"): -19_999,
    ("limit", "positive"): 19_999,
    ("here", "negative"): 700,
}


def config(method: str, direction: str = "negative", **more: Any) -> Any:
    return controller(axis={"homing": {"method": method, "direction": direction, "speed": 10, **more}})


@pytest.mark.parametrize(("method", "direction"), PLACES)
def test_each_homing_method_ends_at_its_place_and_reports_it(method: str, direction: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        start = -10_000 if (method, direction) in (("org", "positive"), ("index", "positive")) else 700
        assert (await bench.move({"x": start, "z": start})).state == "done"
        found: list[str] = []
        assert await bench.driver.home_axes(["x", "z"], found.append) == {}
        assert sorted(found) == ["x", "z"]
        reading = await bench.driver.poll()
        for name, motor in (("x", "1"), ("z", "3")):
            axis = bench.unit.find_axis(motor)
            assert reading.axes[name].commanded_counts == 0 == axis.steps
            assert axis.steps - axis.origin == PLACES[method, direction]
            assert not reading.axes[name].position_lost
        assert not reading.faults
        away = -1500 if PLACES[method, direction] > 0 else 1500
        assert (await bench.move({"x": away})).state == "done"

    run(case, simulate=SWITCHES, config=config(method, direction))


def test_an_installed_reference_is_taken_as_found_without_motion() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert await bench.driver.home_axes(["x"], lambda _: None) == {}
        before = len(bench.moved())
        found: list[str] = []
        assert await bench.driver.home_axes(["x"], found.append) == {}
        assert found == ["x"] and len(bench.moved()) == before

    run(case, simulate=SWITCHES, config=config("org"))


def test_without_its_switch_an_axis_fails_and_the_others_finish() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        found: list[str] = []
        failed = await bench.driver.home_axes(["x", "y", "z"], found.append)
        assert list(failed) == ["y"] and found == ["x", "z"]
        assert "limit switch" in failed["y"].text and failed["y"].remedy

    simulate = {**SWITCHES, "org_steps": {"1": (-6000, -4000), "3": (-6000, -4000)}}
    run(case, simulate=simulate, config=config("default"))


@pytest.mark.parametrize("clears", [True, False])
def test_a_limit_stop_loses_the_reference_and_homing_restores_it(clears: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert await bench.driver.home_axes(["x"], lambda _: None) == {}
        assert not (await bench.driver.poll()).axes["x"].position_lost
        await bench.start({"x": 60_000})
        await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "limit switch" in outcome.reason
        reading = await bench.driver.poll()
        assert reading.axes["x"].position_lost and reading.axes["x"].limit == "forward"
        assert [fault.code for fault in reading.faults] == ["limit-error"]
        with pytest.raises(Refusal) as caught:
            await bench.arm({"x": reading.axes["x"].commanded_counts + 100})
        assert caught.value.code == "limit"
        await bench.driver.slots.unload()
        await bench.driver.clear_faults()
        # Off the switch, though it is active when the move begins (tbg:iel).
        assert (await bench.move({"x": reading.axes["x"].commanded_counts - 5000})).state == "done"
        if bench.config.axes["x"].homing.method == "org" and not clears:
            with pytest.raises(Refusal) as refused:
                await bench.driver.home_axes(["x"], lambda _: None)
            assert refused.value.code == "already-referenced"
            return
        assert await bench.driver.home_axes(["x"], lambda _: None) == {}
        assert not (await bench.driver.poll()).axes["x"].position_lost

    for method in ("org", "switch"):
        run(case, simulate={**SWITCHES, "limit_clears_reference": clears}, config=config(method))


async def _run_into_limit(bench: Bench) -> None:
    """Home, run into the forward limit switch, clear its error, and come off it again."""
    await bench.ready()
    assert await bench.driver.home_axes(["x"], lambda _: None) == {}
    await bench.driver.poll()
    await bench.start({"x": 60_000})
    await bench.driver.slots.present.wait_for_start()
    assert (await bench.driver.slots.present.wait_for_end()).state == "fault"
    counts = (await bench.driver.poll()).axes["x"].commanded_counts
    await bench.driver.clear_faults()
    assert (await bench.move({"x": counts - 5000})).state == "done"


@pytest.mark.parametrize("reconnects", [False, True])
@pytest.mark.parametrize("ends_by", ["reset", "power"])
def test_a_reference_that_the_controller_keeps_after_a_limit_stop_is_forgotten_by_a_restart(
    reconnects: bool, ends_by: str
) -> None:
    """The position is not valid (L2546), also after a new connection, and `org` moves nothing while the controller
    reports a reference (L2333): a search was taken for done after a new connection. A restart ends both (L2648)."""

    async def case(bench: Bench) -> None:
        await _run_into_limit(bench)
        if reconnects:
            await bench.reached_again()
        with pytest.raises(Refusal) as refused:
            await bench.driver.home_axes(["x"], lambda _: None)
        assert refused.value.code == "already-referenced" and "reset" in refused.value.remedy
        assert (await bench.driver.poll()).axes["x"].position_lost
        if ends_by == "reset":
            with contextlib.suppress(ControllerFault):
                await bench.driver.send_raw("reset")
        else:
            bench.unit.set_power(on=False)
            bench.unit.set_power(on=True)
        await sleep_ns(bench.clock, 5 * NS_PER_S)
        with contextlib.suppress(ControllerFault, LinkClosed):
            await bench.driver.poll()
        await bench.driver.connect()
        await bench.driver.configure()
        assert (await bench.driver.poll()).restarted
        place = bench.unit.find_axis("1").steps - bench.unit.find_axis("1").origin
        assert await bench.driver.home_axes(["x"], lambda _: None) == {}
        assert not (await bench.driver.poll()).axes["x"].position_lost
        axis = bench.unit.find_axis("1")
        assert place != axis.steps - axis.origin == PLACES["default", "negative"]

    run(case, simulate={**SWITCHES, "limit_clears_reference": False}, config=config("org"))


@pytest.mark.parametrize("after_ms", [300, 1500])
@pytest.mark.parametrize("how", ["stop", "abort", "axis", "power", "cancel"])
def test_an_interrupted_homing_is_no_success(how: str, after_ms: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        found: list[str] = []
        homing = asyncio.get_running_loop().create_task(bench.driver.home_axes(["x"], found.append))
        await sleep_ns(bench.clock, after_ms * NS_PER_MS)
        if how == "power":
            bench.unit.set_power(on=False)
            bench.unit.set_power(on=True)
        elif how == "axis":
            await bench.driver.stop_axes(["x"])
        elif how == "cancel":
            homing.cancel()
        else:
            await bench.driver.stop(abort=how == "abort")
        with contextlib.suppress(Refusal, ControllerFault, LinkClosed, LinkRefused, asyncio.CancelledError):
            assert list(await homing) == ["x"]
        assert not found
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moving
        if how == "power":
            await bench.reached_again()
        await bench.driver.clear_faults()
        assert await bench.driver.home_axes(["x"], found.append) == {} and found == ["x"]

    run(case, simulate=SWITCHES, config=config("default", speed=1))


def test_a_moving_controller_and_a_disabled_axis_are_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.set_enabled(["x"], on=False)
        for call in (bench.driver.home_axes(["x"], lambda _: None), bench.arm({"x": 100})):
            with pytest.raises(Refusal, match="enable"):
                await call
        await bench.driver.set_enabled(["x"], on=True)
        await bench.send_as_other_client("move3:5")
        with pytest.raises(Refusal, match="moves"):
            await bench.driver.home_axes(["x"], lambda _: None)
        await bench.rest()

    run(case, simulate=SWITCHES)
