"""Instants of triggers in plans, and what is refused before anything is asked of a controller."""

from fractions import Fraction
from random import Random
from typing import Any

import numpy as np
import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.profile import Profile
from orchestrator.model.steps.triggers import Trigger
from orchestrator.plan.step import StepPlan
from orchestrator.plan.triggers import MAX_INSTANTS, find_crossings, make_range_finder, resolve_triggers

FLEET = Fleet.model_validate(
    {
        "schema": "tutti.fleet/1",
        "fleet": "test",
        "controllers": {
            "a": {
                "adapter": "smc4000",
                "link": {"kind": "tcp", "host": "10.0.0.1", "port": 23},
                "axes": {
                    "x": {
                        "motors": ["X"],
                        "unit": "mm",
                        "scale": 1000,
                        "limits": {"velocity": 200, "acceleration": 1000},
                    }
                },
                "outputs": {"lamp": {"number": 1}, "brake": {"number": 2}},
                "inputs": {"door": {"number": 1}},
            }
        },
    }
)


def trapezoid(way: int, ramp_s: float, cruise_s: float, start: int = 0) -> Profile:
    """A move of `way` counts with equal ramps."""
    rate = 1.0 / (ramp_s * (ramp_s + cruise_s))
    return Profile(start, start + way, way, [ramp_s, cruise_s, ramp_s], [rate, 0.0, -rate], [0.0, 0.0, 0.0])


def there_and_back(way: int, ramp_s: float) -> Profile:
    """A way out and back to the start, without a rest at its turning point."""
    rate = 1.0 / (ramp_s * ramp_s)
    return Profile(0, 0, way, [ramp_s, 2 * ramp_s, ramp_s], [rate, -rate, rate], [0.0, 0.0, 0.0])


def plan_of(profile: Profile) -> StepPlan:
    return StepPlan(profile.duration_s, {"a.x": profile}, [])


def resolve(offset: float = 0.0, **fields: object):
    trigger = Trigger.model_validate({"output": "a.lamp", **fields})
    (resolved,) = resolve_triggers(FLEET, [trigger], lambda _: Fraction(str(offset)))
    return resolved


def test_a_distance_is_counted_from_the_start_and_includes_the_end() -> None:
    profile = trapezoid(-10_000, 0.1, 0.4, start=5000)
    instants = resolve(every="1 mm", of="a.x").find_instants_ns(plan_of(profile))
    assert len(instants) == 10 and instants[-1] == 600_000_000
    at = profile.make_evaluator()
    assert [at(ns / 1e9).position for ns in instants] == pytest.approx([-1000.0 * k for k in range(1, 11)], abs=0.01)


def test_positions_are_those_of_the_user() -> None:
    profile = trapezoid(10_000, 0.1, 0.4, start=5000)
    # Zero was set where the motor is at 2 mm.
    resolved = resolve(offset=-2.0, at=[4, "5000 um", "1.3 cm"], of="a.x")
    instants = resolved.find_instants_ns(plan_of(profile))
    at = profile.make_evaluator()
    assert [at(ns / 1e9).position for ns in instants] == pytest.approx([1000.0, 2000.0, 10_000.0], abs=0.01)


def test_an_axis_that_comes_back_passes_its_positions_again_and_a_turning_point_once() -> None:
    profile = there_and_back(1000, 0.5)
    times = find_crossings(profile, np.array([0.0, 250.0, 500.0, 1000.0]))
    assert len(times) == 6 and times[2] == pytest.approx(1.0)
    assert times == pytest.approx(sorted(2.0 - t for t in [*times[:5], 0.0]), abs=1e-6)
    # What a fitted profile wavers about a level is no crossing.
    wavering = there_and_back(1000, 0.5)
    assert len(find_crossings(wavering, np.array([999.7]))) == 1


def test_times_end_with_the_step() -> None:
    plan = plan_of(trapezoid(10_000, 0.1, 0.4))
    assert resolve(every="200 ms").find_instants_ns(plan) == [200_000_000, 400_000_000, 600_000_000]
    assert resolve(at=["0 ms", "0.6 s"]).find_instants_ns(plan) == [0, 600_000_000]
    # A plan that is stretched has more of them.
    assert len(resolve(every="200 ms").find_instants_ns(plan.stretch_to(1.0))) == 5


@pytest.mark.parametrize("seed", range(40))
def test_every_crossing_is_at_its_position(seed: int) -> None:
    draw = Random(seed)
    way, sign = draw.randint(50, 400_000), draw.choice((1, -1))
    ramp_s, cruise_s, share = (
        draw.uniform(0.01, 2.0),
        draw.choice((0.0, draw.uniform(0.0, 5.0))),
        draw.uniform(0.01, 1.0),
    )
    profile = trapezoid(sign * way, ramp_s, cruise_s)
    step = way * share
    levels = np.sort(sign * step * np.arange(1, int(way / step) + 1)).astype(np.float64)
    times = find_crossings(profile, levels)
    at = profile.make_evaluator()
    assert len(times) == len(levels)
    assert np.allclose([abs(at(t).position) for t in times], np.sort(np.abs(levels)), atol=1e-3)
    low, high = make_range_finder(profile)(0.0, profile.duration_s)
    assert (low, high) == pytest.approx((min(0, sign * way), max(0, sign * way)), abs=1e-6)


@pytest.mark.parametrize(
    ("fields", "code", "words"),
    [
        ({"at": [30], "of": "a.x"}, "trigger-position", "30 is not on the way of axis a.x"),
        ({"at": [0], "of": "a.x"}, "trigger-position", "its start excluded"),
        ({"at": ["2 s"]}, "trigger-late", "2 s is after the end of the step, which lasts 600 ms"),
        ({"every": "1 s"}, "trigger-never", "over before the first one"),
        ({"every": "1 us"}, "trigger-count", f"the most of a step are {MAX_INSTANTS}"),
        ({"every": "1 nm", "of": "a.x"}, "trigger-count", "divide the step"),
        ({"every": "1 deg", "of": "a.x"}, "bad-unit", "the axis is in mm"),
        ({"output": "a.lamb", "every": "1 ms"}, "unknown-name", "did you mean a.lamp"),
    ],
)
def test_what_a_plan_does_not_have_is_refused(fields: dict[str, Any], code: str, words: str) -> None:
    with pytest.raises(Refusal) as refused:
        resolve(**fields).find_instants_ns(plan_of(trapezoid(10_000, 0.1, 0.4)))
    assert refused.value.code == code
    assert words in f"{refused.value} {refused.value.remedy}" and "triggers.0" in str(refused.value)


def test_an_axis_that_stands_has_no_positions() -> None:
    with pytest.raises(Refusal, match=r"axis a\.x does not move"):
        resolve(every="1 mm", of="a.x").find_instants_ns(StepPlan(1.0, {}, ["a.x"]))
