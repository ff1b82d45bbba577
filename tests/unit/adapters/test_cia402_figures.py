"""Requirements of the lowering for CiA 402 drives, and of a bus of them, in a few moves each."""

import pytest

from benches.makes.can.bus import bench_can
from benches.makes.can.stream import bench_stream
from benches.makes.lowering_steppers import bench_stepper


@pytest.mark.parametrize("moves", [3, pytest.param(300, marks=pytest.mark.nightly)])
def test_lowered_moves_take_the_planned_time_and_are_executed_as_predicted(moves: int) -> None:
    found = bench_stepper("cia402", moves, 11)
    asked = [each for each in found.figures if each.asked]
    assert asked
    assert all(each.met for each in asked), asked


@pytest.mark.nightly
def test_eight_drives_start_together_and_are_armed_hardly_slower_than_their_frames() -> None:
    rows = bench_can(8)
    asked = [row for row in rows if row.asked]
    assert [row.what for row in asked] == ["start skew, one SYNC", "arming compared with its frames"]
    assert all(row.met for row in asked), asked
    # One after another they are much further apart, so that the figure is significant.
    assert rows[0].p50 > 10 * rows[1].p99


@pytest.mark.nightly
def test_eight_drives_keep_to_their_paths_and_leave_room_on_the_bus() -> None:
    rows = bench_stream(1, 0)
    asked = [row for row in rows if row.asked and row.n]
    assert len(asked) == 2
    assert all(row.met for row in asked), asked
    # By the timer of a loop they are further from their plan.
    off = {row.what: row.p50 for row in rows if row.what.startswith("furthest")}
    assert off["furthest from the plan, by a script's timer"] > 5 * off["furthest from the plan, streamed"]
