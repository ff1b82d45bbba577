"""Probes of several axes on a line, ahead: speeds, ramps, and what stops them."""

from typing import Any

import pytest

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.state import StepCosts
from orchestrator.model.steps.probe import Probe, find_line_ramps
from orchestrator.plan.probes import ProbeAbilities, find_most_speeds, find_probe_speeds
from orchestrator.runtime.simulated_fleets import make_smc4000

WAYS = {"gantry.x": 3.0, "gantry.y": -4.0}

COSTS = StepCosts(arm_ns=1, disarm_ns=1, stop_ns=1)


def make_probe(speed: Any, axes: tuple[str, ...] = ("gantry.x", "gantry.y")) -> Probe:
    return Probe(to=dict.fromkeys(axes, 1), until="gantry.touch", speed=speed)


def make_fleet() -> Fleet:
    config = make_smc4000(0)
    limits = {"velocity": 50, "acceleration": 100}
    x = {**config["axes"]["x"], "limits": limits, "homing": {"speed": 10}}
    turning = {**x, "unit": "deg", "motors": ["Z"]}
    axes = {"x": x, "y": {**x, "motors": ["Y"], "limits": {**limits, "velocity": 20}}, "turn": turning}
    controller = {**config, "axes": axes, "inputs": {"touch": {"number": 5, "active": "low"}}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "f", "controllers": {"gantry": controller}})


def list_axes(step: Probe) -> dict[str, Axis]:
    return {name: make_fleet().axis(name) for name in step.axes}


@pytest.mark.parametrize(
    ("speed", "x", "y"),
    [
        ("10 mm/s", 6.0, 8.0),  # along the line
        (0.5, 7.5, 10.0),  # y is the slowest of both
        ({"gantry.x": "3 mm/s"}, 3.0, 4.0),
        ({"gantry.x": 1.0, "gantry.y": "8 mm/s"}, 6.0, 8.0),
    ],
)
def test_axes_of_a_line_go_their_ways_in_one_time(speed: Any, x: float, y: float) -> None:
    step = make_probe(speed)
    axes = list_axes(step)
    speeds = find_probe_speeds(step, axes, WAYS)
    assert speeds == pytest.approx({"gantry.x": x, "gantry.y": y})
    most = find_most_speeds(step, axes)
    assert all(speeds[name] <= most[name] * (1 + 1e-9) for name in axes)
    ramps = find_line_ramps(axes, speeds)
    assert ramps == pytest.approx({"gantry.x": 75.0, "gantry.y": 100.0})


@pytest.mark.parametrize(
    ("speed", "axes", "code", "words"),
    [
        ("26 mm/s", ("gantry.x", "gantry.y"), "velocity-limit", "gantry.y would move at 20.8 mm/s; its limit is 20"),
        ("1 mm/s", ("gantry.x", "gantry.turn"), "bad-unit", "the axes have different units"),
        ({"gantry.x": "1 deg/s"}, ("gantry.x", "gantry.y"), "bad-unit", "speed of gantry.x"),
    ],
)
def test_a_speed_that_a_line_cannot_have_is_refused(speed: Any, axes: tuple[str, ...], code: str, words: str) -> None:
    step = make_probe(speed, axes)
    with pytest.raises(Refusal, match=words) as raised:
        find_probe_speeds(step, list_axes(step), dict(zip(axes, (3.0, -4.0), strict=True)))
    assert raised.value.code == code


def test_a_make_that_stops_no_lines_is_named() -> None:
    step = make_probe("1 mm/s")
    abilities = ProbeAbilities("shrc203", COSTS, None, None, None, None, shows_inputs=False)
    with pytest.raises(Refusal, match="the make shrc203 cannot stop several axes on a line") as raised:
        abilities.require_ability(make_fleet(), step, "gantry.x")
    assert raised.value.remedy == "let the coordinator stop them (`by: host`), which has a longer overtravel"
    with pytest.raises(ValueError, match="speed names gantry"):
        make_probe({"gantry.z": 0.5})
