"""Axes of two motors in fleet files: which makes take them, and what these refuse."""

import pytest

from adapters.host.makes import find_controller_problems, known_makes
from orchestrator.model.fleet import Controller
from orchestrator.plan.racks import ROUNDED_DOWN
from orchestrator.runtime.example_fleet import load_example

GEARING_MAKES = {"smc4000"}


def make_controller(make: str, **changes: object) -> Controller:
    """The example of a make, with a second motor on its first axis."""
    plain = load_example(make).to_plain()
    axis = next(iter(plain["axes"].values()))
    taken_motors = {motor for entry in plain["axes"].values() for motor in entry["motors"]}
    second = next(motor for motor in (*"ZWYD", "2", "3", "4") if motor not in taken_motors)
    axis |= {"motors": [*axis["motors"], second], "max_deviation": 0.5, "homing": {}}
    axis |= {"start_rate": None, "kind": "linear", "wrap": None, "shortest_way": False}
    plain["axes"] = {"beam": axis}
    return Controller.model_validate(plain | changes)


@pytest.mark.parametrize("make", known_makes())
def test_a_make_that_cannot_gear_a_second_motor_refuses_it_by_name(make: str) -> None:
    texts = [problem.text for problem in find_controller_problems("it", make_controller(make))]
    refusals = [text for text in texts if "cannot gear motor" in text]
    if make in GEARING_MAKES:
        assert not texts
    else:
        assert len(refusals) == 1
        assert f"{make} cannot gear motor" in refusals[0]
        assert "make a pair of these axes under `virtual`" in refusals[0]


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"link": {"kind": "serial", "device": "/dev/ttyUSB0", "baud": 19200}}, "on a serial port two motors"),
        ({"options": {"round_trip_us": 9000}}, "a stop of the two motors of axis beam takes 38 ms; at most 20 fit"),
        ({"homing": {"method": "index"}}, "an axis of two motors is homed by its two home switches (edge)"),
        ({"limits": {"velocity": 9, "acceleration": 99, "jerk": 999}}, "an axis of two motors moves by trapezoids"),
        ({"motors": ["X", "A"]}, "A is another name for the motor of this axis"),
        ({"motors": ["X", "V"]}, "there is no motor 'V'"),
    ],
)
def test_what_the_smc4000_refuses_of_two_motors(changes: dict[str, object], expected: str) -> None:
    plain = make_controller("smc4000").to_plain()
    of_controller = {name: value for name, value in changes.items() if name in ("link", "options")}
    plain["axes"]["beam"] |= {name: value for name, value in changes.items() if name not in of_controller}
    problems = find_controller_problems("it", Controller.model_validate(plain | of_controller))
    assert any(expected in problem.text for problem in problems), problems


def test_the_highest_speed_is_the_one_at_which_the_bound_is_what_the_motors_may_rack() -> None:
    rack = make_controller("smc4000").axes["beam"].rack
    assert rack is not None
    assert (rack.watched, rack.most) == (0.5, 1.0)
    for ramp in (10.0, 1000.0, 1e6):
        assert rack.at_speed(rack.fastest(ramp), ramp) == pytest.approx(1.0)
        assert float(f"{ROUNDED_DOWN * rack.fastest(ramp):.3g}") <= rack.fastest(ramp)
