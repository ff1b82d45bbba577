"""The distance between what is executed and the plan, where both are known."""

import pytest

from adapters.toolkit.path_error import path_error_counts
from orchestrator.model.profile import Profile

TRIANGLE = Profile(0, 100, 100.0, (1.0, 0.0, 1.0), (1.0, 0.0, -1.0), (0.0, 0.0, 0.0))  # without a cruise
LEGS = [(1.0, 0.0, 100.0), (1.0, 100.0, -100.0)]


def test_a_path_executed_as_planned_is_off_by_one_count() -> None:
    assert path_error_counts(TRIANGLE, LEGS) == pytest.approx(1.0)
    assert path_error_counts(TRIANGLE, [LEGS[0], (0.0, 0.0, 0.0), LEGS[1]]) == pytest.approx(1.0)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_distance_may_lie_between_the_knots(sign: int) -> None:
    plan = Profile(7, 7 + sign * 100, sign * 100.0, (1.0, 0.0, 1.0), (1.0, 0.0, -1.0), (0.0, 0.0, 0.0))
    # At 50 counts/s from end to end: ahead of the parabola most where that has the same speed.
    assert path_error_counts(plan, [(2.0, 50.0, 0.0)]) == pytest.approx(1.0 + 12.5)
