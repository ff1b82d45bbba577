"""Scans and repeats on the virtual demo fleet: order of points, aggregated reports, recorded points, re-runs, kills."""

import asyncio
from pathlib import Path

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet, wait_for_point

from orchestrator.bus.base import BusSample
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.files import FileError
from orchestrator.model.report import JobProgress
from orchestrator.runtime.virtual.fleet import VirtualFleet

GRID = (
    "{do: scan, name: raster, axes: {gantry.x: {from: 0, to: 2, points: 3},"
    " stage.u: {from: 0, to: 0.9, points: 4, snake: true}},"
    " at_each: [{do: dwell, duration: 5 ms}, {do: output, output: gantry.lamp, value: true, pulse: 10 ms}]}"
)
SNAKE = [(x, u) for x in range(3) for u in ((0, 0.3, 0.6, 0.9) if x % 2 == 0 else (0.9, 0.6, 0.3, 0))]


def test_a_snake_scan_visits_its_points_in_order_and_pulses_at_each() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        seen: list[JobProgress] = []
        await outcome(fleet, PREPARE)
        edges: list[tuple[int, bool]] = []
        fleet.controllers["gantry"].on_output(lambda number, level: edges.append((fleet.clock.now_ns(), level)))
        job_id = await client.submit(job(f"[{{do: move, to: {{gantry.x: 0}}}}, {GRID}, {{do: dwell, duration: 1 ms}}]"))

        def look(sample: BusSample) -> None:
            seen.append(JobProgress.model_validate_json(sample.payload))

        await client.bus.subscribe(client.keys.job_state(job_id), look)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        assert [(step.index, step.do) for step in report.steps] == [(0, "move"), (1, "scan"), (37, "dwell")]
        scan = report.steps[1]
        assert scan.scan is not None and (scan.scan.points, scan.scan.done, scan.scan.steps_done) == (12, 12, 36)
        assert sum(scan.scan.verdicts.values()) == 12 and scan.verdict == "green"
        points = await client.load_points(job_id)
        assert [tuple(each.target.values()) for each in points] == SNAKE
        assert [each.point for each in points] == list(range(1, 13))
        for each in points:
            # An axis that leaves before its next reading has none.
            assert all(each.measured[axis] in (None, pytest.approx(at, abs=0.001)) for axis, at in each.target.items())
        levels = [level for _, level in edges]
        assert levels == [True, False] * 12
        widths_ns = [off[0] - on[0] for on, off in zip(edges[::2], edges[1::2], strict=True)]
        assert all(10_000_000 <= each < 15_000_000 for each in widths_ns), widths_ns
        within = [(each.scan_step, each.point, each.points) for each in seen if each.point is not None]
        assert (1, 7, 12) in within
        # Of the scan only the first point is in the history.
        assert len(report.transitions) < 30

    run_fleet(main)


def test_a_scan_is_paused_between_points_and_rerun_from_a_point() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        before = "{do: dwell, duration: 1 ms}"
        job_id = await client.submit(job(f"[{before}, {GRID}]"))
        await wait_for_point(fleet, job_id, 4)
        await client.pause_job(job_id)
        await _wait_for_state(fleet, job_id, "paused")
        shown = await client.show_job(job_id)
        assert "step 2, point 4 of 12" in shown.transitions[-1].reason
        await client.resume_job(job_id)
        await wait_for_point(fleet, job_id, 6)
        await client.cancel_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "cancelled"
        done = await client.load_points(job_id)
        assert [each.point for each in done if each.state == "done"][:5] == [1, 2, 3, 4, 5]
        scan = report.steps[1]
        assert scan.do == "scan" and scan.scan is not None and 5 <= scan.scan.done <= 6
        with pytest.raises(Refusal, match="has the points 1 to 12"):
            await client.retry_job(job_id, (1, 13))
        with pytest.raises(Refusal, match=r"step 1 .* is no scan"):
            await client.retry_job(job_id, (0, 1))
        again = await client.retry_job(job_id, (1, 7))
        assert again.steps == ["20 " + again.steps[0].partition(" ")[2]] and "12 points" in again.steps[0]
        repeated = await client.wait_for_job(again.job_id)
        assert repeated.state == "done" and repeated.from_step == 1 + 6 * 3
        assert [tuple(each.target.values()) for each in await client.load_points(again.job_id)] == SNAKE[6:]
        # It was never recorded as queued again, although it began inside a scan.
        states = [each.state for each in repeated.transitions]
        assert states[:2] == ["queued", "planning"] and states[-1] == "done"

    run_fleet(main)


