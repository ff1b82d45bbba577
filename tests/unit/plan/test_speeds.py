"""Speeds of moves as people say them: fractions, speeds along a line, those of an axis, and the manual one."""

from typing import Any

import pytest

from orchestrator.model.fleet import Fleet
from orchestrator.model.script import WrongValue
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.speed import describe_speed
from orchestrator.plan.shape import PlanError
from orchestrator.plan.speeds import plan_motion
from orchestrator.plan.step import AxisMove, StepPlan


def make_axis(unit: str, scale: int, velocity: float, **fields: Any) -> dict[str, Any]:
    limits = {"velocity": velocity, "acceleration": 1000 * velocity}
    return {"motors": ["X"], "unit": unit, "scale": scale, "limits": limits, **fields}


FLEET = Fleet.model_validate(
    {
        "schema": "tutti.fleet/1",
        "fleet": "f",
        "controllers": {
            "a": {
                "adapter": "smc4000",
                "link": {"kind": "tcp", "host": "127.0.0.1", "port": 1},
                "axes": {
                    "x": make_axis("mm", 1000, 100.0),
                    "y": make_axis("mm", 2000, 50.0, motors=["Y"], manual_speed="10 %"),
                    "r": make_axis("deg", 100, 90.0, motors=["Z"]),
                },
            }
        },
    }
)


def plan(speed: Any, **distances: float) -> StepPlan:
    """The plan of relative moves from 0, in units."""
    moves: list[AxisMove] = []
    for name, distance in distances.items():
        axis = FLEET.axis(f"a.{name}")
        scale = float(axis.counts_per_unit)
        limits = axis.limits
        moves.append(
            AxisMove(f"a.{name}", 0, round(distance * scale), limits.velocity * scale, limits.acceleration * scale)
        )
    step = Move(by={f"a.{name}": distance for name, distance in distances.items()}, speed=speed)
    return plan_motion(FLEET, step, moves)


@pytest.mark.parametrize(
    ("speed", "distances", "seconds"),
    [
        (0.5, {"x": 100}, 2.0),
        ("50 %", {"x": 100}, 2.0),
        ("5 mm/s", {"x": 100}, 20.0),
        ("300 mm/min", {"x": 100}, 20.0),
        ("0.5 cm/s", {"x": 100}, 20.0),
        ({"a.x": "5 mm/s"}, {"x": 100, "y": 10}, 20.0),
        ({"a.x": "5 mm/s"}, {"x": 10, "y": 200}, 4.0),
        ({"a.x": "10 %"}, {"x": 100, "r": 9}, 10.0),
        ("10 mm/s", {"x": 30, "y": 40}, 5.0),
        ("10 mm/s", {"x": 30, "y": 0}, 3.0),
        ("manual", {"x": 100}, 5.0),
        ("manual", {"x": 1, "y": 50}, 10.0),
    ],
)
def test_a_move_takes_the_time_of_its_speed(speed: Any, distances: dict[str, float], seconds: float) -> None:
    assert plan(speed, **distances).duration_s == pytest.approx(seconds, rel=2e-3)


def test_a_speed_may_name_an_axis_that_stands_at_its_target() -> None:
    scale = float(FLEET.axis("a.x").counts_per_unit)
    moves = [AxisMove("a.x", 0, round(10 * scale), 100 * scale, 1e5 * scale)]
    step = Move(to={"a.x": 10, "a.y": 5}, speed={"a.x": "5 mm/s", "a.y": "20 mm/s"})
    assert plan_motion(FLEET, step, moves).duration_s == pytest.approx(2, rel=2e-3)


@pytest.mark.parametrize(
    ("speed", "distances", "text"),
    [
        ("200 mm/s", {"x": 10}, "speed 200 mm/s: a.x would move at 200 mm/s; its limit is 100"),
        ("80 mm/s", {"x": 30, "y": 40}, "a.y would move at 64 mm/s; its limit is 50"),
        ("5 mm/s", {"x": 10, "r": 10}, "name the axis whose speed it is: {a.x: 5 mm/s}"),
        ({"a.q": "5 mm/s"}, {"x": 10}, "speed names a.q, which the step does not move"),
        ("5 deg/s", {"x": 10}, "speed of a.x: "),
    ],
)
def test_a_speed_that_cannot_be_kept_is_refused_with_its_place(
    speed: Any, distances: dict[str, float], text: str
) -> None:
    with pytest.raises(PlanError) as refused:
        plan(speed, **distances)
    assert text in str(refused.value)


@pytest.mark.parametrize(
    ("speed", "text"),
    [
        (5, 'a fraction of the limits, above 0 to 1; with a unit it is a speed: "5 mm/s"'),
        (0, "above 0 to 1"),
        ("fast", "speed is 'fast'; write e.g. 0.5"),
        ("-5 mm/s", "a speed is above 0"),
        ("120 %", "above 0 to 1"),
        ({}, "speed names no axis"),
        ({"a.x": "quick"}, "speed of a.x is 'quick'"),
        (True, "speed is True"),
        ("5 mm", "'5 mm' has no unit per time; write e.g. \"5 mm/s\""),
        ("5 kg/s", "unknown unit 'kg'"),
    ],
)
def test_other_speeds_are_refused_when_they_are_read(speed: Any, text: str) -> None:
    with pytest.raises(WrongValue) as refused:
        Move(by={"a.x": 1}, speed=speed)
    assert text in str(refused.value)


def test_a_speed_is_described_with_its_unit() -> None:
    assert [describe_speed(speed) for speed in (0.5, 1.0, "5 mm/s", {"a.x": 0.125, "a.y": "5 mm/s"})] == [
        "50 %",
        "100 %",
        "5 mm/s",
        "a.x=12.5 % a.y=5 mm/s",
    ]
    assert Move(by={"a.x": 1}, speed="5 mm/s").describe() == "move by a.x=1, speed=5 mm/s"
    assert Move.model_validate(Move(by={"a.x": 1}, speed="50 %").to_plain()).speed == 0.5
