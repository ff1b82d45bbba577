"""Plans of the simulated CiA 402 drive: from any initial speed they are continuous, keep limits, and arrive."""

import math
from random import Random

import pytest

from sim.cia402.profile import MotionPlan, to_rest, to_speed, to_target


def check(plan: MotionPlan, speed: float, up: float, down: float) -> None:
    """Continuous from displacement 0 and `speed` on, with no acceleration beyond the larger one."""
    x, v, ends = 0.0, speed, [piece.t for piece in plan.segments[1:]]
    for piece, end in zip(plan.segments, [*ends, plan.duration_s], strict=True):
        assert (piece.x, piece.v) == (pytest.approx(x, abs=1e-6), pytest.approx(v, abs=1e-6))
        assert abs(piece.a) <= max(up, down) * (1 + 1e-9)
        if not math.isinf(end):
            x, v = piece.x_at(end), piece.v + piece.a * (end - piece.t)
    if not math.isinf(plan.duration_s):
        assert (x, v) == (pytest.approx(plan.distance, abs=1e-5), pytest.approx(0.0, abs=1e-5))


def test_plans_from_any_speed_arrive() -> None:
    draw = Random(402)
    reversals = overspeeds = 0
    for _ in range(3000):
        speed = draw.choice((0.0, draw.uniform(-3000, 3000)))
        distance = draw.choice((0.0, draw.uniform(-5000, 5000), draw.uniform(-5, 5)))
        most, up, down = draw.uniform(1, 2000), draw.uniform(100, 50_000), draw.uniform(100, 50_000)
        plan = to_target(speed, distance, most, up, down)
        assert plan.distance == distance
        check(plan, speed, up, down)
        speeds = [piece.v for piece in plan.segments]
        overspeeds += abs(speed) > most
        reversals += min(speeds) < -1e-6 and max(speeds) > 1e-6
        # Once it is within the limit it stays there.
        within = [abs(v) <= most * (1 + 1e-9) for v in speeds]
        assert sorted(within) == within
    assert reversals > 100
    assert overspeeds > 100


def test_a_plan_without_an_initial_speed_is_as_short_as_possible() -> None:
    plan = to_target(0.0, 100.0, 1e9, 1000.0, 500.0)
    peak = math.sqrt(2 * 100.0 * 1000.0 * 500.0 / 1500.0)
    assert plan.duration_s == pytest.approx(peak / 1000.0 + peak / 500.0)
    assert len(plan.segments) == 2


@pytest.mark.parametrize(("speed", "target"), [(0, 50), (100, 50), (50, 100), (100, -50), (-100, 0), (0, 0)])
def test_going_over_to_a_speed(speed: float, target: float) -> None:
    plan = to_speed(speed, target, 1000.0, 400.0)
    check(plan, speed, 1000.0, 400.0)
    assert plan.state_at(plan.reached_s + 1.0)[1] == target
    assert math.isinf(plan.duration_s) == (target != 0)
    through = speed * target < 0
    ramp_s = abs(target - speed) / (1000.0 if abs(target) > abs(speed) else 400.0)
    assert plan.reached_s == pytest.approx(abs(speed) / 400.0 + abs(target) / 1000.0 if through else ramp_s)


def test_coming_to_rest() -> None:
    plan = to_rest(-200.0, 1000.0)
    assert (plan.duration_s, plan.distance) == (pytest.approx(0.2), pytest.approx(-20.0))
