"""Scans that fly: windows by truth, rows by evidence, on SMC-4000 and CiA 402 in virtual time."""

from typing import Any

import pytest
from cluster.test_contour import PREPARE, two_gantries
from cluster.worlds import EXAMPLES, job, origin_host_ns, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

RASTER = (
    "{do: scan, axes: {gantry.x: {from: 50, to: 51, points: 3},"
    " gantry.y: {from: 20, to: 30, points: 21, snake: true}}, fly: {duration: 20 ms}}"
)


def test_a_raster_is_flown_line_by_line() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, PREPARE, job(f"[{RASTER}]"))
        print(report)
        assert report.state == "done", report.reason
        rows = await fleet.make_client().load_points(report.job_id)
        for r in rows[:3] + rows[-3:]:
            print(r)

    run_fleet(main, two_gantries())
