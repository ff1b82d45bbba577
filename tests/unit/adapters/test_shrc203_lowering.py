"""Lowering for the SHRC-203: durations, limits, path errors, refusals; nothing here touches a controller."""

from random import Random
from typing import Any

import pytest
from pydantic import ValidationError

from adapters.shrc203 import MAKE, fleetaxes
from adapters.shrc203.costs import step_costs
from adapters.shrc203.lowering import ConnectionTraits, ShrcLowered, lower_step
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.shapes.trapezoid import ShrcBounds, ShrcTrapezoid, fit_trapezoid
from adapters.shrc203.wire.replies import STATUS, parse_status
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step


def controller(**axis: Any) -> Controller:
    one = {"motors": ["1"], "unit": "mm", "scale": 10_000, "limits": {"velocity": 20, "acceleration": 100}, **axis}
    return Controller.model_validate(
        {"adapter": "shrc203", "link": {"kind": "serial", "device": "/dev/ttyUSB0"}, "axes": {"x": one}}
    )


def wire(options: ShrcOptions, char_ns: int) -> ConnectionTraits:
    return ConnectionTraits(
        char_ns,
        True,
        step_costs(options, char_ns),
        step_costs(options, char_ns, line=True),
        options.unread_clock().estimate_at(0),
    )


def lowered(config: Controller, profile: Profile) -> ShrcLowered:
    options = ShrcOptions()
    return lower_step(config, options, wire(options, 260_000), {"x": profile}, StartOptions())


def test_the_worked_example() -> None:
    """10,000 pulses in 2 s with ramps of 250 ms: D/F + R (1 - S/F) = 2 s."""
    shape = fit_trapezoid(10_000, 2.0, 0.25, ShrcBounds(1e6, 1e6, 1, 100))
    assert shape is not None
    assert shape.r == 250 and shape.duration_s == pytest.approx(2.0, abs=1e-6)
    assert ShrcTrapezoid(1000, 100, 1000, 50).duration_s == pytest.approx(1.045)


def test_random_moves_keep_their_duration_and_limits() -> None:
    draw, worst = Random(1), 0.0
    for _ in range(400):
        velocity, acceleration = draw.uniform(5_000, 400_000), draw.uniform(20_000, 2_000_000)
        distance = round(10 ** draw.uniform(3.3, 6))
        plan = plan_step([AxisMove("x", 0, distance, velocity, acceleration)])
        profile = plan.stretch_to(plan.duration_s * draw.uniform(1.02, 2)).profiles["x"]
        limits = ShrcBounds(velocity, acceleration, 1, max(1, round(velocity / 100)))
        shape = fit_trapezoid(distance, profile.duration_s, profile.durations_s[0], limits)
        assert shape is not None
        assert shape.peak_speed <= velocity and shape.acceleration <= acceleration * (1 + 1e-6)
        error_s = abs(shape.duration_s - profile.duration_s)
        if profile.durations_s[0] <= 1.0:
            worst = max(worst, error_s)
    assert worst < 1e-4


def test_a_plan_at_its_limits_is_answered_with_its_duration() -> None:
    config = controller()
    profile = plan_step([AxisMove("x", 0, 123_457, 200_000.0, 1_000_000.0)]).profiles["x"]
    first = lowered(config, profile)
    longer = first.durations_s["x"]
    assert profile.duration_s <= longer * (1 + 1e-6) and longer < profile.duration_s * 1.01
    again = lowered(config, profile.stretch_time(max(1.0, longer / profile.duration_s)))
    assert again.durations_s["x"] == pytest.approx(longer, abs=1e-4)


