"""Pairs of axes: what a fleet file may say, how far a fault takes them apart, and how readings are compared."""

from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.operation.pair_reach import FaultReach, floor_speed
from orchestrator.model.operation.pair_state import AxisReading, bring_together

BEAM = Path(__file__).parents[3] / "deploy" / "examples" / "beam.fleet.yaml"
MS = 1_000_000


@pytest.mark.parametrize("room", [0.05, 0.8, 40.0])
def test_the_highest_speed_that_fits_comes_apart_by_just_the_room(room: float) -> None:
    reach = FaultReach(ramp=50.0, alone_s=1.4)
    speed = reach.find_speed(room)
    assert reach.find_growth(speed) == pytest.approx(room)
    assert reach.find_growth(speed, way=room / 2) == room / 2
    # A watchdog that is faster than the detection does not help against the other faults.
    assert FaultReach(50.0, 0.3).find_growth(2.0) == 2.0 * 1.0 + 2.0**2 / 100
    assert room * 0.9 < speed * 1.4 + speed**2 / 100 and floor_speed(speed) <= speed


def test_without_a_watchdog_only_the_way_bounds_it() -> None:
    reach = FaultReach(ramp=50.0, alone_s=None)
    assert reach.find_growth(0.001, way=3.0) == 3.0 and reach.find_speed(1.0) == 0


def test_readings_of_two_instants_are_compared_at_the_later_one() -> None:
    """Both move at 10/s; the second was read 20 ms after the first, each within 1 ms."""
    first = AxisReading(5.0, 10.0, 0, MS, 50.0)
    second = AxisReading(-5.2, -10.0, 20 * MS, 21 * MS, 50.0)
    apart, error = bring_together([first, second])
    assert apart == pytest.approx(0.0)
    assert error == pytest.approx(10.0 * 0.001 + 50 * 0.021**2 / 2)
    at_rest = bring_together([first._replace(velocity=0.0), second._replace(velocity=0.0)])
    assert at_rest == (pytest.approx(-0.2), 0.0)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({"pair": {"max_deviation": "2 mm", "may_rack": "1 mm"}}, "must be above 0 and below may_rack"),
        ({"pair": {"max_deviation": "0.2 mm", "may_rack": "1 mm", "square": "0.3 mm"}}, "mount the switches nearer"),
        ({"pair": {"max_deviation": "0.2 deg", "may_rack": "1 mm"}}, "deg"),
        ({"pair": {"max_deviation": 0.2}}, "may_rack"),
        ({"of": ["gantry.y"]}, "a pair has two real axes|2 virtual axes of 1 real"),
        ({"axes": {"y": {"unit": "mm"}, "skew": {"unit": "um"}}}, "give both one unit"),
        ({"axes": {"y": {"unit": "deg"}}}, "deg"),
        ({"offset": {"y": 1}}, "has no `offset`"),
        ({"kind": "slit"}, "`kind: slit`"),
    ],
)
def test_a_wrong_pair_is_refused_with_what_is_wrong(fields: dict[str, Any], words: str) -> None:
    plain = load_fleet(BEAM).to_plain()
    beam = {"of": ["gantry.y", "lift.y"], "pair": plain["virtual"]["beam"]["pair"], "axes": {"y": {"unit": "mm"}}}
    plain["virtual"] = {"beam": {**beam, **fields}}
    with pytest.raises(ValidationError, match=words):
        Fleet.model_validate(plain)


@pytest.mark.parametrize(
    ("of", "words"),
    [
        (["gantry.y"], "gantry.y is one of the pair beam"),
        (["beam.y", "beam.rack"], "beam is a pair, which moves by its own axes"),
    ],
)
def test_no_other_group_has_an_axis_of_a_pair(of: list[str], words: str) -> None:
    plain = load_fleet(BEAM).to_plain()
    names = ["a", "b"][: len(of)]
    matrix = {name: [int(name == column) for column in names] for name in names}
    plain["virtual"]["more"] = {"of": of, "matrix": matrix, "axes": {name: {"unit": "mm"} for name in names}}
    with pytest.raises(ValidationError, match=words):
        Fleet.model_validate(plain)


def test_the_second_axis_may_have_another_name() -> None:
    plain = load_fleet(BEAM).to_plain()
    plain["virtual"]["beam"]["axes"] = {"y": {"unit": "mm"}, "skew": {"unit": "mm"}}
    fleet = Fleet.model_validate(plain)
    assert fleet.virtual_axes.pairs["beam"].rack == "beam.skew" and "beam.skew" in fleet.names.virtual
