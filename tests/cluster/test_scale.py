"""The work of a fleet does not grow faster than its controllers, and at rest there is next to none."""

from orchestrator.bench.scale import ScaleRow, measure_scale

HEARTBEATS = 10  # of the leader, a second: each host receives them, whatever it carries


def test_counts_of_few_and_many_controllers() -> None:
    few, many = measure_scale([5, 20], 1, lambda _: None, learning=1)
    for row in (few, many):
        assert row.declared <= 8
        assert row.rest_messages <= HEARTBEATS + 4 and row.rest_wakes <= HEARTBEATS + 6
        assert row.rest_size <= 500
        assert (row.rest_writes, row.rest_tasks) == (0, 0)
        assert row.step_writes <= 4
        assert row.skew_us < 10
        assert row.estop_ms < 25
    assert_grows_no_faster(few, many, "rest_size", "step_tasks")


def test_a_step_whose_lead_is_learned_takes_no_more_bytes_of_many() -> None:
    """Before that the lead grows with the number, and states of armed controllers are in the frames meanwhile."""
    few, many = measure_scale([5, 20], 1, lambda _: None, learning=16)
    assert_grows_no_faster(few, many, "step_size", "start_ms")


def assert_grows_no_faster(few: ScaleRow, many: ScaleRow, *fields: str) -> None:
    for field in fields:
        assert getattr(many, field) <= 1.1 * getattr(few, field), field
