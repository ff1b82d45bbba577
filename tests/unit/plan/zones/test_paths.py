"""Paths and motions that follow each other: clear after any single stop, at any speed that users may ask for."""

import random
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction

import pytest
from unit.plan.zones.test_steps import ALONE, ALONE_S, DETECTOR_SAMPLE, FLEET, REST, ZONES, plan

from orchestrator.model.profile import Profile
from orchestrator.model.steps.path import FollowPath
from orchestrator.plan.path_clock import MOST_RATE
from orchestrator.plan.path_step import PathStart, PlannedPath, plan_path_step
from orchestrator.plan.zones.clearance import PairClearance
from orchestrator.plan.zones.course import Course, Sweep, Timing
from orchestrator.plan.zones.extents import ProfileExtents
from orchestrator.plan.zones.paths import bound_alone, find_path_terms
from orchestrator.plan.zones.search import find_rule_violation

GANTRY = ("gantry.x", "gantry.z")


def plan_path(points: Sequence[tuple[float, float]], speed: str = "80 mm/s", tolerance: str = "100 um") -> PlannedPath:
    """A path of lines of both axes of the gantry."""
    pieces = [{"piece": "line", "to": list(point)} for point in points[1:]]
    step = FollowPath(axes=list(GANTRY), start=list(points[0]), tolerance=tolerance, speed=speed, pieces=pieces)
    starts = [
        PathStart(name, axis, Fraction(value), axis.to_counts(Fraction(value)), Fraction(0), 3)
        for name, value in zip(GANTRY, points[0], strict=True)
        for axis in [FLEET.axis(name)]
    ]
    return plan_path_step(step, starts)


def make_course(path: PlannedPath, alone: Mapping[str, float | None] = ALONE, **more: float) -> Course:
    standing = {**REST, **{name: float(path.exact[name][0]) for name in path.plan.unmoved}}
    positions = {name: (value, value) for name, value in standing.items() if name not in path.plan.profiles}
    sweep = Sweep(path.plan.profiles, positions, Timing(alone), paths=find_path_terms(path))
    return ZONES.make_course(replace(sweep, **more))  # pyright: ignore[reportArgumentType]


def test_extents_of_many_segments_are_those_of_dense_samples() -> None:
    draw = random.Random(1)
    path = plan_path([(draw.uniform(0, 300), draw.uniform(0, 100)) for _ in range(12)])
    profile = path.plan.profiles["gantry.z"]
    extents, state_at = ProfileExtents(profile), profile.make_evaluator()
    assert len(profile.segments) > 100
    for _ in range(40):
        begin_s, end_s = sorted(draw.uniform(0, profile.duration_s) for _ in range(2))
        states = [state_at(begin_s + (end_s - begin_s) * number / 1000) for number in range(1001)]
        low, high = extents.find_range(begin_s, end_s)
        slowest, fastest = extents.find_speeds(begin_s, end_s)
        assert low - 1e-6 <= min(state.position for state in states) <= low + 60
        assert high - 60 <= max(state.position for state in states) <= high + 1e-6
        assert all(slowest - 1e-6 <= state.velocity <= fastest + 1e-6 for state in states)


def find_run_on(profile: Profile, axis: str, path_s: float, rate: float) -> float:
    """Where an axis comes to rest that leaves its path at an instant by its ramp, at `rate` of the planned speed."""
    state = profile.state_at(path_s)
    speed = state.velocity * rate
    way = speed * abs(speed) / (2 * FLEET.axis(axis).limits.acceleration * abs(float(FLEET.axis(axis).scale)))
    return FLEET.axis(axis).to_unit(profile.start_counts + state.position + way)


def test_a_path_that_is_clear_is_clear_after_every_single_stop_at_every_speed() -> None:
    """One axis stops, at once or by its ramp; the other goes on along the path for its stop time, and brakes."""
    draw, clear = random.Random(571), 0
    assert isinstance(DETECTOR_SAMPLE.constraint, PairClearance)
    for _ in range(40):
        begin = draw.uniform(0, 40), draw.uniform(0, 60)
        points = [begin, *((draw.uniform(60, 330), draw.uniform(0, 80)) for _ in range(3))]
        path = plan_path(points)
        if find_rule_violation(DETECTOR_SAMPLE, make_course(path)) is not None:
            continue
        clear += 1
        profiles, duration_s = path.plan.profiles, path.plan.duration_s
        for _ in range(40):
            rate, stopped_s = draw.uniform(0.1, MOST_RATE), draw.uniform(0, duration_s)
            first, second = draw.sample(GANTRY, 2)
            going_s = min(stopped_s + rate * draw.choice([0.0, ALONE_S, draw.uniform(0, ALONE_S)]), duration_s)
            stands = draw.random() < 0.5
            positions = dict(REST)
            positions[first] = find_run_on(profiles[first], first, stopped_s, 0.0 if stands else rate)
            positions[second] = find_run_on(profiles[second], second, going_s, rate)
            assert DETECTOR_SAMPLE.constraint.find_distance(positions)[1] >= 5.0 - 1e-4, (points, stopped_s, rate)
    assert 8 < clear < 36


