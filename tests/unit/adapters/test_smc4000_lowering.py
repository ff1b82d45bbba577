"""How the SMC-4000's adapter chooses between registers and contour, and how exact both are: pure, over many seeds."""

import math
from collections.abc import Mapping
from random import Random
from typing import Any

import pytest
from unit.adapters.test_smc4000_bench import FLEET, trapezoid
from unit.random_rounds import share_with_nightly

from adapters.yaskawa.common.lowering import ContourLoad, LoweringContext, RegisterLoad, YaskawaLowered, lower_moves
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.shapes.contour import FEWEST_RECORDS, ContourLimits, axis_increments, fit_contour, least_interval
from adapters.yaskawa.shapes.model import SMC4000
from adapters.yaskawa.shapes.trapezoid import YaskawaBounds, fit_registers
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.model.state import StepCosts
from orchestrator.plan.step import AxisMove, plan_step

TICK_NS = 976_562.5
CONFIG = Controller.model_validate(FLEET)
ROOM = ContourLimits(15_000, 2, 10.0)
COSTS = StepCosts(arm_ns=1, disarm_ns=1, stop_ns=1)


def mapping(tick_ns: float = TICK_NS) -> TickMapping:
    return TickMapping(1000, 10**9, tick_ns, 0.0, 0, 100_000, 1.0, 50, 200_000)


def lower(profiles: Mapping[str, Profile], tick_ns: float = TICK_NS, **options: Any) -> YaskawaLowered:
    motors = {"x": 0, "y": 1}
    return lower_moves(
        LoweringContext(CONFIG, motors, YaskawaOptions(**options), COSTS), profiles, StartOptions(), mapping(tick_ns)
    )


def random_plans(draw: Random, order: int, slowest: float = 10.0) -> dict[str, Profile]:
    """Up to two axes in one time, of any size and speed."""
    moves: list[AxisMove] = []
    for axis in draw.sample(["x", "y"], draw.randint(1, 2)):
        start = draw.randrange(-100_000, 100_000)
        velocity = slowest * (100_000.0 / slowest) ** draw.random()
        acceleration = min(1e6, velocity * draw.uniform(1.0, 50.0))
        way = draw.choice((-1, 1)) * max(1, round(velocity * draw.uniform(0.001, 8.0)))
        jerk = acceleration * draw.uniform(2.0, 100.0) if order == 3 else None
        moves.append(AxisMove(axis, start, start + way, velocity, acceleration, jerk, order=3))
    return dict(plan_step(moves).profiles)


@pytest.mark.parametrize("seed", share_with_nightly(range(10), 3))
def test_contours_of_random_plans_are_exact_at_every_instant_and_in_their_sum(seed: int):
    draw = Random(seed)
    for _ in range(40):
        tick_ns = TICK_NS * (1 + draw.uniform(-1e-4, 1e-4))
        profiles = random_plans(draw, draw.choice((2, 3)))
        contour = fit_contour(profiles, tick_ns, ROOM, SMC4000)
        phase = draw.uniform(-0.5, 0.5)
        instants = contour.record_ends
        assert contour.record_count * len(profiles) <= ROOM.elements
        assert len(instants) == contour.record_count and contour.records >= FEWEST_RECORDS
        assert list(contour.tail) == sorted(set(contour.tail), reverse=True)
        assert all(1 <= n < contour.interval for n in contour.tail)
        for axis, profile in profiles.items():
            end = contour.ends[axis]
            steps = axis_increments(profile, end, contour, phase, tick_ns)
            assert len(steps) == contour.record_count
            assert sum(steps) == profile.end_counts - profile.start_counts
            assert max(map(abs, steps)) <= SMC4000.record_max
            assert steps[instants.index(end)] and not any(steps[instants.index(end) + 1 :])
            at, plan, tick_s = 0, profile.make_evaluator(), tick_ns * 1e-9
            for instant, step in zip(instants, steps, strict=True):
                at += step
                assert abs(at - plan((phase + instant) * tick_s).position) <= 1.0
                # Never beyond its target, never back.
                assert step == 0 or (step > 0) == (profile.end_counts > profile.start_counts)
            if contour.records > FEWEST_RECORDS:
                assert abs(end - profile.duration_s / tick_s) <= 2.0
                if profile.duration_s * (1 + 1e-9) >= max(each.duration_s for each in profiles.values()):
                    assert end == instants[-1]


