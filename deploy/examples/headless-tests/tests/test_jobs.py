"""What the jobs do."""

import pytest


def test_load_brings_the_stage_to_the_door_and_lights_the_lamp(fleet, load):
    fleet.tutti.run(load)
    assert fleet.truth("gantry.y").position_at(fleet.now_s) == pytest.approx(250, abs=0.01)
    assert fleet.truth("stage.u").position_at(fleet.now_s) == pytest.approx(40, abs=0.001)
    assert fleet.tutti.status()["gantry"].outputs["lamp"]


def test_scan_covers_its_lines_at_their_speed(fleet, scan):
    report = fleet.tutti.run(scan)
    lines = [step for step in report.steps if step.name.startswith("line")]
    assert len(lines) == 3
    x, y = fleet.truth("gantry.x"), fleet.truth("gantry.y")
    moves = [move for move in x.moves if abs(move.to_position - move.from_position) == pytest.approx(100, abs=0.01)]
    assert [round(move.to_position) for move in moves] == [150, 50, 150]
    assert [round(y.position_at(move.start_s)) for move in moves] == [50, 60, 70]
    for move in moves:
        middle = (move.start_s + move.end_s) / 2
        speed = abs(x.position_at(middle + 0.1) - x.position_at(middle - 0.1)) / 0.2
        assert speed == pytest.approx(50, rel=0.01)


def test_scan_starts_its_axes_together(fleet, scan):
    report = fleet.tutti.run(scan)
    for step in report.steps:
        if step.do == "move":
            assert step.verdict == "green", step.deviations
    first = report.steps[1].t0_fleet_ns / 1e9
    starts = []
    for axis in ("gantry.x", "gantry.y", "stage.u"):
        starts += [move.start_s for move in fleet.truth(axis).moves if abs(move.start_s - first) < 0.1]
    assert len(starts) == 3 and max(starts) - min(starts) < 0.005


def test_scan_takes_less_than_twenty_seconds(fleet, scan):
    begun_s = fleet.now_s
    fleet.tutti.run(scan)
    assert fleet.now_s - begun_s < 20


@pytest.mark.parametrize("seed", range(3))
def test_a_day_of_work_ends_parked(virtual_fleet, request, day, seed):
    """Equal seeds give equal runs; other seeds other delays of links, firmware and processes."""
    fleet = virtual_fleet(request.config.rootpath / "lab.fleet.yaml", seed=seed)
    fleet.tutti.enable("gantry", "stage")
    fleet.tutti.home()
    for job in day:
        fleet.tutti.run(job)
    axes = fleet.tutti.axes()
    assert not any(axis.enabled for axis in axes.values())
    assert all(axis.position == pytest.approx(0, abs=0.01) for axis in axes.values())


def test_jobs_wait_for_each_other_in_the_queue(fleet, load, scan):
    first, second = fleet.tutti.submit(load), fleet.tutti.submit(scan)
    ends = [first.result().transitions[-1].fleet_ns, second.result().transitions[-1].fleet_ns]
    assert ends == sorted(ends)
