"""Scans and repeats on the virtual demo fleet: order of points, aggregated reports, recorded points, re-runs, kills."""

import asyncio
from pathlib import Path

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.bus.base import BusSample
from orchestrator.model.errors import Refusal
from orchestrator.model.files import FileError
from orchestrator.model.report import JobProgress
from orchestrator.runtime.virtual import VirtualFleet

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
            assert each.measured == pytest.approx(each.target, abs=0.001)
        levels = [level for _, level in edges]
        assert levels == [True, False] * 12
        widths_ns = [off[0] - on[0] for on, off in zip(edges[::2], edges[1::2], strict=True)]
        assert all(10_000_000 <= each < 15_000_000 for each in widths_ns), widths_ns
        within = [(each.scan_step, each.point, each.points) for each in seen if each.point is not None]
        assert (1, 7, 12) in within
        # Of the scan only the first point is in the history.
        assert len(report.transitions) < 30

    run_fleet(main)
