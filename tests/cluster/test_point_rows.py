"""Rows of points while a job runs: each once and in order, begun late, with losses, over a change of the leader."""

import asyncio
from collections.abc import AsyncIterator, Callable
from itertools import pairwise
from typing import Any

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet, wait_for_point

from orchestrator.bus.base import Bus, BusSample
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.recording import JobPoints
from orchestrator.model.report import PointRecord
from orchestrator.runtime.virtual.fleet import VirtualFleet

GRID = (
    "{do: scan, axes: {gantry.x: {from: 0, to: 2, points: 3}, stage.u: {from: 0, to: 0.9, points: 4, snake: true}},"
    " at_each: [{do: dwell, duration: 5 ms}]}"
)
LINES = (
    "{do: scan, axes: {gantry.x: {from: 50, to: 51, points: 2}, gantry.y: {from: 20, to: 30, points: 21, snake: true}},"
    " fly: {duration: 20 ms}}"
)
DWELL = "{do: dwell, duration: 5 s}"


def place(row: PointRecord) -> tuple[int, int]:
    return row.step, row.point


async def follow(rows: AsyncIterator[PointRecord], note: Callable[[PointRecord], None]) -> list[PointRecord]:
    """All rows, in the order in which they come."""
    found: list[PointRecord] = []
    async for row in rows:
        found.append(row)
        note(row)
    return found


def ignore(_: PointRecord) -> None:
    return


def test_rows_come_while_the_job_runs_and_are_those_of_the_record() -> None:
    """Of scans of both kinds, also repeated ones; the last row of a scan does not wait for the end of the job."""
    steps = f"[{GRID}, {LINES}, {{do: repeat, times: 2, steps: [{GRID}]}}, {DWELL}]"

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        came_ns: list[int] = []
        submitted = await client.submit(job(steps))
        rows = await follow(submitted.follow_points(), lambda _: came_ns.append(fleet.clock.now_ns()))
        ended_ns = fleet.clock.now_ns()
        assert rows == await client.load_points(submitted) and len(rows) == 12 + 42 + 24
        assert [place(row) for row in rows] == sorted({place(row) for row in rows})
        # Also the last one came before the dwell behind it was over.
        assert ended_ns - came_ns[-1] > 3 * NS_PER_S
        # A row comes when the axes have reached the next point, those of a line together when it is over.
        assert len(set(came_ns[:12])) == 12 and len(set(came_ns[12:54])) == 2

    run_fleet(main)


def test_one_that_begins_late_gets_the_rows_before_and_one_scan_can_be_chosen() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        submitted = await client.submit(job(f"[{GRID}, {GRID}, {DWELL}]"))
        await wait_for_point(fleet, submitted, 8)
        first, second = await asyncio.gather(
            follow(client.follow_points(submitted), ignore), follow(client.follow_points(submitted, 24), ignore)
        )
        assert [place(row) for row in first] == [(step, point) for step in (0, 24) for point in range(1, 13)]
        assert second == first[12:]
        # Of a job that has ended all are there at once; the scan that is followed ends it.
        assert await follow(submitted.follow_points(0), ignore) == first[:12]
        with pytest.raises(Refusal, match="no job"):
            await follow(client.follow_points("none"), ignore)

    run_fleet(main)


class LossyBus:
    """A bus that loses every second message with points."""

    def __init__(self, bus: Bus, lost: list[JobPoints]) -> None:
        self._bus = bus
        self._lost = lost
        self._count = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._bus, name)

    async def subscribe(self, expression: str, callback: Callable[[BusSample], None]) -> Any:
        def receive(sample: BusSample) -> None:
            self._count += sample.key.endswith("/points")
            if sample.key.endswith("/points") and self._count % 2:
                self._lost.append(JobPoints.read_message(sample.payload))
            else:
                callback(sample)

        return await self._bus.subscribe(expression, receive)


def test_rows_that_were_missed_are_read_from_the_service() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        lost: list[JobPoints] = []
        bus: Any = LossyBus(fleet.make_client().bus, lost)
        client = Tutti(bus, fleet.fleet.fleet, "lossy", fleet.draw_id)
        submitted = await client.submit(job(f"[{GRID}]"))
        rows = await follow(submitted.follow_points(), ignore)
        assert [row.point for row in rows] == list(range(1, 13)) and len(lost) >= 3
        assert rows == await client.load_points(submitted)

    run_fleet(main)


def test_rows_that_a_killed_coordinator_had_not_written_are_not_lost_for_those_that_follow() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        submitted = await client.submit(job(f"[{GRID}]"))
        following = asyncio.ensure_future(follow(submitted.follow_points(), ignore))
        await wait_for_point(fleet, submitted, 9)
        fleet.kill("coordinator/first")
        await asyncio.sleep(2)
        fleet.start_coordinator("second")
        rows = await following
        assert (await client.wait_for_job(submitted)).state == "interrupted"
        kept = await client.load_points(submitted)
        assert [row.point for row in rows] == list(range(1, len(rows) + 1)) and len(rows) in (7, 8)
        assert rows[: len(kept)] == kept and len(kept) <= len(rows)

    run_fleet(main)


def test_the_row_of_a_point_at_which_the_job_is_paused_comes_too() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        submitted = await client.submit(job(f"[{GRID}]"))
        seen: list[int] = []
        following = asyncio.ensure_future(follow(submitted.follow_points(), lambda row: seen.append(row.point)))
        await wait_for_point(fleet, submitted, 4)
        await submitted.pause()
        await asyncio.sleep(10)
        progress = (await client.show_job(submitted)).progress
        assert progress is not None and progress.state == "paused" and progress.point is not None
        assert seen[-1] >= progress.point - 1 and seen[-1] >= 4
        # What is asked for has it too, although it is not in the journal yet.
        assert [row.point for row in await client.load_points(submitted)] == seen
        await submitted.resume()
        assert [row.point for row in await following] == list(range(1, 13))

    run_fleet(main)


def test_there_are_at_most_twenty_messages_a_second() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        came: list[tuple[int, JobPoints]] = []

        def receive(sample: BusSample) -> None:
            came.append((fleet.clock.now_ns(), JobPoints.model_validate_json(sample.payload)))

        await client.bus.subscribe(client.keys.job_points(), receive)
        submitted = await client.submit(job(f"[{GRID}, {LINES}]"))
        await client.wait_for_job(submitted)
        rows = [row for _, message in came for row in message.rows]
        assert rows == await client.load_points(submitted)
        lasts = [(-1, 0), *(place(message.rows[-1]) for _, message in came)]
        assert [(message.after_step, message.after_point) for _, message in came] == lasts[:-1]
        times_ns = [at_ns for at_ns, _ in came]
        assert all(later - sooner > 45 * NS_PER_MS for sooner, later in pairwise(times_ns))

    run_fleet(main)
