"""A flight of a job while it flies: its rows are given out, and a pause brakes it between two lines."""

import asyncio
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.jobs.run.flight_rows import FlightRows
from orchestrator.coordinator.jobs.run.report_collector import ReportCollector
from orchestrator.coordinator.jobs.run.run_state import RunState
from orchestrator.coordinator.jobs.run.scan_flights import ScanFlights
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.motion.feed_pause import FeedPause
from orchestrator.model.report import StepReport
from orchestrator.model.steps.order import StepPlace

LOOK_NS = 50 * NS_PER_MS
"""Between two looks at a flight: rows are published at most 20 times a second."""

LOOK_AT_SWITCHING_NS = 250 * NS_PER_MS
"""Between two looks at what outputs did, each some exchanges with their controller."""


class FlightRun:
    """Follows one flight."""

    def __init__(self, services: JobServices, state: RunState, reports: ReportCollector, flight: FlightRows) -> None:
        self._services = services
        self._state = state
        self._reports = reports
        self._flight = flight
        self._is_over = self._is_busy = False

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Give out rows, and brake behind the present line when a pause is asked for, in parallel with the context."""
        owner, watcher = TaskOwner(), TaskOwner()
        task = owner.spawn(self._run())
        watcher.spawn(self._watch_switching())
        try:
            yield
        finally:
            self._is_over = True
            watcher.cancel_all()
            if not self._is_busy:  # what is being written or released is not cut short
                owner.cancel_all()
            await asyncio.wait([task])

    async def _run(self) -> None:
        while not self._is_over:
            await sleep_ns(self._services.clock, LOOK_NS)
            self._is_busy = True
            self._flight.observe(self._state.motion_step)
            try:
                await self._reports.add_flown_rows(self._flight.take())
            except JournalError as error:  # the rows are kept, and written again with those that follow
                self._services.log.warning(f"rows are not written yet: {error}")
            await self._follow_pause()
            self._is_busy = False

    async def _watch_switching(self) -> None:
        """Fetch what was switched in lines that are over; apart from the rest, which waits for no controller."""
        while True:
            await sleep_ns(self._services.clock, LOOK_AT_SWITCHING_NS)
            if self._flight.waits_for_switching:
                await self._flight.look_at_switching()

    async def _follow_pause(self) -> None:
        motion, pause = self._flight.motion, self._state.pause
        feed = None if motion is None else motion.feed
        if feed is None or pause.braked:
            return
        if pause.paused_by is None or feed.times_s is None:
            feed.pause = None
            return
        feed.pause = feed.pause or self._find_pause(pause.paused_by, feed.times_s[0])
        if feed.pause is not None and feed.pause.is_before(feed.chunk):
            await feed.hold(feed.pause.actor, feed.pause.path_s)

    def _find_pause(self, actor: str, moved_s: float) -> FeedPause | None:
        """A pause behind the line that is flown now; none behind the last one."""
        place_s = self._flight.find_line_end(moved_s)
        return None if place_s is None else FeedPause(actor, place_s)

    async def finish(self, flights: ScanFlights, place: StepPlace, report: StepReport) -> StepReport:
        """Take what has become of the flight: its last rows, and where the scan goes on. Raises `JournalError`."""
        end = self._flight.finish(report)
        goes_on = end.is_interrupted
        await self._reports.add_flown_rows(end.rows, "; ".join(report.deviations) or report.reason)
        next_point = end.next_point
        if end.late:
            self._services.log.warning(report.reason, job=report.name, step=place.index)
            if end_words := flights.note_stop(place):
                report = report.model_copy(update={"state": "failed", "reason": f"{report.reason}; {end_words}"})
                goes_on = False
            elif not flights.repeats_disturbed(place) and end.broken:
                await self._reports.add_flown_rows(self._flight.make_broken_rows(end.broken))
                next_point = end.broken.stop
        done_steps = self._count_steps(place, next_point, report)
        await self._reports.end_flight(place, report, done_steps)
        if report.state == "done" or goes_on:
            flights.note_end(place, next_point)
        return report

    def _count_steps(self, place: StepPlace, next_point: int, report: StepReport) -> int:
        """The steps of the scan that are done: the moves between lines are parts of the flight."""
        assert place.scan is not None and place.point is not None
        if report.state == "failed":
            return 0
        lines = (next_point - place.point) // place.scan.line_points
        return max(0, lines * place.scan.points_steps - 1)
