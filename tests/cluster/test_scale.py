"""The work of a fleet does not grow faster than its controllers."""

from orchestrator.bench.scale import ScaleRow, measure_scale


def test_counts_of_few_and_many_controllers() -> None:
    few, many = measure_scale([5, 20], 1, lambda _: None, learning=1)
    for row in (few, many):
        assert (row.rest_writes, row.rest_tasks) == (0, 0)
        assert row.step_writes <= 4
        assert row.skew_us < 10
        assert row.estop_ms < 25
    assert_grows_no_faster(few, many, "rest_size", "step_size", "step_tasks")


def assert_grows_no_faster(few: ScaleRow, many: ScaleRow, *fields: str) -> None:
    for field in fields:
        assert getattr(many, field) <= 1.1 * getattr(few, field), field