def test_between_two_instants_a_contour_deviates_by_no_more_than_its_bound():
    draw = Random(3)
    for _ in range(30):
        profiles = random_plans(draw, 3, 5_000.0)
        lowered = lower(profiles)
        assert isinstance(lowered.load, ContourLoad)
        contour, tick_s = lowered.load.contour, TICK_NS * 1e-9
        for axis, profile in profiles.items():
            plan = profile.make_evaluator()
            at, before = 0.0, 0
            for instant, step in zip(
                contour.record_ends, axis_increments(profile, contour.ends[axis], contour, 0.0, TICK_NS), strict=True
            ):
                for sample in range(before, instant):
                    real = at + step * (sample - before) / (instant - before)
                    assert abs(real - plan(sample * tick_s).position) <= lowered.path_error_counts[axis]
                at, before = at + step, instant


@pytest.mark.parametrize("seed", range(5))
def test_fast_trapezoids_use_registers_and_last_as_planned(seed: int):
    draw = Random(seed)
    by_contour = 0
    for _ in range(40):
        velocity, acceleration = draw.uniform(20_000, 100_000), draw.uniform(200_000, 1_000_000)
        profile = trapezoid(0, draw.randrange(20_000, 500_000), velocity, acceleration, draw.uniform(1.0, 1.3))
        lowered = lower({"x": profile})
        by_contour += isinstance(lowered.load, ContourLoad)
        held = isinstance(lowered.load, RegisterLoad) and lowered.load.shapes[0].at_limit
        assert abs(lowered.durations_s["x"] - profile.duration_s) < (1e-3 * profile.duration_s if held else 0.2e-3)
        assert lowered.path_error_counts["x"] <= max(2.0, 10 * profile.peak_velocity * 1e-3)
    assert by_contour <= 4


@pytest.mark.parametrize(("velocity", "ramp"), [(11.0, 30.0), (101.0, 500.0), (3.0, 3.0)])
def test_slow_trapezoids_use_contour_mode_and_report_why(velocity: float, ramp: float):
    profile = trapezoid(0, round(velocity * 5), velocity, ramp)
    lowered = lower({"x": profile, "y": trapezoid(0, 50_000, 40_000, 204_800)})
    assert isinstance(lowered.load, ContourLoad)
    assert lowered.durations_s["x"] == pytest.approx(profile.duration_s)
    assert lowered.path_error_counts["x"] < 2.0
    assert lowered.commands[0].startswith("contour: ")
    assert lowered.commands[-1].startswith("(with its registers x ends ")


def test_a_slow_trapezoid_too_long_for_a_contour_uses_registers_and_reports_its_duration():
    profile = trapezoid(0, 1001 * 100, 1_001.0, 5_000.0)
    lowered = lower({"x": profile}, array_elements=300, contour_sag_counts=0.0)
    assert isinstance(lowered.load, RegisterLoad)
    shape = lowered.load.shapes[0]
    assert lowered.durations_s["x"] == pytest.approx(shape.length * TICK_NS * 1e-9)
    assert lowered.durations_s["x"] != pytest.approx(profile.duration_s, abs=1e-4)
    assert "with its registers x ends" in lowered.commands[-1] and "no contour: axis x" in lowered.commands[-1]


def test_a_plan_at_its_limits_uses_the_registers_and_reports_its_duration():
    config = Controller.model_validate(
        FLEET
        | {
            "axes": {
                "x": {
                    "motors": ["X"],
                    "unit": "counts",
                    "limits": {"velocity": 30_001.0, "acceleration": 300_500.0},
                }
            }
        }
    )
    profile = trapezoid(0, 100_000, 30_001.0, 300_500.0)
    lowered = lower_moves(
        LoweringContext(config, {"x": 0}, YaskawaOptions(), COSTS), {"x": profile}, StartOptions(), mapping()
    )
    assert isinstance(lowered.load, RegisterLoad)
    assert 0 < lowered.durations_s["x"] - profile.duration_s < 1e-3 * profile.duration_s
    again = profile.stretch_time(lowered.durations_s["x"] / profile.duration_s)
    second = lower_moves(
        LoweringContext(config, {"x": 0}, YaskawaOptions(), COSTS), {"x": again}, StartOptions(), mapping()
    )
    assert second.durations_s["x"] == pytest.approx(again.duration_s, abs=2e-4)


def test_a_trapezoid_with_unequal_ramps_uses_contour_mode():
    profile = Profile(0, 100, 50.0, [1.0, 0.5, 2.0], [1.0, 0.0, -0.5], [0.0] * 3)
    lowered = lower({"x": profile})
    assert isinstance(lowered.load, ContourLoad)
    assert lowered.durations_s["x"] == pytest.approx(profile.duration_s)


