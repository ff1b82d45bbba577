"""Lowering for the SMC: durations, limits, path errors, refusals; nothing here touches a controller."""

from random import Random
from typing import Any

import pytest
from pydantic import ValidationError
from unit.adapters.ppsmc_bench import controller

from adapters.ppsmc import MAKE, fleetaxes
from adapters.ppsmc.lowering import ConnectionTraits, PpSmcLowered, lower_step
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import ERRORS, POSITIONS, PROGRAM, SETTINGS, STATUS, TARGETS, leading_number
from adapters.ppsmc.trapezoid import PpSmcBounds, PpSmcTrapezoid, fit_trapezoid
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step

KNOWN = PpSmcOptions().unread_clock().estimate_at(0)


def lowered(profile: Profile, options: PpSmcOptions | None = None, **axis: Any) -> PpSmcLowered:
    options = options or PpSmcOptions()
    known = options.unread_clock().estimate_at(0)
    return lower_step(
        controller("x", axis=axis), options, ConnectionTraits(0, 1, known), {"x": profile}, StartOptions()
    )


def planned(distance: int, velocity: float, acceleration: float, factor: float = 1.0) -> Profile:
    plan = plan_step([AxisMove("x", 0, distance, velocity, acceleration)])
    return plan.stretch_to(plan.duration_s * factor).profiles["x"]


def test_the_worked_example() -> None:
    """15,000 steps in 3 s with 10 Hz/ms and 200 Hz are 6200 Hz: ramps of 0.6 s, 1.8 s between them."""
    shape = fit_trapezoid(15_000, 3.0, 10_000.0, PpSmcBounds(20_000, 10_000.0, 200, 200))
    assert shape == PpSmcTrapezoid(15_000, 200, 6200, 10, 10)
    assert shape is not None and shape.duration_s == pytest.approx(3.0, abs=1e-9)
    assert [leg.duration_s for leg in shape.motion_legs] == pytest.approx([0.6, 1.8, 0.6])


@pytest.mark.parametrize("shape", [PpSmcTrapezoid(5000, 100, 3000, 7, 11), PpSmcTrapezoid(200, 100, 3000, 7, 11)])
def test_legs_add_up_to_distance_and_duration(shape: PpSmcTrapezoid) -> None:
    way = sum(leg.duration_s * (leg.speed + leg.duration_s * leg.acceleration / 2) for leg in shape.motion_legs)
    assert way == pytest.approx(shape.distance)
    assert sum(leg.duration_s for leg in shape.motion_legs) == pytest.approx(shape.duration_s)


def test_random_moves_keep_their_limits_and_where_ramps_reach_their_duration() -> None:
    draw, worst, reached = Random(1), 0.0, 0
    for _ in range(400):
        velocity, acceleration = 10 ** draw.uniform(2, 5), 10 ** draw.uniform(3.5, 6)
        distance = round(10 ** draw.uniform(1.7, 5.5))
        limits = PpSmcBounds(velocity, acceleration, draw.randint(1, 20), draw.randint(20, 1000))
        quickest = fit_trapezoid(distance, 0.001, acceleration, limits)
        assert quickest is not None
        duration_s = quickest.duration_s * draw.uniform(1.02, 3)
        shape = fit_trapezoid(distance, duration_s, acceleration / 2, limits)
        assert shape is not None
        assert limits.start_min <= shape.s <= max(limits.start_min, limits.start_max)
        assert shape.f <= velocity and max(shape.a, shape.d) * 1000 <= acceleration * (1 + 1e-6)
        # A duration that is impossible to a millisecond is answered with the next longer one.
        assert shape.duration_s >= duration_s - 0.001 - 1e-9
        if (distance / duration_s) ** 2 > 1000 * duration_s and limits.start_max > 500 and acceleration < 3e5:
            reached += 1
            worst = max(worst, abs(shape.duration_s - duration_s))
    assert reached > 30 and worst < 1e-3


def test_an_answer_that_is_planned_again_is_kept() -> None:
    """30 steps/s for 40 s: whole Hz are 1.3 s apart; all members wait for the next longer one."""
    profile = planned(1234, 30.9, 5000.0)
    first = lowered(profile, start_rate={"min": 0.001, "max": 2})
    longer_s = first.durations_s["x"]
    assert profile.duration_s < longer_s < profile.duration_s * 1.05
    again = lowered(profile.stretch_time(longer_s / profile.duration_s), start_rate={"min": 0.001, "max": 2})
    assert again.durations_s["x"] == pytest.approx(longer_s, abs=1e-3)


def test_slow_axes_of_one_controller_propose_a_common_duration() -> None:
    draw, alike = Random(2), 0
    config = controller("xy", axis={"start_rate": {"min": 0.001, "max": 2}})
    for _ in range(20):
        moves = [AxisMove(name, 0, draw.randrange(300, 900), 110.0, 5000.0) for name in "xy"]
        plan = plan_step(moves)
        profiles = plan.stretch_to(draw.uniform(8.2, 12.0)).profiles
        answered = lower_step(
            config, PpSmcOptions(), ConnectionTraits(0, 2, KNOWN), profiles, StartOptions()
        ).durations_s
        assert min(answered.values()) > profiles["x"].duration_s - 0.0011
        if max(answered.values()) - min(answered.values()) <= 0.001:
            alike += 1
            factor = max(1.0, max(answered.values()) / profiles["x"].duration_s)
            again = lower_step(
                config,
                PpSmcOptions(),
                ConnectionTraits(0, 2, KNOWN),
                {n: p.stretch_time(factor) for n, p in profiles.items()},
                StartOptions(),
            )
            assert all(abs(s - max(answered.values())) < 2e-3 for s in again.durations_s.values())
    assert alike >= 10


