"""Profiles of constant jerk for a path: near to it, within its limits, and lowered although an axis comes back."""

import numpy as np
import pytest

from adapters.cia402.shapes.course import SetpointTrajectory
from adapters.yaskawa.shapes.contour import ContourLimits, axis_increments, fit_contour
from adapters.yaskawa.shapes.model import SMC4000
from orchestrator.model.profile import Profile
from orchestrator.plan.path_profiles import FIT_SHARE, Array, FittedAxis, FittedPath, PathStates, fit_profiles
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove, plan_step

RADIUS, COUNTS = 50.0, 1000.0  # mm, counts/mm
TICK_NS = 976_562.5


def plan_circle(turns: float) -> Profile:
    """The length along a circle in time, in 1e-6 mm."""
    way = round(2 * np.pi * RADIUS * turns * 1e6)
    return plan_step([AxisMove("s", 0, way, 100e6, 400e6, 4000e6, 3)]).profiles["s"]


def evaluate_circle(along: Profile, times_s: Array) -> PathStates:
    at = along.make_evaluator()
    s, v, a = np.array([at(t) for t in times_s.tolist()]).T / 1e6
    angle = s / RADIUS
    cos, sin = np.cos(angle), np.sin(angle)
    radial, tangent = np.stack([cos, sin], 1), np.stack([-sin, cos], 1)
    return PathStates(
        RADIUS * (radial - [1.0, 0.0]), tangent * v[:, None], tangent * a[:, None] - radial * (v**2 / RADIUS)[:, None]
    )


def fit_circle(turns: float, tolerance: float, acceleration: float = 500.0) -> FittedPath:
    along = plan_circle(turns)
    axes = [FittedAxis(name, COUNTS, 100.0, acceleration, 0, 0) for name in "xy"]
    return fit_profiles(lambda times_s: evaluate_circle(along, times_s), along.duration_s, axes, tolerance)


@pytest.mark.parametrize("tolerance", [0.001, 0.01, 0.1, 1.0])
def test_profiles_stay_within_their_share_of_the_tolerance(tolerance: float) -> None:
    along, fitted = plan_circle(2), fit_circle(2, tolerance)
    assert fitted.error <= max(FIT_SHARE * tolerance, 0.05 / COUNTS) * 1.001
    times_s = np.linspace(0.0, along.duration_s, 4001)
    true = evaluate_circle(along, times_s).positions
    evaluators = [fitted.profiles[name].make_evaluator() for name in "xy"]
    made = np.array([[at(t).position / COUNTS for at in evaluators] for t in times_s.tolist()])
    assert np.linalg.norm(made - true, axis=1).max() <= fitted.error * 1.05
    for profile in fitted.profiles.values():
        assert max(profile.end_error) < 1e-3
        assert profile.peak_velocity <= 100.0 * COUNTS * (1 + 1e-9)
        assert profile.peak_acceleration <= 500.0 * COUNTS * (1 + 1e-9)


def test_a_looser_tolerance_needs_fewer_pieces() -> None:
    counts = [len(fit_circle(3, tolerance).profiles["x"].durations_s) for tolerance in (0.005, 0.1, 2.0)]
    assert counts[0] > counts[1] > counts[2]


def test_a_plan_beyond_the_limits_is_refused_by_the_axis() -> None:
    with pytest.raises(PlanError, match=r"[xy]: the path exceeds its limits"):
        fit_circle(1, 0.1, acceleration=150.0)


def test_an_axis_that_a_path_does_not_move_has_no_profile() -> None:
    along = plan_circle(1)

    def evaluate(times_s: Array) -> PathStates:
        states = evaluate_circle(along, times_s)
        return PathStates(*(np.stack([part[:, 1], 0 * part[:, 0]], 1) for part in states))

    fitted = fit_profiles(evaluate, along.duration_s, [FittedAxis(n, COUNTS, 100.0, 500.0, 7, 7) for n in "xy"], 0.1)
    assert list(fitted.profiles) == ["x"] and list(fitted.standing) == ["y"]


def test_a_closed_profile_is_lowered_to_a_contour_and_to_a_stream() -> None:
    profiles = dict(fit_circle(1, 0.01).profiles)
    contour = fit_contour(profiles, TICK_NS, ContourLimits(7000, 3, 10.0), SMC4000)
    for axis, profile in profiles.items():
        assert not profile.is_still and not profile.stays_between_ends
        at, position = profile.make_evaluator(), 0
        steps = axis_increments(profile, contour.ends[axis], contour, 0.0, TICK_NS)
        for end, step in zip(contour.record_ends, steps, strict=True):
            position += step
            assert abs(position - at(end * TICK_NS * 1e-9).position) <= 1.0
        assert position == 0
        course = SetpointTrajectory(profile, 10_000_000)
        setpoint = course.setpoint_function()
        off = [abs(setpoint(k) - at((k + 1) * 0.01).position) for k in range(course.point_count)]
        assert max(off) <= course.path_error_counts
