"""Scans that fly and wait armed before their first line."""

import pytest
from cluster.test_armed_waiting import ended, is_moving, set_door, submit_armed, wait_for_state
from cluster.test_flying_scans import prepare, raster
from cluster.worlds import job, outcome, run_fleet

from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import PointRecord
from orchestrator.runtime.virtual.fleet import VirtualFleet

POINTS = 63


def armed_raster(terms: str = "", axis: str = "gantry.y", duration: str = "20 ms") -> Job:
    return job(f"[{{do: wait_armed{terms}}}, {raster(axis, f'{{duration: {duration}}}')}]")


async def list_rows(fleet: VirtualFleet, job_id: str) -> list[PointRecord]:
    return [row async for row in fleet.make_client().iterate_points(job_id)]


def test_a_scan_waits_at_the_begin_of_its_first_line_and_flies_on_go() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        submitted = await submit_armed(fleet, armed_raster())
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert not is_moving(fleet) and not await list_rows(fleet, submitted.id)
        t0_ns = await submitted.go()
        report = await ended(submitted)
        assert report.state == "done", report.reason
        rows = await list_rows(fleet, submitted.id)
        assert len(rows) == POINTS and all(row.good for row in rows)
        first_window = rows[0].window
        assert first_window is not None and first_window.lower.earliest_ns > t0_ns
        waited = [step.waited_armed for step in report.steps if step.waited_armed is not None]
        assert [wait.by for wait in waited] == ["request"]

    run_fleet(main)


def test_a_scan_that_is_flown_line_by_line_waits_before_its_first_line_only() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        submitted = await submit_armed(fleet, armed_raster(axis="stage.u", duration="60 ms"))
        await submitted.go()
        assert (await ended(submitted)).state == "done"
        assert len(await list_rows(fleet, submitted.id)) == POINTS

    run_fleet(main)


def test_an_input_starts_a_scan() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        submitted = await submit_armed(fleet, armed_raster(", input: gantry.door"))
        await set_door(fleet, active=True)
        assert (await ended(submitted)).state == "done"
        assert len(await list_rows(fleet, submitted.id)) == POINTS

    run_fleet(main)


def test_a_wait_that_ends_flies_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        submitted = await submit_armed(fleet, armed_raster(", timeout: 5 s"))
        report = await ended(submitted)
        assert report.state == "failed" and "5 s" in report.reason
        assert not any(row.state == "done" for row in await list_rows(fleet, submitted.id))

    run_fleet(main)


def test_a_scan_that_is_paused_while_it_waits_waits_anew_and_one_that_is_paused_on_its_way_does_not() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet))
        submitted = await submit_armed(fleet, armed_raster())
        await submitted.pause(now=True)
        await wait_for_state(fleet, submitted, "paused")
        await submitted.resume()
        await wait_for_state(fleet, submitted, "armed")
        await submitted.go()
        await sleep_ns(fleet.clock, NS_PER_S // 10)
        await submitted.pause(now=True)
        await wait_for_state(fleet, submitted, "paused")
        assert 0 < len(await list_rows(fleet, submitted.id)) < POINTS // 3  # still in the first line
        await submitted.resume()
        assert (await ended(submitted)).state == "done"
        assert len(await list_rows(fleet, submitted.id)) == POINTS

    run_fleet(main)


@pytest.mark.parametrize(
    ("steps", "said"),
    [
        ("{do: scan, axes: {gantry.x: {from: 1, to: 2, points: 3}}}", "a scan that flies"),
        (raster("gantry.y", "{duration: 20 ms, wait: {input: gantry.door, timeout: 1 s}}"), "fly.wait"),
    ],
)
def test_a_scan_that_cannot_wait_armed_is_refused(steps: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        job(f"[{{do: wait_armed}}, {steps}]")