@pytest.mark.parametrize("ppm", [-300.0, 0.0, 250.0])
def test_the_rate_of_the_crystal_is_compensated(ppm: float) -> None:
    profile = planned(100_000, 20_000.0, 100_000.0, 1.2)
    result = lowered(profile, PpSmcOptions(rate_ppm=ppm))
    (move,) = result.moves
    assert move.shape is not None
    assert result.durations_s["x"] == pytest.approx(profile.duration_s, abs=1e-4)
    assert move.shape.duration_s == pytest.approx(result.durations_s["x"] * (1 + ppm * 1e-6), abs=1e-12)


def test_commands_sent_and_their_deviation_from_the_plan() -> None:
    profile = planned(-39_900, 20_000.0, 100_000.0, 1.2)
    result = lowered(profile)
    assert result.commands[0].startswith("frun1:") and result.commands[-1] == "tbg"
    (move,) = result.moves
    assert move.shape is not None
    worst = 0.0
    for k in range(2000):
        t = at_s = k / 2000 * profile.duration_s
        x = 0.0
        for leg in move.shape.motion_legs:
            step = min(t, leg.duration_s)
            x += step * (leg.speed + step * leg.acceleration / 2)
            t -= step
        worst = max(worst, abs(-x - profile.state_at(at_s).position))
    assert worst <= result.path_error_counts["x"] < worst + 1.5


def test_refusals_name_axis_and_what_would_fit() -> None:
    with pytest.raises(Refusal, match=r"axis x: 3 steps .* too slow") as caught:
        lowered(planned(3, 20_000.0, 100_000.0, 10_000))
    assert caught.value.code == "too-slow" and "start_rate" in caught.value.remedy
    jerky = Profile(0, 1000, 1000.0, [0.1] * 4, [0.0, 1.0, -1.0, 0.0], [10.0, -10.0, -10.0, 10.0])
    with pytest.raises(Refusal, match="jerk"):
        lowered(jerky)
    far = Profile(0, 2**23, 2.0**23, [100.0, 100.0], [1e-4, -1e-4], [0.0, 0.0])
    with pytest.raises(Refusal) as beyond:
        lowered(far)
    assert beyond.value.code == "too-far"


def test_an_axis_gentler_than_the_slowest_ramp_runs_at_a_start_speed() -> None:
    limits = {"velocity": 5, "acceleration": 0.5}
    result = lowered(planned(3000, 400.0, 400.0), limits=limits, homing={}, start_rate={"min": 0.1, "max": 2})
    (move,) = result.moves
    assert move.shape is not None and move.shape.s == move.shape.f


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"axis": {"motors": ["17"]}}, "motors"),
        ({"axis": {"motors": ["X"]}}, "motors"),
        ({"axis": {"homing": {"method": "mark"}}}, "switch, slowdown"),
        ({"axis": {"homing": {"method": "ref", "direction": "positive"}}}, "direction"),
        ({"axis": {"start_rate": {"min": 60, "max": 70}}}, "start_rate"),
        ({"axis": {"limits": {"velocity": 1e-6, "acceleration": 1}, "homing": {}}}, "velocity"),
        ({"inputs": {"a": {"number": 1}}}, "io_port"),
        ({"outputs": {"a": {"number": 9}}, "options": {"io_port": True}}, "bits 0 to 7"),
        ({"options": {"loop": {"q": "open"}}}, "loop"),
        ({"options": {"encoders": ["q"]}}, "encoders"),
        ({"link": {"kind": "udp", "host": "h", "port": 1}}, "udp"),
    ],
    ids=str,
)
def test_the_fleet_file_is_checked(change: dict[str, Any], said: str) -> None:
    MAKE.check_config(controller())
    config = controller("x").to_plain()
    for key, value in change.items():
        if key == "axis":
            config["axes"]["x"].update(value)
        else:
            config[key] = value
    with pytest.raises(ValueError, match=said):
        MAKE.check_config(type(controller()).model_validate(config))


def test_options_refuse_unknown_fields() -> None:
    with pytest.raises(ValidationError):
        MAKE.options_model.model_validate({"wheels": 4})


@pytest.mark.parametrize("gear", ["1", "10000/3", "400", "0.5", "123.4"])
def test_positions_as_text_give_the_exact_step(gear: str) -> None:
    from fractions import Fraction

    draw, exact = Random(3), Fraction(gear)
    for _ in range(300):
        steps = draw.randrange(-(2**23), 2**23)
        text = fleetaxes.format_position(steps, exact)
        assert fleetaxes.parse_steps(text, exact) == steps and len(text) < 20


@pytest.mark.parametrize(
    ("form", "yes", "no"),
    [
        (STATUS, ["1:131;", "1:129;2:0;16:16384;"], ["1:131", "1:1.5;", "131;", ""]),
        (POSITIONS, ["1:1.234;", "1:1.234deg;2:osc;", "1:-.5;", "1:0;"], ["1:;", "1:1.2", "abc"]),
        (ERRORS, ["1:0", "1:1500 limit switch error"], ["1:131;", "error"]),
        (TARGETS, ["1:r0;2:a1.5;", "1:r0.00;2:r-1.5"], ["1:x;", "r0"]),
        (SETTINGS, ["# configuration settings of axis 1", "ffast1:1000", "unit1 : mm"], ["1:0", "ffast:1"]),
        (PROGRAM, ["in0.1", "1:a5.0s1r2a3d4"], ["1000001", "0"]),
    ],
)
def test_forms_distinguish_replies(form: Any, yes: list[str], no: list[str]) -> None:
    assert all(form.matches_text(text) for text in yes)
    assert not any(form.matches_text(text) for text in no)
    assert leading_number("1.234deg") == "1.234" and leading_number("-.5") == "-.5" and leading_number("osc") is None
