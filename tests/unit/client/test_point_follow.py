"""Rows of points from the bus and from the service, each once and in order, whatever is lost on the way."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

from orchestrator.bus.base import Priority
from orchestrator.bus.memory.bus import MemoryBus, MemoryNet
from orchestrator.client.point_follow import KEPT_MESSAGES, FollowRequests
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobShown, PointsRead, ReadPoints
from orchestrator.model.operation.recording import JobPoints
from orchestrator.model.report import JobProgress, JobReport, JobState, PointRecord

REPORT = JobReport(
    job_id="a1",
    name="scan",
    actor="anna",
    state="done",
    reason="",
    epoch=1,
    submitted_utc="2026-11-26T12:00:00Z",
    max_start_skew_ns=1,
)


def make_row(point: int) -> PointRecord:
    return PointRecord(step=2, point=point, state="done", verdict="green", target={}, measured={})


class Service(FollowRequests):
    """A client of a coordinator that has `stored` and may be `away`. asked: after which points it was asked for rows;
    shown: how often for the job."""

    def __init__(self, bus: MemoryBus) -> None:
        super().__init__(bus, "lab")
        self.stored: list[PointRecord] = []
        self.is_away = False
        self.has_ended = False
        self.asked: list[int] = []
        self.shown = 0

    async def request_service(self, verb: str, request: Any, *_: Any, **__: Any) -> Any:
        await asyncio.sleep(0.001)
        if self.is_away:
            raise Refusal("no-coordinator", "it is away", "")
        if verb == "show":
            self.shown += 1
            return JobShown(report=REPORT if self.has_ended else None)
        assert verb == "points" and isinstance(request, ReadPoints)
        self.asked.append(request.after_point)
        after = request.after_step, request.after_point
        return PointsRead(points=[row for row in self.stored if (row.step, row.point) > after][: request.limit])


class World:
    """A service, a follower of its points, and the coordinator's part of the bus."""

    def __init__(self, clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        self.bus = net.join_process("coordinator")
        self.service = Service(net.join_process("client"))
        self.rows: list[int] = []
        self.last = 0

    def publish(self, *points: int, is_lost: bool = False, is_stored: bool = True) -> None:
        """Publish rows, unless they are lost."""
        rows = [make_row(point) for point in points]
        message = JobPoints(job_id="a1", after_step=2 if self.last else -1, after_point=self.last, rows=rows)
        self.last = points[-1]
        if is_stored:
            self.service.stored += rows
        if not is_lost:
            self.bus.put(self.service.keys.job_points("a1"), message.to_json(), Priority.EVENT)

    def show(self, state: JobState) -> None:
        """Publish the progress of the job."""
        progress = JobProgress(
            job_id="a1",
            name="scan",
            actor="anna",
            state=state,
            step=2,
            steps=3,
            step_name="",
            fraction=0,
            remaining_s=None,
            reason="",
            utc="",
        )
        self.bus.put(self.service.keys.job_state("a1"), progress.to_json(), Priority.EVENT)

    def end(self) -> None:
        self.service.has_ended = True
        self.show("done")

    async def follow(self, delay_s: float = 0.0) -> None:
        """Follow the points to the end; delay_s: after each batch."""
        async for batch in self.service.follow_point_batches("a1"):
            self.rows += [row.point for row in batch]
            await asyncio.sleep(delay_s)


def run(main: Callable[[World], Coroutine[Any, Any, None]]) -> None:
    async def run_main(clock: VirtualClock) -> None:
        await main(World(clock))

    run_virtual(run_main)


def test_rows_come_from_the_bus_and_the_service_is_asked_once_before_and_once_behind() -> None:
    async def main(world: World) -> None:
        following = asyncio.ensure_future(world.follow())
        for point in range(1, 50):
            world.show("running")
            world.publish(point)
            await asyncio.sleep(0.2)
            assert world.rows[-1] == point
        world.end()
        await following
        assert world.rows == list(range(1, 50))
        # The first message may come while the service is asked.
        assert len(world.service.asked) == 2 and world.service.shown == 2

    run(main)


def test_a_job_that_has_ended_is_read_without_a_wait() -> None:
    async def main(world: World) -> None:
        world.publish(*range(1, 5000))
        world.end()
        async with asyncio.timeout(0.1):
            await world.follow()
        assert world.rows == list(range(1, 5000))

    run(main)


def test_what_is_lost_is_read_also_where_nothing_comes_behind_it() -> None:
    async def main(world: World) -> None:
        following = asyncio.ensure_future(world.follow())
        await asyncio.sleep(0.1)
        world.publish(1, 2)
        world.publish(3, is_lost=True)
        world.publish(4, 5)
        await asyncio.sleep(0.1)
        assert world.rows == [1, 2, 3, 4, 5]
        world.publish(6, is_lost=True)
        await asyncio.sleep(1.2)
        assert world.rows == [1, 2, 3, 4, 5, 6]
        world.publish(6)  # repeated
        world.last = 6
        world.publish(7, is_lost=True)
        world.end()
        await following
        assert world.rows == [1, 2, 3, 4, 5, 6, 7]

    run(main)


def test_a_gap_is_filled_when_the_coordinator_is_back() -> None:
    async def main(world: World) -> None:
        following = asyncio.ensure_future(world.follow())
        await asyncio.sleep(0.1)
        world.show("running")
        world.publish(1)
        world.publish(2, is_lost=True)
        world.service.is_away = True
        world.publish(3, is_stored=False)
        await asyncio.sleep(5)
        assert world.rows == [1]
        world.service.is_away = False
        await asyncio.sleep(1)
        # The third one was lost with the coordinator, and is here alone.
        assert world.rows == [1, 2, 3]
        world.service.is_away = True
        world.show("interrupted")
        await asyncio.sleep(3)
        assert not following.done()
        world.service.is_away, world.service.has_ended = False, True
        await following
        assert world.rows == [1, 2, 3]

    run(main)


def test_one_that_is_slow_loses_messages_and_no_rows() -> None:
    async def main(world: World) -> None:
        world.publish(1)
        following = asyncio.ensure_future(world.follow(delay_s=30))
        for point in range(2, 3 * KEPT_MESSAGES):
            await asyncio.sleep(0.05)
            world.show("running")
            world.publish(point)
        world.end()
        await following
        assert world.rows == list(range(1, 3 * KEPT_MESSAGES))

    run(main)


def test_what_is_not_of_the_coordinator_changes_nothing() -> None:
    async def main(world: World) -> None:
        following = asyncio.ensure_future(world.follow())
        await asyncio.sleep(0.1)
        for leaf in ("points", "state"):
            world.bus.put(f"{world.service.keys.prefix}/job/a1/{leaf}", b'{"rows": 3', Priority.EVENT)
        world.publish(1)
        await asyncio.sleep(0.1)
        assert world.rows == [1]
        world.end()
        await following

    run(main)
