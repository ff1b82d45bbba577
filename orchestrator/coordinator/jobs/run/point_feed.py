"""The rows of the points of a running job on their way out: to the bus as soon as they are final, to the journal in
batches. What is not in the journal yet is at hand for those that ask."""

from collections.abc import Awaitable, Callable, Sequence

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.budgets import POINT_BYTES
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, ClockTimer
from orchestrator.model.operation.recording import JobPoints
from orchestrator.model.report import PointRecord

WRITTEN_AT_ONCE = 100  # rows in a transaction, at least
WRITTEN_AFTER_NS = NS_PER_S  # a row is written at the latest with the first one after this time
PUBLISHED_AT_ONCE = 500  # rows in a message, at most
PUBLISHED_AFTER_NS = 50 * NS_PER_MS  # between two messages, so that there are at most 20 a second

StoreRows = Callable[[Sequence[PointRecord]], Awaitable[None]]
PublishRows = Callable[[Sequence[PointRecord]], None]


class PointPublisher:
    """Publishes rows of job `job_id`, in their order."""

    def __init__(self, bus: Bus, keys: FleetKeys, job_id: str) -> None:
        self._bus = bus
        self._key = keys.job_points(job_id)
        self._job_id = job_id
        self._last = (-1, 0)

    def publish_rows(self, rows: Sequence[PointRecord]) -> None:
        """Publish rows, in several messages where one would be too large."""
        after_step, after_point = self._last
        message = JobPoints(job_id=self._job_id, after_step=after_step, after_point=after_point, rows=list(rows))
        payload = message.to_json()
        if len(payload) > POINT_BYTES and len(rows) > 1:
            half = len(rows) // 2
            self.publish_rows(rows[:half])
            self.publish_rows(rows[half:])
            return
        self._bus.put(self._key, payload, Priority.EVENT)
        self._last = rows[-1].step, rows[-1].point


class PointFeed:
    """Takes the rows of a job as they become final. publish_rows: puts rows on the bus. store_rows: writes rows to the
    journal; raises `JournalError`."""

    def __init__(self, clock: Clock, publish_rows: PublishRows, store_rows: StoreRows) -> None:
        self._clock = clock
        self._publish_rows = publish_rows
        self._store_rows = store_rows
        self._unpublished: list[PointRecord] = []
        self._unwritten: list[PointRecord] = []
        self._written_ns = clock.now_ns()
        self._published_ns = self._written_ns - PUBLISHED_AFTER_NS
        self._timer: ClockTimer | None = None

    @property
    def unwritten(self) -> list[PointRecord]:
        """The rows that are not in the journal yet, or are being written."""
        return list(self._unwritten)

    def add_rows(self, rows: Sequence[PointRecord]) -> None:
        """Take rows behind those before, and publish them at once, or when the next message may follow."""
        self._unpublished += rows
        self._unwritten += rows
        if self._unpublished and self._timer is None:
            self._publish_in_turn()

    async def write_in_turn(self) -> None:
        """Write the rows so far, if they are many, or have waited. Raises `JournalError`."""
        waited_ns = self._clock.now_ns() - self._written_ns
        if len(self._unwritten) >= WRITTEN_AT_ONCE or waited_ns >= WRITTEN_AFTER_NS:
            await self._write()

    async def finish(self) -> None:
        """Publish and write what is left. Raises `JournalError`."""
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        while self._unpublished:
            self._publish()
        await self._write()

    def _publish_in_turn(self) -> None:
        self._timer = None
        due_ns = self._published_ns + PUBLISHED_AFTER_NS
        if self._clock.now_ns() >= due_ns:
            self._publish()
            due_ns = self._published_ns + PUBLISHED_AFTER_NS
        if self._unpublished:
            self._timer = self._clock.call_at_ns(due_ns, self._publish_in_turn)

    def _publish(self) -> None:
        rows, self._unpublished = self._unpublished[:PUBLISHED_AT_ONCE], self._unpublished[PUBLISHED_AT_ONCE:]
        self._published_ns = self._clock.now_ns()
        self._publish_rows(rows)

    async def _write(self) -> None:
        self._written_ns = self._clock.now_ns()
        if rows := list(self._unwritten):
            await self._store_rows(rows)
            # Rows that came meanwhile stay.
            del self._unwritten[: len(rows)]
