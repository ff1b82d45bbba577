"""The steps of a live job: a program asks for them while the job runs."""

import asyncio
from collections.abc import Callable, Mapping, Sequence

from orchestrator.bus.base import Priority
from orchestrator.clock.base import ClockTimer
from orchestrator.coordinator.jobs.run.scan_flights import ScanFlights
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.live import KEPT_RESULTS, LiveResult, require_room
from orchestrator.model.report import StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.order import StepOrder, StepPlace
from orchestrator.model.steps.tree import as_live
from orchestrator.model.units import parse_quantity


class LiveSequence(StepSequence):
    """The steps that job `job_id` was asked for, by their numbers. live: what it may be asked for. on_added: called
    when there is one more to run, perhaps while another one moves.

    A step that is done is forgotten, so that memory does not grow. While moves are gathered, the last of them is open:
    it has its number, and cannot be run yet.
    """

    def __init__(
        self, order: StepOrder, services: JobServices, job_id: str, live: Live, on_added: Callable[[], None]
    ) -> None:
        super().__init__(order, services.view.fleet, services.journal.points, services.execute)
        self._services = services
        self._job_id = job_id
        self.live = live
        self._on_added = on_added
        self._asked: dict[int, Step] = {}
        self._count = 0
        self._present = -1
        self._open: Step | None = None
        self._timer: ClockTimer | None = None
        self._results: dict[int, LiveResult] = {}
        self._is_ended = self._is_stopped = False
        self._changed = asyncio.Event()

    # Requests

    def ask_steps(self, steps: Sequence[Step]) -> list[int]:
        """Add steps behind those that wait; return the number of each: that of the synchronised move where it is a part
        of one. Raises `Refusal`; then none is added."""
        if self._is_ended:
            raise Refusal("ended", "the live job has ended, and takes no more moves", "begin another one")
        waiting_count = sum(number > self._present for number in self._asked) + (self._open is not None)
        require_room(waiting_count, len(steps))
        return [self._add_step(step) for step in steps]

    def end(self) -> None:
        """Run what was asked for, and then no more."""
        self._close_open()
        self._is_ended = True
        self._changed.set()

    def stop(self, reason: str) -> None:
        """Its program stops what moves and what waits; it may ask for more."""
        self._is_stopped = True
        self.drop_waiting(reason)

    def find_result(self, number: int) -> LiveResult | None:
        """What became of step `number`; None: it has not ended, or is forgotten."""
        return self._results.get(number)

    def _add_step(self, step: Step) -> int:
        if self._open is not None:
            joined_step = self._open.join_step(step)
            if joined_step is not None:
                self._open = joined_step
                return self._count
            self._close_open()
        number = self._count
        if self.live.gather and step.can_join:
            self._open = step
            clock = self._services.clock
            self._timer = clock.call_at_ns(clock.now_ns() + self.live.gather, self._close_open)
        else:
            self._append_step(step)
        return number

    def _close_open(self) -> None:
        """The time to gather is over: the move is complete."""
        if self._timer is not None:
            self._timer.cancel()
        step, self._open, self._timer = self._open, None, None
        if step is not None:
            self._append_step(step)

    def _append_step(self, step: Step) -> None:
        self._asked[self._count] = step
        self._count += 1
        self._changed.set()
        self._on_added()

    # Steps

    def __len__(self) -> int:
        return self._count

    def locate(self, index: int) -> StepPlace:
        return StepPlace(
            index, self.live, 0, point=index, asked=self._asked.get(index), asked_count=max(self._count, index + 1)
        )

    def has_step(self, index: int) -> bool:
        return any(number >= index for number in self._asked)

    async def find_next(self, index: int) -> int | None:
        # The one before says whether a motion waits armed.
        self._asked = {number: step for number, step in self._asked.items() if number >= index - 1}
        self._is_stopped = False
        while not self.has_step(index) and not self._is_ended:
            self._changed.clear()
            await self._changed.wait()
        following_number = min((number for number in self._asked if number >= index), default=None)
        self._present = self._present if following_number is None else following_number
        return following_number

    def find_target(self, place: StepPlace) -> Mapping[str, float]:
        if place.asked is None:
            return {}
        fleet = self._services.view.fleet
        targets = place.asked.iterate_targets()
        return {axis: float(parse_quantity(target, fleet.unit_of(axis))) for axis, target in targets}

    # Results

    def note_report(self, index: int, report: StepReport) -> bool:
        """Step `index` has ended; return whether another one may begin. One that was refused before anything moved
        fails alone, and so does one that its program stops; those that wait behind it were asked for as if it had
        moved, and do not begin."""
        self._publish_result(index, report)
        if report.state == "done":
            return True
        if self._is_stopped:
            return True  # what waits was asked for behind the stop
        self.drop_waiting(f"move {index + 1} before it was not done: {report.reason}")
        has_moved = report.state != "failed" or report.t0_fleet_ns is not None or self._asked[index].searches
        return not has_moved

    def drop_waiting(self, reason: str) -> None:
        """Begin none of the steps that wait."""
        self._close_open()
        for number, step in sorted(self._asked.items()):
            if number <= self._present:
                continue
            report = StepReport(index=number, do=step.kind, name=step.name or "", state="skipped", reason=reason)
            self._publish_result(number, report)
        self._asked = {number: step for number, step in self._asked.items() if number <= self._present}

    def _publish_result(self, number: int, report: StepReport) -> None:
        result = self._results[number] = LiveResult(job_id=self._job_id, number=number, report=report)
        self._results.pop(number - KEPT_RESULTS, None)
        services = self._services
        services.bus.put(services.keys.job_live(self._job_id), result.to_json(), Priority.EVENT)


def make_sequence(services: JobServices, row: JobRecord, job: Job, on_added: Callable[[], None]) -> StepSequence:
    """The steps of job `row`. on_added: called when a live job has one more."""
    order, live = StepOrder(job.steps, row.repeat), as_live(job.steps[0])
    if live is not None:
        return LiveSequence(order, services, row.id, live, on_added)
    flights = ScanFlights(services.motion)
    return StepSequence(order, services.view.fleet, services.journal.points, services.execute, flights)