def test_records_lengthen_only_as_far_as_they_must_and_may():
    # 15,000 elements of one axis: 58 s of records of 4 samples.
    for seconds, interval in ((10.0, 2), (50.0, 2), (70.0, 3), (150.0, 4)):
        velocity = 1_000.0
        profiles = dict(plan_step([AxisMove("x", 0, round(velocity * seconds), velocity, 5e3, 5e4, order=3)]).profiles)
        contour = fit_contour(profiles, TICK_NS, ROOM, SMC4000)
        assert contour.interval == interval
    steep = dict(plan_step([AxisMove("x", 0, 10_000_000, 1e5, 1e6, 1e7, order=3)]).profiles)
    with pytest.raises(Refusal) as refusal:
        fit_contour(steep, TICK_NS, ContourLimits(15_000, 2, 5.0), SMC4000)
    assert refusal.value.code == "contour-too-long"
    assert "axis x" in refusal.value.text and "at most 58.6 s" in refusal.value.remedy
    assert fit_contour(steep, TICK_NS, ROOM, SMC4000).interval == 3


def test_the_shortest_record_is_one_that_the_program_keeps_up_with():
    assert least_interval(3.75e6, TICK_NS, SMC4000) == 2
    assert least_interval(4.0e6, TICK_NS, SMC4000) == 3
    assert least_interval(3.75e6, TICK_NS / 4, SMC4000) == 4
    jerked = dict(plan_step([AxisMove("x", 0, 50_000, 5e4, 5e5, 5e6, order=3)]).profiles)
    slow = lower(jerked, decode_us=1000)
    assert isinstance(slow.load, ContourLoad) and slow.load.contour.interval == 4
    usual, quick = lower(jerked), lower(jerked, decode_us=300)
    assert isinstance(usual.load, ContourLoad) and usual.load.contour.interval == 3
    assert isinstance(quick.load, ContourLoad) and quick.load.contour.interval == 2


def test_a_move_that_is_faster_than_its_registers_is_refused_with_what_would_fit():
    fast = dict(plan_step([AxisMove("x", 0, 10**8, 1.3e7, 6e7, 1e9, order=3)]).profiles)
    with pytest.raises(Refusal) as refusal:
        fit_contour(fast, TICK_NS, ContourLimits(15_000, 1, 10.0), SMC4000)
    assert refusal.value.code == "too-fast"
    assert "axis x" in refusal.value.text and "at most 1.2e+07" in refusal.value.remedy


def test_the_cost_of_arming_grows_with_the_loaded_data():
    short, long = (
        lower(dict(plan_step([AxisMove("x", 0, way, 5e4, 5e5, 5e6, order=3)]).profiles)) for way in (10_000, 500_000)
    )
    flat = lower({"x": trapezoid(0, 100_000, 50_000, 512_000)})
    assert flat.costs.arm_ns < short.costs.arm_ns < long.costs.arm_ns < 2e9


def test_registers_of_a_triangle_and_of_one_count():
    for way in (1, 2, 3, 50):
        profile = trapezoid(0, way, 100_000.0, 1e6)
        shape = fit_registers({"x": profile}, {"x": YaskawaBounds(1e5, 1e6)}, TICK_NS, SMC4000)["x"]
        assert math.isfinite(shape.length) and shape.whole_samples >= 1
        lowered = lower({"x": profile})
        assert lowered.durations_s["x"] < 0.02


@pytest.mark.parametrize("lead_ns", range(1_000_000_000, 1_001_000_000, 130_000))
def test_a_move_ends_at_the_sample_next_to_the_end_of_the_plan_once_its_start_is_fixed(lead_ns: int):
    """At most half a sample off T0 at its start, and up to a whole one more at its end."""
    draw, clock = Random(lead_ns), mapping(TICK_NS * (1 + 40e-6))
    t0_ns = clock.host_at_ns + lead_ns
    for _ in range(20):
        way = draw.randrange(200_000, 3_000_000)
        profile = plan_step([AxisMove("x", 0, way, draw.uniform(20_000, 80_000), 4e5, None, order=2)]).profiles["x"]
        motors, how = {"x": 0}, StartOptions(lead_ns=lead_ns, exact=True)
        lowered = lower_moves(LoweringContext(CONFIG, motors, YaskawaOptions(), COSTS), {"x": profile}, how, clock)
        start_ns = clock.to_host_ns(round(clock.to_ticks(t0_ns)))
        end_ns = start_ns + lowered.moves[0].samples * clock.tick_ns
        assert isinstance(lowered.load, RegisterLoad)
        assert abs(end_ns - t0_ns - profile.duration_s * 1e9) <= 0.501 * clock.tick_ns
