"""Steps of both Yaskawas, whose drivers share what arms, starts, stops and follows them; verdicts by the simulators'
truth. What one of them does in its own way is in `test_smc4000_…` and `test_smc2000_…`."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
import unit.adapters.test_smc2000_bench as smc2000
import unit.adapters.test_smc2000_contour as smc2000_contours
import unit.adapters.test_smc4000_bench as smc4000
import unit.adapters.test_smc4000_contour as smc4000_contours
from unit.adapters.test_smc4000_bench import jerked, trapezoid

from adapters.yaskawa.common.program import STEP_THREAD
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

World = smc4000.World | smc2000.World


@dataclass(frozen=True)
class Model:
    """One of both: its bench, its contours, and how it says that a contour was stopped."""

    run: Callable[..., Any]
    contours: Any
    stopped: str


SMC4000 = Model(smc4000.run, smc4000_contours, "axis x stopped by a stop command")
SMC2000 = Model(smc2000.run, smc2000_contours, "axis x stopped in the middle of its contour")
BOTH = pytest.mark.parametrize("model", [pytest.param(SMC4000, id="smc4000"), pytest.param(SMC2000, id="smc2000")])


async def armed(world: World, profiles: dict[str, Profile]) -> int:
    """Armed for an instant in a second; T0."""
    mapping = world.driver.clock_mapping()
    lowered = world.driver.lower_profiles(profiles, StartOptions(), mapping)
    t0_ns = world.clock.now_ns() + NS_PER_S
    await world.driver.slots.present.load(lowered, t0_ns, mapping)
    return t0_ns


async def require_late(world: World, t0_ns: int) -> None:
    """Released when it is too late: refused, and nothing moves."""
    await sleep_until_ns(world.clock, t0_ns - 10 * NS_PER_MS)
    with pytest.raises(Refusal) as late:
        await world.driver.slots.present.release()
    assert late.value.code == "late"
    with pytest.raises(ControllerFault) as fault:
        await world.driver.slots.present.wait_for_start()
    assert fault.value.code == "late"
    await sleep_ns(world.clock, NS_PER_S)
    assert not world.controller.commanded_motions


@BOTH
def test_a_gate_that_is_never_opened_means_no_motion(model: Model):
    async def main(world: World) -> None:
        await world.ready()
        await require_late(world, await armed(world, {"x": trapezoid(0, 5000, 20_000, 200_000)}))

    model.run(main)


@BOTH
def test_a_gate_that_is_never_opened_plays_no_contour(model: Model):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await model.contours.armed(world, jerked({"x": (0, 20_000)}))
        await require_late(world, t0_ns)
        await world.driver.slots.unload()
        await model.contours.usable(world)

    model.run(main)


@BOTH
def test_a_late_release_is_refused_before_it_is_sent(model: Model):
    """The program would refuse it, too; what depends on one of both is safe with either."""

    async def main(world: World) -> None:
        await world.ready()
        t0_ns = await armed(world, {"x": trapezoid(0, 5000, 20_000, 200_000)})
        await world.driver.slots.present.verify()
        await sleep_until_ns(world.clock, t0_ns - 10 * NS_PER_MS)
        with pytest.raises(Refusal, match="too late to release the start"):
            await world.driver.slots.present.release()
        (opened, *_), _ = await world.driver._device.session.read_numbers("XGO")
        assert not opened

    model.run(main)


@BOTH
def test_a_start_whose_instant_has_passed_is_late_whatever_its_program_says(model: Model):
    async def main(world: World) -> None:
        await world.ready()
        t0_ns = await armed(world, {"x": trapezoid(0, 5000, 20_000, 200_000)})
        await world.driver._device.session.send_settings((f"HX{STEP_THREAD}",))
        await sleep_until_ns(world.clock, t0_ns + NS_PER_MS)
        (late, *_), _ = await world.driver._device.session.read_numbers("XLATE")
        assert not late
        with pytest.raises(Refusal, match="already shut"):
            await world.driver.slots.present.verify()

    model.run(main)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize(
    ("model", "before_ms", "moves"),
    [
        *(pytest.param(SMC4000, ms, ms < 21, id=f"smc4000-{ms}") for ms in (300, 60, 21, 2, 0)),
        *(pytest.param(SMC2000, ms, ms < 30, id=f"smc2000-{ms}") for ms in (300, 60, 30, 5, 0)),
    ],
)
def test_a_stop_while_armed_keeps_everything_at_rest_or_stops_it(
    model: Model, before_ms: int, moves: bool, abort: bool
):
    async def main(world: World) -> None:
        await world.ready()
        t0_ns = await armed(world, {"x": trapezoid(0, 90_000, 90_000, 900_000)})
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns - before_ms * NS_PER_MS)
        await world.driver.stop(abort=abort)
        await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
        assert world.controller.at_rest()
        assert abs(world.controller.position("X")) < 100
        assert moves or not world.controller.commanded_motions

    model.run(main)


@BOTH
def test_axes_without_a_distance_take_part_without_moving(model: Model):
    async def main(world: World) -> None:
        await world.ready()
        still = Profile(0, 0, 0.0, [0.0], [0.0], [0.0])
        for profiles in ({"x": trapezoid(0, 4000, 20_000, 200_000), "y": still}, {"y": still}):
            lowered, started, outcome, _ = await world.moved(profiles)
            assert outcome.state == "done"
            assert set(started) == set(outcome.ended) == set(profiles)
            assert lowered.durations_s["y"] == 0
        assert {motion.axis for motion in world.controller.commanded_motions} == {"X"}

    model.run(main)


@BOTH
def test_a_stop_of_a_contour_in_motion_is_reported_as_a_stop(model: Model):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await model.contours.armed(world, jerked({"x": (0, 90_000)}))
        await world.driver.slots.present.release()
        await world.driver.slots.present.wait_for_start()
        watching = asyncio.get_running_loop().create_task(world.driver.slots.present.wait_for_end())
        await sleep_until_ns(world.clock, t0_ns + 400 * NS_PER_MS)
        await world.driver.stop(abort=False)
        outcome = await watching
        assert outcome.state == "stopped", outcome
        assert model.stopped in outcome.reason
        end_ns = world.controller.commanded_motions[0].end_ns
        assert end_ns is not None
        assert outcome.ended["x"].earliest_ns <= end_ns <= outcome.ended["x"].latest_ns

    model.run(main)


@pytest.mark.parametrize(
    ("model", "options"),
    [(SMC4000, {}), (SMC2000, {"late_contour_error": True})],
    ids=["smc4000", "smc2000"],
)
def test_a_contour_is_played_during_continuous_polls(model: Model, options: dict[str, Any]):
    async def main(world: World) -> None:
        await world.ready()
        _, t0_ns = await model.contours.armed(world, jerked({"x": (0, 150_000), "y": (0, -30_000)}))
        await world.driver.slots.present.release()
        await sleep_until_ns(world.clock, t0_ns + 5 * NS_PER_MS)

        async def polls() -> None:
            while True:
                await world.driver.poll()

        polling = asyncio.get_running_loop().create_task(polls())
        await world.driver.slots.present.wait_for_start()
        outcome = await world.driver.slots.present.wait_for_end()
        polling.cancel()
        assert outcome.state == "done", outcome

    model.run(main, options=options)


@BOTH
@pytest.mark.parametrize(("line", "words"), [("TM 500", "servo period"), ("IT 0.5", "smoothing")])
def test_settings_that_must_not_be_changed_are_refused(model: Model, line: str, words: str):
    async def main(world: World) -> None:
        await world.talk(line)
        await world.driver.connect()
        with pytest.raises(ControllerFault, match=words) as fault:
            await world.driver.configure()
        assert fault.value.code == "config-mismatch"

    model.run(main)