def test_commands_sent_and_their_deviation_from_the_plan() -> None:
    profile = plan_step([AxisMove("x", 100, -39_900, 50_000.0, 400_000.0)]).profiles["x"].stretch_time(1.2)
    result = lowered(controller(), profile)
    load, start = result.commands
    assert load.startswith("MP:1-P40000,S") and start == "G:1"
    assert 1.0 <= result.path_error_counts["x"] < 400
    (move,) = result.moves
    assert move.shape is not None
    worst, at_s, legs = 0.0, 0.0, move.shape.motion_legs
    for k in range(2000):
        t = at_s = k / 2000 * profile.duration_s
        x = 0.0
        for leg in legs:
            step = min(t, leg.duration_s)
            x += step * (leg.speed + step * leg.acceleration / 2)
            t -= step
        worst = max(worst, abs(-x - profile.state_at(at_s).position))
    assert worst <= result.path_error_counts["x"] < worst + 1.5


def test_refusals_name_axis_and_what_would_fit() -> None:
    config = controller()
    slow = plan_step([AxisMove("x", 0, 3, 200_000.0, 1_000_000.0)]).profiles["x"].stretch_time(10_000)
    with pytest.raises(Refusal, match=r"axis x: 3 pulses .* too slow") as caught:
        lowered(config, slow)
    assert caught.value.code == "too-slow"
    jerky = Profile(0, 1000, 1000.0, [0.1] * 4, [0.0, 1.0, -1.0, 0.0], [10.0, -10.0, -10.0, 10.0])
    with pytest.raises(Refusal, match="jerk"):
        lowered(config, jerky)
    options = ShrcOptions()
    profile = plan_step([AxisMove("x", 0, 30_000, 200_000.0, 1_000_000.0)]).profiles["x"]
    with pytest.raises(Refusal, match="clock"):
        lower_step(config, options, wire(options, 0), {"x": profile}, StartOptions(start_class="clock"))


@pytest.mark.parametrize(
    ("axis", "said"),
    [
        ({"motors": ["X"]}, "motors"),
        ({"homing": {"method": "index"}}, "mark, mini"),
        ({"start_rate": {"min": 30, "max": 40}}, "start_rate"),
        ({"limits": {"velocity": 1e-6, "acceleration": 1}}, "velocity"),
    ],
)
def test_the_fleet_file_is_checked(axis: dict[str, Any], said: str) -> None:
    MAKE.check_config(controller())
    with pytest.raises(ValueError, match=said):
        MAKE.check_config(controller(**axis))


def test_options_refuse_unknown_fields() -> None:
    with pytest.raises(ValidationError):
        MAKE.options_model.model_validate({"wheels": 4})


def test_nm_per_pulse_follows_unit_and_scale() -> None:
    assert fleetaxes.expected_nm(controller().axes["x"], None) == pytest.approx(100)
    assert fleetaxes.expected_nm(controller(unit="deg", scale=400).axes["x"], None) is None


def test_a_guardian_stops_after_any_incomplete_input() -> None:
    assert MAKE.stop_bytes(controller()) == b"\r\nMP:1+P0\r\nL:W\r\nL:1\r\n"


@pytest.mark.parametrize(
    "reply", ["P0,P-12,P+7,1,4,1000002,R,B,D", "0,-12,7,1,4,1000002,R,B,D", "P0.00,P-12,P+7,1,4,1000002,R,B,D"]
)
def test_status_lines_in_either_number_form(reply: str) -> None:
    assert STATUS.matches_line(reply)
    found = parse_status(reply, (1, 2))
    assert (found[2].counts, found[2].word, found[2].is_busy) == (-12, 4, True) and 3 not in found


@pytest.mark.parametrize("garbled", ["P+1P+2,P+3,1,1,1,R,R,R", "P+1,P+2,P+3,1,1,R,R,R", "P+1,P+2,1,1,1,R,R", "P+1,R"])
def test_a_status_that_has_lost_a_comma_is_no_status(garbled: str) -> None:
    assert (
        STATUS.matches_line("P+1,P+2,P+3,1,1,1,R,R,R")
        and STATUS.matches_line("P+1,P-2,1,80001,R,B")
        and STATUS.matches_line("0,0,D")
    )
    assert not STATUS.matches_line(garbled)