async def _wait_for_state(fleet: VirtualFleet, job_id: str, state: str) -> None:
    client = fleet.make_client()
    async with asyncio.timeout(60):
        while (entry := (await client.show_job(job_id)).entry) is None or entry.state != state:
            await asyncio.sleep(0.02)


def test_a_coordinator_that_is_killed_in_a_scan_leaves_the_points_so_far() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        job_id = await client.submit(job(f"[{GRID}]"))
        await wait_for_point(fleet, job_id, 9)
        fleet.kill("coordinator/first")
        fleet.start_coordinator("second")
        report = await client.wait_for_job(job_id)
        assert report.state == "interrupted"
        points = [each.point for each in await client.load_points(job_id)]
        # Rows are written once a second, and with the last point.
        assert points == list(range(1, len(points) + 1)) and 1 <= len(points) <= 9

    run_fleet(main)


def write_points(path: Path, lines: list[str]) -> str:
    path.write_text("gantry.x,stage.u\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return f"{{do: scan, points: {{file: '{path}'}}}}"


def test_points_of_a_file_are_sent_once_and_run_in_their_order(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        step = write_points(tmp_path / "p.csv", ["0.1,0", "1 mm, 500 um", "", "0.3,0.25"])
        report = await outcome(fleet, job(f"[{step}]"))
        assert report.state == "done", report.reason
        points = await client.load_points(report.job_id)
        assert [each.target for each in points] == [
            {"gantry.x": 0.1, "stage.u": 0.0},
            {"gantry.x": 1.0, "stage.u": 0.5},
            {"gantry.x": 0.3, "stage.u": 0.25},
        ]
        # The last point is left by no further move.
        assert points[-1].measured == pytest.approx(points[-1].target, abs=0.001)
        stored = (await client.show_job(report.job_id)).job
        assert stored is not None and stored.steps[0].do == "scan"
        table = stored.steps[0].points
        assert table is not None and table.count == 3 and table.columns[0].most_at == 2
        used = fleet.journal.points.used_bytes
        assert used == 3 * 2 * 8
        again = await client.submit(job(f"[{step}]"))
        assert (await client.wait_for_job(again)).state == "done" and fleet.journal.points.used_bytes == used
        # With the last job that names them they are deleted.
        await client.prune_jobs(0, 0)
        assert fleet.journal.points.used_bytes == 0 and await client.load_points(report.job_id) == []

    run_fleet(main)


def test_bad_points_are_refused_before_anything_moves(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        beyond = write_points(tmp_path / "beyond.csv", ["0,0", "1,1", "401,2", "5,3"])
        with pytest.raises(Refusal, match=r"target 401 mm is beyond its soft limits -10 to 400 mm, at point 3 of 4"):
            await client.submit(job(f"[{beyond}]"))
        corner = "{do: scan, axes: {gantry.x: {from: 0, to: 10, points: 11}, stage.u: {from: 0, to: -1.5, points: 4}}}"
        with pytest.raises(Refusal, match=r"stage.u: target -1.5 mm .* at point 4 of 44 \(gantry.x 0, stage.u -1.5\)"):
            await client.submit(job(f"[{corner}]"))
        endless = write_points(tmp_path / "nan.csv", ["0,0", "nan,1", "3,inf"])
        with pytest.raises(FileError) as wrong:
            await client.submit(job(f"[{endless}]"))
        assert [(each.line, each.field, each.text) for each in wrong.value.problems] == [
            (3, "column 1 (gantry.x)", "found 'nan'; the number must be finite"),
            (4, "column 2 (stage.u)", "found 'inf'; the number must be finite"),
        ]
        moved = "{do: scan, axes: {gantry.x: {values: [0, 1]}}, at_each: [{do: move, by: {stage.v: 1}}]}"
        with pytest.raises(Refusal, match=r"steps\[0\].steps\[0\].at_each\[0\] \(move\): .* stage.v.* cover 52 mm"):
            await client.submit(job(f"[{{do: repeat, times: 40, steps: [{moved}]}}]"))
        fleet.journal.points.quota_bytes = 64
        many = write_points(tmp_path / "many.csv", ["0,0"] * 5)
        with pytest.raises(Refusal, match="the points need 80 B; 64 B of 64 B for points are in use") as full:
            await client.submit(job(f"[{many}]"))
        assert full.value.code == "point-store-full" and "tutti job prune" in full.value.remedy
        assert (await client.list_jobs()).jobs == []

    run_fleet(main)


def test_repeats_run_pass_by_pass_and_again_from_any_step() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        inner = "{do: repeat, times: 2, steps: [{do: move, by: {gantry.x: 1}}, {do: move, by: {stage.u: 0.2}}]}"
        whole = job(f"[{{do: move, to: {{gantry.x: 0, stage.u: 0}}}}, {{do: repeat, times: 3, steps: [{inner}]}}]")
        report = await outcome(fleet, PREPARE, whole)
        assert report.state == "done" and [step.index for step in report.steps] == list(range(13))
        assert fleet.controllers["gantry"].position("X") == 6_000 and fleet.controllers["stage"].position("1") == 12_000
        again = await client.retry_job(report.job_id, 6)
        assert again.warnings == ["step 7 moves stage.u by a distance, from the current position"]
        repeated = await client.wait_for_job(again.job_id)
        assert [step.index for step in repeated.steps] == list(range(6, 13))
        assert fleet.controllers["gantry"].position("X") == 9_000 and fleet.controllers["stage"].position("1") == 20_000

    run_fleet(main)


def test_a_scan_that_fails_at_a_point_says_which() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        at_each = "at_each: [{do: wait, input: gantry.door, timeout: 100 ms}, {do: dwell, duration: 50 ms}]"
        line = f"{{do: scan, axes: {{gantry.x: {{from: 0, to: 2, points: 9}}}}, {at_each}}}"
        client = fleet.make_client()
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        await asyncio.sleep(0.5)
        job_id = await client.submit(job(f"[{{do: dwell, duration: 1 ms}}, {line}]"))
        await wait_for_point(fleet, job_id, 4)
        await asyncio.sleep(0.2)
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=True))
        report = await client.wait_for_job(job_id)
        assert report.state == "failed"
        _, scan, failed = report.steps
        assert scan.scan is not None and scan.scan.done >= 3
        point = scan.scan.done + 1
        assert f"step 2 (scan), point {point} of 9 (wait): input gantry.door did not become active" in report.reason
        assert failed.do == "wait" and failed.refused is not None and failed.refused.code == "wait-timeout"
        points = await client.load_points(job_id)
        assert [each.state for each in points] == ["done"] * scan.scan.done + ["failed"]

    run_fleet(main)


def test_a_feed_hold_inside_a_scan_continues_to_the_same_point() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        job_id = await client.submit(job("[{do: scan, axes: {gantry.x: {values: [0, 300, 10]}}, speed: 0.3}]"))
        await wait_for_point(fleet, job_id, 2)
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].position > 100)
        await client.pause_job(job_id, now=True)
        await _wait_for_state(fleet, job_id, "paused")
        shown = await client.show_job(job_id)
        assert "in step 1, point 2 of 3" in shown.transitions[-1].reason
        assert shown.progress is not None and shown.progress.point == 2
        assert 100_000 < fleet.controllers["gantry"].position("X") < 300_000
        await client.resume_job(job_id)
        assert (await client.wait_for_job(job_id)).state == "done"
        points = await client.load_points(job_id)
        assert [each.target["gantry.x"] for each in points] == [0, 300, 10]
        # Positions that were read on the way are none of a point.
        assert all(each.measured["gantry.x"] in (None, each.target["gantry.x"]) for each in points)

    run_fleet(main)
