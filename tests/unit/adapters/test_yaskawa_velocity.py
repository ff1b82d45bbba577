"""The velocity of a Yaskawa axis: the controller's is an average, which shows motion after the end of a move."""

import pytest

from adapters.yaskawa.wire.record import MOTOR_OFF, MOVING, AxisRecord


@pytest.mark.parametrize(
    ("status", "counts_s"),
    [(0, 0.0), (MOVING, 500.0), (MOTOR_OFF, 500.0), (MOTOR_OFF | MOVING, 500.0)],
)
def test_an_axis_that_is_held_at_rest_has_no_velocity(status: int, counts_s: float) -> None:
    axis = AxisRecord(
        status=status,
        switches=0,
        stop_code=0,
        commanded=0,
        actual=0,
        error=0,
        auxiliary=0,
        velocity=64 * 500,
        torque=0,
    )
    assert axis.velocity_counts_s == counts_s
