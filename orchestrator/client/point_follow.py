"""The rows of the points of a job while it runs: from the bus, and from the service what was not received."""

import asyncio
from collections import deque
from collections.abc import AsyncGenerator, Sequence
from contextlib import aclosing, suppress

from orchestrator.bus.base import BusSample
from orchestrator.client.points import PointRequests
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobReference, JobShown
from orchestrator.model.operation.recording import JobPoints
from orchestrator.model.report import FINISHED_STATES, JobProgress, PointRecord

SILENCE_S = 1.0  # without rows, after which the service is asked: the last ones may be lost
KEPT_MESSAGES = 200  # ten seconds of them; what a slow reader loses beyond that is read from the service

AWAY_CODES = ("no-coordinator", "no-answer")  # of refusals while the coordinator is away: the request may be repeated


class FollowRequests(PointRequests):
    """Show what the journal has of a job, and follow what is recorded at points of its scans."""

    async def show_job(self, job_id: str) -> JobShown:
        """All that the journal has of a job. Raises `Refusal`."""
        return await self.request_service("show", JobReference(**self.request_fields(), job_id=job_id), JobShown)

    async def show_job_when_available(self, job_id: str, poll_s: float = 0.5) -> JobShown:
        """`show_job`, repeated while the coordinator is away. Raises `Refusal` for a job that does not exist."""
        while True:
            try:
                return await self.show_job(job_id)
            except Refusal as error:
                if error.code not in AWAY_CODES:
                    raise
            await asyncio.sleep(poll_s)

    async def follow_points(self, job_id: str, step: int | None = None) -> AsyncGenerator[PointRecord]:
        """What is recorded at the points of the scans of a job, each once and in order, as soon as it is final: first
        those so far. Ends with the job. step: only of the scan that begins with this step; ends with it.

        Raises `Refusal` for a job that does not exist. Waits on while the coordinator is away.
        """
        async with aclosing(self.follow_point_batches(job_id, step)) as batches:
            async for points in batches:
                for point in points:
                    yield point

    def follow_point_batches(self, job_id: str, step: int | None = None) -> AsyncGenerator[list[PointRecord]]:
        """`follow_points`, with those together that become known together: for what is written to a file."""
        return _PointFollower(self, job_id, step).iterate_batches()


class _PointFollower:
    """Follows the points of a job: every row once, in order. step: only the scan that begins with this step."""

    def __init__(self, requests: FollowRequests, job_id: str, step: int | None = None) -> None:
        self._requests = requests
        self._job_id = job_id
        self._step = step
        self._last: tuple[int, int] = (-1, 0) if step is None else (step, 0)
        self._messages: deque[JobPoints] = deque(maxlen=KEPT_MESSAGES)
        self._changed = asyncio.Event()
        self._has_state = False
        self._end_seen = False
        self._is_past_step = False
        self._is_read = False

    async def iterate_batches(self) -> AsyncGenerator[list[PointRecord]]:
        """The rows as they become known, those of one moment together; ends with the job, or with the scan that is
        followed. Raises `Refusal`. Waits on while the coordinator is away."""
        requests = self._requests
        subscriptions = [
            await requests.bus.subscribe(requests.keys.job_points(self._job_id), self._receive_points),
            await requests.bus.subscribe(requests.keys.job_state(self._job_id), self._receive_state),
        ]
        try:
            while True:
                # Asked before the rows are read: those of a job that has ended are all in the journal.
                is_over = await self._find_end()
                messages = list(self._messages)
                self._messages.clear()
                async for batch in self._read_batches():
                    yield batch
                if self._is_read:
                    # What of these the service has not got was lost with a coordinator, and is here alone.
                    for message in messages:
                        if batch := self._take_new(message.rows):
                            yield batch
                else:
                    self._messages.extendleft(reversed(messages))
                if self._is_past_step or (is_over and self._is_read):
                    return
                while await self._wait_for_message():
                    if batch := self._take_new(self._messages.popleft().rows):
                        yield batch
        finally:
            for subscription in subscriptions:
                await subscription.undeclare()

    async def _find_end(self) -> bool:
        """Whether the job has ended; asked only where the bus does not show that it runs."""
        runs, self._has_state = self._has_state and not self._end_seen, False
        if runs:
            return False
        self._end_seen = False
        return (await self._requests.show_job_when_available(self._job_id)).report is not None

    async def _read_batches(self) -> AsyncGenerator[list[PointRecord]]:
        """The rows behind the last one, from the service; as far as it answers."""
        self._is_read = False
        try:
            async for points in self._requests.read_point_parts(self._job_id, self._last):
                if batch := self._take_new(points):
                    yield batch
                if self._is_past_step:
                    return
            self._is_read = True
        except Refusal as error:
            if error.code not in AWAY_CODES:
                raise
            self._has_state = False  # whether it has ended is asked for next, which waits for the coordinator

    async def _wait_for_message(self) -> bool:
        """Wait for a message that continues the rows so far; return false where the service has to be asked: something
        is missing, nothing comes, or the job has ended."""
        while not self._messages:
            if self._end_seen or self._is_past_step:
                return False
            self._changed.clear()
            try:
                async with asyncio.timeout(SILENCE_S):
                    await self._changed.wait()
            except TimeoutError:
                return False
        message = self._messages[0]
        return (message.after_step, message.after_point) <= self._last

    def _take_new(self, rows: Sequence[PointRecord]) -> list[PointRecord]:
        """Those of `rows` that are behind the last row."""
        new_rows: list[PointRecord] = []
        for row in rows:
            if self._step is not None and row.step > self._step:
                self._is_past_step = True
                break
            if (row.step, row.point) > self._last:
                new_rows.append(row)
                self._last = row.step, row.point
        return new_rows

    def _receive_points(self, sample: BusSample) -> None:
        with suppress(ValueError):  # not of the coordinator
            message = JobPoints.read_message(sample.payload)
            if message.rows:
                self._messages.append(message)
                self._changed.set()

    def _receive_state(self, sample: BusSample) -> None:
        with suppress(ValueError):
            self._end_seen = self._end_seen or JobProgress.read_message(sample.payload).state in FINISHED_STATES
            self._has_state = True
            if self._end_seen:
                self._changed.set()
