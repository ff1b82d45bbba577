"""Straight paths: by the controller's interpolation if that is nearer to the plan, by single axes otherwise."""

from collections.abc import Mapping
from math import hypot
from random import Random
from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import NAMES, Bench, controller, run

from adapters.shrc203.lowering import ShrcLowered
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile


def slow_controller(**axis: Any) -> Controller:
    """Pulses of 1 nm; axes that may start at up to 200 pls/s."""
    config = controller("xyz")
    axes = {
        name: {
            **each.model_dump(),
            "limits": {"velocity": 0.1, "acceleration": 10.0},
            "start_rate": {"min": 1e-6, "max": 2e-4},
            **axis,
        }
        for name, each in config.axes.items()
    }
    return Controller.model_validate({**config.model_dump(), "axes": axes})


CONFIG = slow_controller()
LINE_S = hypot(1200, 14) / 95  # an interpolated line goes at whole pulses/s


def straight(distances: Mapping[str, int], duration_s: float, ramp_s: float) -> dict[str, Profile]:
    """One trapezoid for all axes, each with its scale."""
    rate = 1 / (ramp_s * (duration_s - ramp_s))
    return {
        name: Profile(
            0, way, float(way), (ramp_s, duration_s - 2 * ramp_s, ramp_s), (rate, 0.0, -rate), (0.0, 0.0, 0.0)
        )
        for name, way in distances.items()
    }


def lowered(bench: Bench, profiles: Mapping[str, Profile], how: StartOptions | None = None) -> ShrcLowered:
    found = bench.driver.lower_profiles(profiles, how or StartOptions(), None)
    assert isinstance(found, ShrcLowered)
    return found


def distance_to_plan(bench: Bench, profiles: Mapping[str, Profile], start_ns: int, at_ns: int) -> float:
    planned = {name: each.state_at((at_ns - start_ns) / 1e9).position for name, each in profiles.items()}
    return max(abs(bench.unit.position(NAMES[name]) - way) for name, way in planned.items())


@pytest.mark.parametrize("distances", [{"x": 1200, "y": -14}, {"x": 1000, "y": 18, "z": -600}])
def test_a_path_that_single_axes_cannot_follow_is_interpolated_within_its_bounds(
    distances: dict[str, int],
) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        profiles = straight(distances, hypot(*distances.values()) / 95, 0.001)
        made = lowered(bench, profiles)
        assert made.straight is not None and made.load.startswith("KP:")
        t0_ns = bench.clock.now_ns() + 400 * NS_PER_MS
        await bench.driver.slots.present.load(made, t0_ns, None)
        await bench.driver.slots.present.verify()
        assert not bench.moved()
        await bench.driver.slots.present.release()
        started = await bench.driver.slots.present.wait_for_start()
        start_ns = bench.unit.commanded_motions[0].start_ns
        worst = 0.0
        for _ in range(120):
            await sleep_ns(bench.clock, 100 * NS_PER_MS)
            worst = max(worst, distance_to_plan(bench, profiles, start_ns, bench.clock.now_ns()))
        assert worst <= max(made.path_error_counts.values())
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "done", outcome
        for name, way in distances.items():
            (motion,) = [each for each in bench.unit.commanded_motions if each.axis == NAMES[name]]
            assert motion.end_counts == way and motion.end_ns is not None
            assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
            assert outcome.ended[name].earliest_ns <= motion.end_ns <= outcome.ended[name].latest_ns
        await bench.start({"x": 0})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, config=CONFIG)


@pytest.mark.parametrize("seed", range(40))
def test_the_chosen_method_is_never_further_from_the_plan(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        speed = 10 ** draw.uniform(0.5, 4.5)
        duration_s = draw.uniform(1.0, 20.0)
        distances = {name: round(draw.uniform(-1, 1) * speed * duration_s) or 1 for name in draw.sample("xyz", 2)}
        profiles = straight(distances, duration_s, min(10 ** draw.uniform(-3, 0), duration_s / 3))
        try:
            made = lowered(bench, profiles)
        except Refusal:
            return
        try:
            alone = {name: lowered(bench, {name: each}).path_error_counts[name] for name, each in profiles.items()}
        except Refusal:
            assert made.straight is not None  # single axes cannot be so slow
        else:
            assert max(made.path_error_counts.values()) <= max(alone.values())
        if made.straight is not None:
            assert made.straight.duration_s >= duration_s * (1 - 1e-6)
            for way in distances.values():
                assert made.straight.speed * abs(way) / hypot(*distances.values()) <= 200

    run(case, config=CONFIG)


@pytest.mark.parametrize(
    ("config", "profiles"),
    [
        (CONFIG, straight({"x": 60_000, "y": -700}, 6.3, 0.1)),  # too fast to be started without a ramp
        (CONFIG, {**straight({"x": 1200}, LINE_S, 0.001), **straight({"y": 14}, LINE_S, 0.5)}),  # no straight line
        (
            slow_controller(scale=1_000_000, unit="deg"),
            straight({"x": 1200, "y": -14}, LINE_S, 0.001),
        ),  # pulses unknown
        (CONFIG, straight({"x": 1200}, LINE_S, 0.001)),
    ],
)
def test_other_paths_than_slow_straight_ones_in_equal_pulses_use_single_axes(
    config: Controller, profiles: dict[str, Profile]
) -> None:
    async def case(bench: Bench) -> None:
        await bench.driver.connect()
        made = lowered(bench, profiles)
        assert made.straight is None and made.load.startswith("MP:")

    run(case, config=config)


@pytest.mark.parametrize("end", ["disarm", "stop", "abort"])
def test_a_withdrawn_linear_move_never_starts(end: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        made = lowered(bench, straight({"x": 1200, "y": -14}, LINE_S, 0.001))
        assert made.straight is not None
        await bench.driver.slots.present.load(made, bench.clock.now_ns() + 400 * NS_PER_MS, None)
        await bench.driver.slots.present.verify()
        if end == "disarm":
            await bench.driver.slots.unload()
        else:
            await bench.driver.stop(abort=end == "abort")
            await bench.driver.clear_faults()
            await bench.driver.set_enabled(["x", "y", "z"], on=True)
            for _ in range(2):
                await bench.driver.poll()
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved()

    run(case, config=CONFIG)


def test_a_garbled_line_is_refused() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        made = lowered(bench, straight({"x": 1200, "y": -14}, LINE_S, 0.001))
        bench.wire.to_far = lambda data: data.replace(b"P1200", b"P1800")
        with pytest.raises(Refusal) as caught:
            await bench.driver.slots.present.load(made, bench.clock.now_ns() + 400 * NS_PER_MS, None)
        assert caught.value.code == "load-garbled"

    run(case, config=CONFIG)
