"""Plans: synchronised, inside limits, straight where a linear path is requested, exact at the ends."""

import random
from fractions import Fraction

import pytest

from orchestrator.plan import shape
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove, ExactTargets, plan_step


def random_moves(draw: random.Random, orders: tuple[int, ...] = (2, 3)) -> list[AxisMove]:
    return [
        AxisMove(
            axis=f"c.a{k}",
            start_counts=draw.randrange(-10_000, 10_000),
            target_counts=draw.randrange(-200_000, 200_000),
            velocity=draw.uniform(100, 200_000),
            acceleration=draw.uniform(1_000, 2_000_000),
            jerk=draw.choice([None, draw.uniform(1e5, 1e8)]),
            order=3 if draw.choice(orders) == 3 else 2,
        )
        for k in range(draw.randrange(1, 9))
    ]


@pytest.mark.parametrize("ramps", ["common", "own"])
@pytest.mark.parametrize("sync", ["time", "phase", "none"])
def test_random_steps_hold_their_limits_and_end_exactly(sync: str, ramps: str) -> None:
    draw = random.Random(11)
    for _ in range(300):
        moves = random_moves(draw)
        speed = draw.choice([1.0, 0.3])
        plan = plan_step(moves, sync, speed, ramps)  # type: ignore[arg-type]
        for move in moves:
            profile = plan.profiles[move.axis]
            assert profile.start_counts == move.start_counts
            assert profile.end_counts == move.target_counts
            assert profile.peak_velocity <= move.velocity * speed * (1 + 1e-6)
            assert profile.peak_acceleration <= move.acceleration * (1 + 1e-6)
            assert profile.state_at(profile.duration_s + 1).position == move.target_counts - move.start_counts
            distance = abs(move.target_counts - move.start_counts)
            just_before = profile.state_at(profile.duration_s * (1 - 1e-9)).position
            assert abs(just_before - (move.target_counts - move.start_counts)) <= 1e-5 * max(distance, 1)
            if sync != "none":
                assert profile.duration_s == pytest.approx(plan.duration_s, rel=1e-9)


def test_lines_are_straight() -> None:
    draw = random.Random(5)
    for _ in range(200):
        moves = random_moves(draw)
        plan = plan_step(moves, "phase")
        for k in range(1, 20):
            t = plan.duration_s * k / 20
            fractions = [plan.profiles[m.axis].state_at(t).position / (m.target_counts - m.start_counts) for m in moves]
            assert max(fractions) - min(fractions) < 1e-9


def test_common_ramps() -> None:
    """The slaved axis takes the leading axis's ramp instead of its own steepest one."""
    lead = AxisMove("c.lead", 0, 100_000, 50_000, 100_000)
    slave = AxisMove("c.slave", 0, 1_000, 50_000, 1_000_000)
    common = plan_step([lead, slave]).profiles["c.slave"]
    own = plan_step([lead, slave], ramps="own").profiles["c.slave"]
    assert common.durations_s[0] == pytest.approx(0.5)
    assert own.durations_s[0] < 0.001


def test_refusals_name_axis_and_reason() -> None:
    with pytest.raises(PlanError, match=r"c\.x: target 200 counts is outside its soft limits 0 to 100"):
        plan_step([AxisMove("c.x", 0, 200, 10, 10, soft_limits=(0, 100))])
    with pytest.raises(PlanError, match=r"c\.x: the move would take .* split it"):
        plan_step([AxisMove("c.x", 0, 100_000, 10, 10)])
    assert plan_step([AxisMove("c.x", 5, 5, 10, 10)]).profiles == {}
    # From outside its limits an axis may be led back inside.
    assert plan_step([AxisMove("c.x", 150, 50, 10, 10, soft_limits=(0, 100))]).profiles


def test_a_failing_solver_is_retried_and_then_skipped(monkeypatch: pytest.MonkeyPatch) -> None:
    moves = [AxisMove("c.x", 0, 1000, 100, 1000, 1e5, 3), AxisMove("c.y", 0, 500, 100, 1000, 1e5, 3)]
    honest = shape._run_ruckig
    asked: list[int] = []

    def only_alone(bounds, margin, *, synchronised):  # type: ignore[no-untyped-def]
        asked.append(len(bounds.distance))
        if len(bounds.distance) > 1:
            raise PlanError("made to fail")
        return honest(bounds, margin, synchronised=synchronised)

    monkeypatch.setattr(shape, "_run_ruckig", only_alone)
    plan = plan_step(moves)
    assert asked == [2, 2, 1, 1]
    assert plan.profiles["c.y"].duration_s == pytest.approx(plan.duration_s)

    monkeypatch.setattr(shape, "_run_ruckig", lambda *_, **__: (_ for _ in ()).throw(PlanError("never")))
    with pytest.raises(PlanError, match=r"c\.x: no motion found \(never"):
        plan_step(moves)


def test_no_waypoints_ever_reach_ruckig() -> None:
    plan_step([AxisMove("c.x", 0, 1000, 100, 1000, 1e5, 3)])
    assert list(shape.get_workspace(1)[2].intermediate_positions) == []


def test_a_thousand_relative_moves_there_and_back_end_on_the_same_count() -> None:
    targets, per_unit, counts = ExactTargets(), Fraction(10_000, 3), 17
    for sign in [1, -1] * 500:
        here = targets.exact_position("c.x", counts, Fraction(counts) / per_unit)
        target = here + sign * Fraction(1, 7)
        counts = round(target * per_unit)
        targets.record_target("c.x", target, counts)
    assert counts == 17
