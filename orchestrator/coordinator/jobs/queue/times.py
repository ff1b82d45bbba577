"""Start times and expiries of waiting jobs."""

import asyncio
from datetime import datetime, timedelta

from orchestrator.clock.base import NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.coordinator.jobs.queue.ends import RETRY_NS, JobEnds
from orchestrator.coordinator.jobs.queue.publisher import QueuePublisher
from orchestrator.coordinator.jobs.queue.queue_gate import COORDINATOR
from orchestrator.coordinator.jobs.queue.queue_order import WaitingJob
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.queue import parse_utc

CLOCK_POLL_NS = NS_PER_S  # period of reading the wall clock, which may be set, while a job waits for a time
MISSED_AFTER = timedelta(seconds=10)  # a coordinator that is back within this time has not missed a job's start time


class JobTimes:
    """Makes waiting jobs due at their start times, and ends those that have expired."""

    def __init__(self, services: JobServices, register: JobRegister, publisher: QueuePublisher, ends: JobEnds) -> None:
        self._services = services
        self._register = register
        self._publisher = publisher
        self._ends = ends
        self._entered = asyncio.Event()

    def note_entry(self) -> None:
        """A job has entered the queue; it may have a time."""
        self._entered.set()

    async def watch_times(self) -> None:
        """Mark jobs as due when their start time has come; missed ones are run or skipped, as their terms say. Cancel
        those that have waited for longer than their terms allow."""
        services = self._services
        while not services.leadership.over:
            utc_now = parse_utc(services.clock.utc())
            time_left = timedelta.max
            for job in list(self._register.waiting.values()):
                try:
                    time_left = min(time_left, await self._check_times(job, utc_now))
                except JournalError as error:
                    services.log.warning(f"job has to wait: {error}", job=job.row.id)
                    time_left = min(time_left, timedelta(seconds=RETRY_NS / NS_PER_S))
            if time_left == timedelta.max:
                await self._entered.wait()
                self._entered.clear()
            else:
                await sleep_ns(
                    services.clock, min(CLOCK_POLL_NS, round(time_left / timedelta(microseconds=1)) * NS_PER_US)
                )

    async def _check_times(self, waiting: WaitingJob, now: datetime) -> timedelta:
        """Act on the start time and the expiry of a job; return how long neither needs attention."""
        row, time_left = waiting.row, timedelta.max
        if row.expires_utc is not None:
            time_left = parse_utc(row.expires_utc) - now
            if time_left <= timedelta(0):
                reason = f"expired at {row.expires_utc}; last state: {self._publisher.make_entry(row).reason}"
                if self._register.waiting.pop(row.id, None) is not None:
                    await self._ends.cancel_waiting(waiting, reason, COORDINATOR)
                return timedelta.max
        if row.due or row.at_utc is None:
            return time_left
        at = parse_utc(row.at_utc)
        if at > now:
            return min(time_left, at - now)
        await self._mark_due(waiting, now - at)
        return time_left

    async def _mark_due(self, waiting: WaitingJob, late: timedelta) -> None:
        services, row = self._services, waiting.row
        if late > MISSED_AFTER and row.missed == "skip":
            if self._register.waiting.pop(row.id, None) is not None:
                await self._ends.cancel_waiting(waiting, f"missed: no leader was active at {row.at_utc}", COORDINATOR)
            return
        reason = (
            f"start time {row.at_utc} has come"
            if late <= MISSED_AFTER
            else f"begins late: no leader was active at {row.at_utc}"
        )
        change = services.make_transition("queued", reason, COORDINATOR)
        await services.execute(services.journal.mark_due, row.id, change)
        waiting.row = waiting.row._replace(due=True, reason=reason)
        self._register.wake_up()
