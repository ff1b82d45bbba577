"""What happens when something goes wrong."""

import pytest

from tutti import JobFailed, Refusal


def test_an_open_door_stops_everything_and_nothing_begins(fleet, scan):
    begun_s = fleet.now_s
    fleet.set_input("gantry.door", on=True, at="2 s")
    with pytest.raises(JobFailed, match="door-closed"):
        fleet.tutti.run(scan)
    assert fleet.truth("gantry.x").moves[-1].end_s < begun_s + 2.5
    with pytest.raises(Refusal, match="door-closed"):
        fleet.tutti.move({"gantry.x": 1})
    fleet.set_input("gantry.door", on=False)
    fleet.advance("1 s")
    assert fleet.tutti.run(scan).state == "done"


def test_a_limit_switch_ends_the_scan_and_its_axis_is_named(fleet, scan):
    fleet.press_limit("gantry.x", "forward", at="3 s")
    with pytest.raises(JobFailed, match=r"gantry.* x .*limit"):
        fleet.tutti.run(scan)


def test_the_gantry_stops_when_the_stage_loses_power_and_the_work_goes_on_after_it(fleet, scan):
    fault = fleet.fail("stage", "power-off", at="1 s")
    with pytest.raises(JobFailed, match="stage"):
        fleet.tutti.run(scan)
    assert all(move.end_s is not None for move in fleet.truth("gantry.x").moves)
    fault.repair()
    fleet.advance("3 s")
    fleet.tutti.reset()
    fleet.tutti.enable("stage")
    fleet.tutti.home("stage")
    assert fleet.tutti.run(scan).state == "done"


def test_no_job_begins_by_itself_after_a_restart_of_the_coordinator(fleet, load, scan):
    running, waiting = fleet.tutti.submit(scan), fleet.tutti.submit(load)
    fleet.fail(None, "coordinator-killed", at="2 s", until="4 s")
    fleet.advance("10 s")
    assert running.result().state == "interrupted"
    moved = len(fleet.truth("gantry.x").moves)
    fleet.advance("60 s")
    assert len(fleet.truth("gantry.x").moves) == moved
    fleet.tutti.release_jobs(waiting.id)
    fleet.tutti.start_queue()
    assert waiting.result().state == "done"
