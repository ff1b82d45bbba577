"""What the watch says of a rule by what is seen of its axes."""

from pathlib import Path

import pytest

from orchestrator.model.jobs.files import load_fleet
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.watch import AxisSight, RuleSight, find_closing_speed, look_at_rule

ZONES = FleetZones(load_fleet(Path(__file__).parents[4] / "deploy" / "examples" / "zones.fleet.yaml"))
CONSTRAINTS = {rule.name: rule.constraint for rule in ZONES.rules}
REST = {axis: AxisSight(0.0, moving=False) for axis in ZONES.ranges}


def look(rule: str, *, trust_step: bool = False, **sights: AxisSight) -> RuleSight:
    seen = {**REST, **{name.replace("_", "."): sight for name, sight in sights.items()}}
    return look_at_rule(CONSTRAINTS[rule], seen, ZONES.ranges, trust_step=trust_step)


def test_bodies_are_free_by_what_they_are_farther_apart_than_they_must_be() -> None:
    """After homing detector and sample are 160 mm apart, and must be 5; balls around them show less."""
    sight = look("detector-sample", gantry_x=AxisSight(100.0, moving=True))
    assert sight.danger is None and 0 < sight.free <= 55
    near = look("detector-sample", gantry_x=AxisSight(154.0, moving=True))
    assert near.danger is None and near.free == pytest.approx(1.0, abs=0.01)


def test_what_was_checked_is_in_danger_only_where_a_rule_is_broken() -> None:
    assert look("detector-sample", gantry_x=AxisSight(154.9, moving=True, reach=40)).danger is None
    danger = look("detector-sample", gantry_x=AxisSight(155.5, moving=True, reach=40)).danger
    assert danger is not None and danger.broken and danger.moving == ("gantry.x",)
    resting = look("detector-sample", gantry_x=AxisSight(155.5, moving=False)).danger
    assert resting is not None and resting.broken and resting.moving == ()


def test_axes_that_are_trusted_to_keep_step_are_in_danger_only_by_more_than_they_drift() -> None:
    """They were read at different instants."""
    near, nearer = (AxisSight(position, moving=True, drift=1.0) for position in (156.5, 157.5))
    stage = AxisSight(0.0, moving=True, drift=1.0)
    assert look("detector-sample", gantry_x=near, stage_u=stage).danger is not None
    assert look("detector-sample", trust_step=True, gantry_x=near, stage_u=stage).danger is None
    assert look("detector-sample", trust_step=True, gantry_x=nearer, stage_u=stage).danger is not None
    assert look("detector-sample", trust_step=True, gantry_x=near).danger is not None  # the other one stands


def test_what_was_not_checked_is_in_danger_where_it_may_come_before_it_stands() -> None:
    assert look("detector-sample", gantry_x=AxisSight(110.0, moving=True, unchecked=True, reach=40)).danger is None
    danger = look("detector-sample", gantry_x=AxisSight(120.0, moving=True, unchecked=True, reach=40)).danger
    assert danger is not None and not danger.broken
    assert danger.text.startswith("gantry.x may come 40 farther before it stands; then detector and sample are ")


def test_a_lost_axis_may_be_anywhere_while_others_move() -> None:
    lost = AxisSight(None, moving=False, unchecked=True, cause="offline")
    away = look("detector-sample", gantry_x=AxisSight(50.0, moving=True, reach=20), stage_phi=lost)
    assert away.danger is None and away.free == 0
    danger = look("detector-sample", gantry_x=AxisSight(150.0, moving=True, reach=20), stage_phi=lost).danger
    assert danger is not None and "stage.phi (offline) may be anywhere in its range" in danger.text
    assert look("detector-sample", gantry_x=AxisSight(150.0, moving=False), stage_phi=lost).danger is None


def test_relations_are_watched_too() -> None:
    turned = AxisSight(50.0, moving=True)
    danger = look("low-detector", stage_phi=turned).danger
    assert danger is not None and danger.broken and "gantry.z < 10 mm forbids stage.phi > 45 deg" in danger.text
    assert look("low-detector", stage_phi=turned, gantry_z=AxisSight(60.0, moving=False)).danger is None
    falling = AxisSight(20.0, moving=True, unchecked=True, reach=15)
    assert look("low-detector", stage_phi=AxisSight(50.0, moving=False), gantry_z=falling).danger is not None


def test_no_closing_speed_is_below_that_of_the_axes() -> None:
    speeds = dict.fromkeys(ZONES.ranges, 10.0)
    assert find_closing_speed(CONSTRAINTS["detector-carriage"], ZONES.ranges, speeds) == pytest.approx(30.0)
    assert find_closing_speed(CONSTRAINTS["detector-sample"], ZONES.ranges, speeds) > 30.0  # stage.phi turns the arm
    assert find_closing_speed(CONSTRAINTS["low-detector"], ZONES.ranges, speeds) == float("inf")