def test_a_short_dip_between_far_points_is_found() -> None:
    """Of a path of many pieces one comes too near, for a moment."""
    points = [(0.0, 100.0), *((200.0 + 40 * (number % 2), 100.0) for number in range(40))]
    assert find_rule_violation(DETECTOR_SAMPLE, make_course(plan_path(points))) is None
    points[20:20] = [(200.0, 14.0), (200.0, 100.0)]
    course = make_course(plan_path(points))
    violation = find_rule_violation(DETECTOR_SAMPLE, course)
    assert violation is not None and violation.positions is not None
    assert violation.positions["gantry.z"] < 16
    assert find_rule_violation(DETECTOR_SAMPLE, make_course(plan_path(points), begin_s=violation.instant_s + 4)) is None


def test_a_higher_speed_and_an_earlier_begin_of_the_ramp_need_more_room() -> None:
    """It turns before the arm: at 155 mm the bodies are 5 mm apart, and half a millimetre is not certain."""
    near = plan_path([(0.0, 0.0), (154.3, 0.0), (0.0, 0.0)])
    assert find_rule_violation(DETECTOR_SAMPLE, make_course(near)) is not None
    slow = plan_path([(0.0, 0.0), (154.3, 0.0), (0.0, 0.0)], "4 mm/s")
    assert find_rule_violation(DETECTOR_SAMPLE, make_course(slow)) is None


def test_a_controller_that_has_two_chunks_of_a_path_goes_on_for_no_longer() -> None:
    alone = {"gantry": None, "stage": 1.2}
    assert bound_alone(alone, {"gantry": 5.0, "other": 1.0}) == {"gantry": 10.0, "stage": 1.2}
    assert bound_alone(alone, {"stage": 5.0}) == {"gantry": None, "stage": 1.2}


def test_what_follows_without_a_rest_counts_with_a_stop_shortly_before() -> None:
    """An axis that stops at the end of a step, while another one begins the next step already."""
    up = plan({"gantry.z": (0.0, 60.0)})
    assert find_rule_violation(DETECTOR_SAMPLE, from_rest := over({})) is None
    still = {name: (value, value) for name, value in REST.items() if name != "gantry.z"}
    recent = ZONES.make_course(Sweep(up.profiles, still, Timing(ALONE))).find_recent()
    low, high = recent["gantry.z"]
    assert low < 10 and high > 59.9  # it takes hardly longer than the other one may go on
    violation = find_rule_violation(DETECTOR_SAMPLE, over(recent))
    assert violation is not None and violation.instant_s == 0.0
    assert from_rest.find_recent()["gantry.x"][0] < 150
    # After a step that is longer than anything goes on, where axes were before it does not matter.
    assert "gantry.z" not in over(recent).stretch(4.0).find_recent()


def over(recent: Mapping[str, tuple[float, float]]) -> Course:
    """The detector goes over the sample, behind a step that ends as it begins."""
    positions = {"gantry.z": (60.0, 60.0), "stage.u": (0.0, 0.0), "stage.phi": (0.0, 0.0)}
    profiles = plan({"gantry.x": (110.0, 230.0)}).profiles
    return ZONES.make_course(Sweep(profiles, positions, Timing(ALONE), recent=recent))


@pytest.mark.parametrize(("begin", "alone_s", "clear"), [(60.0, 1.2, True), (90.0, 1.2, False), (90.0, 0.1, True)])
def test_how_long_and_how_fast_the_other_axis_goes_on_counts(begin: float, alone_s: float, clear: bool) -> None:
    """It rises beside the arm, and goes over it. If it stops rising, x goes on for 1.2 s (1 s at least), 20 % faster
    than planned, and then by its ramp."""
    path = plan_path([(begin, 0.0), (begin + 20, 60.0), (300.0, 60.0)])
    course = make_course(path, {"gantry": alone_s})
    assert (find_rule_violation(DETECTOR_SAMPLE, course) is None) == clear
