"""Bodies on axes of a fleet file: where they are, by units, virtual axes, other bodies, and what they cannot ride on."""

import pickle
from pathlib import Path
from typing import Any

import pytest
from pydantic import ValidationError

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.plan.zones.clearance import PairClearance
from orchestrator.plan.zones.course import Sweep, Timing
from orchestrator.plan.zones.observation import observe_zones
from orchestrator.plan.zones.rules import FleetZones

EXAMPLES = Path(__file__).parents[4] / "deploy" / "examples"
WALL = {"box": [1, 1000, 1000], "at": [100.5, 0, 0]}


def make_zones(fleet: str, *carriers: dict[str, Any], at: tuple[float, float, float] = (0, 0, 0)) -> FleetZones:
    """A ball of 1 mm on carriers, and a wall whose face is at x = 100."""
    plain = load_fleet(EXAMPLES / fleet).to_plain()
    plain["zones"] = {
        "bodies": {"ball": {"sphere": 1, "at": list(at), "on": list(carriers)}, "wall": WALL},
        "rules": {"wall": {"apart": {"bodies": ["ball", "wall"]}}},
    }
    return FleetZones(Fleet.model_validate(plain))


def find_distance(zones: FleetZones, **positions: float) -> float:
    constraint = zones.rules[0].constraint
    assert isinstance(constraint, PairClearance)
    named_positions = {name.replace("__", "."): position for name, position in positions.items()}
    return constraint.find_distance(named_positions)[1]


def test_a_body_rides_on_the_axis_in_its_direction() -> None:
    zones = make_zones("zones.fleet.yaml", {"axis": "gantry.x", "along": "-x"})
    assert find_distance(zones, gantry__x=10.0) == pytest.approx(99 + 10)
    slanted = make_zones("zones.fleet.yaml", {"axis": "gantry.x", "along": [3, 4, 0]})
    assert find_distance(slanted, gantry__x=10.0) == pytest.approx(99 - 6)


def test_a_body_turns_about_an_axis_that_moves() -> None:
    """By 90 degrees about z, a point 20 mm before the centre along y is 20 mm behind it along -x, and the reverse."""
    zones = make_zones(
        "zones.fleet.yaml",
        {"axis": "gantry.x", "along": "x"},
        {"axis": "stage.phi", "about": "z", "through": [5, 0, 0]},
        at=(5, 20, 0),
    )
    assert find_distance(zones, gantry__x=0.0, stage__phi=90.0) == pytest.approx(99 - 5 + 20)
    assert find_distance(zones, gantry__x=30.0, stage__phi=-90.0) == pytest.approx(99 - 5 - 30 - 20)


def test_a_body_rides_on_a_virtual_axis_by_its_real_ones() -> None:
    zones = make_zones("beam.fleet.yaml", {"axis": "beam.y", "along": "x"})
    axes = zones.rules[0].constraint.axes
    assert axes == load_fleet(EXAMPLES / "beam.fleet.yaml").virtual["beam"].of
    positions = dict(zip((axis.replace(".", "__") for axis in axes), (30.0, 31.0), strict=True))
    assert find_distance(zones, **positions) == pytest.approx(99 - 30.5)


def test_a_body_cannot_ride_on_a_corrected_axis() -> None:
    fleet = load_fleet(EXAMPLES / "stage.fleet.yaml")
    group = next(name for name, group in fleet.virtual.items() if group.kind == "corrected")
    axis = f"{group}.{fleet.virtual[group].order[0]}"
    with pytest.raises(ValidationError, match="curved or corrected; name its real axes"):
        make_zones("stage.fleet.yaml", {"axis": axis, "along": "x"})


def test_bodies_that_stand_still_are_compared_and_no_step_is_asked_for_them() -> None:
    zones = make_zones("zones.fleet.yaml", at=(99.5, 0, 0))
    assert zones.rules[0].constraint.axes == []
    assert [rule.constraint.look({}).holds for rule in zones.rules] == [False]
    assert zones.is_clear(zones.make_course(Sweep({}, {}, Timing({}))))


def test_rules_are_sent_to_other_processes() -> None:
    zones_fleet = load_fleet(EXAMPLES / "zones.fleet.yaml")
    zones = FleetZones(zones_fleet)
    positions = dict.fromkeys(zones.ranges, 0.0)
    sent_zones = pickle.loads(pickle.dumps(zones))
    readings = [observe_zones(zones_fleet, made, positions, {}) for made in (zones, sent_zones)]
    assert readings[0] == readings[1]
