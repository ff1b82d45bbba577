"""The jobs that wait and run. Each change of a job's state is in the journal before it is on the bus.

Which of the waiting ones begin is decided in `queue`, how one runs in `job_run`.
"""

import asyncio
from collections.abc import Callable, Coroutine, Iterable
from datetime import timedelta
from typing import Any, ParamSpec

from pydantic import ValidationError

from orchestrator.bus.base import Declared, Priority, Sample
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.coordinator.jobs.job_run import Interrupted, JobRun, Outcome, Works
from orchestrator.coordinator.jobs.publisher import Board, queued_progress
from orchestrator.coordinator.jobs.queue import Choice, Waiting, choose, in_order, needs_of, steps_to_run
from orchestrator.coordinator.journal.journal import HasEnded, JobRow, JournalError
from orchestrator.model.base import UnknownName
from orchestrator.model.fleet import by_controller
from orchestrator.model.job import Job
from orchestrator.model.messages import Estop, Refusal, StopMode
from orchestrator.model.queue import parse_utc
from orchestrator.model.report import ENDED, JobReport, JobState, QueueEntry

P = ParamSpec("P")

TICK_NS = NS_PER_S  # how often the wall clock is looked at while a job waits for a time: it may be set
LATE = timedelta(seconds=10)  # a coordinator that is back within that has not missed a job's time
PATIENCE_NS = 20 * NS_PER_US  # a job
CLOSE_S = 5.0  # for running jobs to stop, and for their ends to be noted
AGAIN_NS = 5 * NS_PER_S  # before another try on a journal that could not be written


class Runner:
    """Begins jobs as soon as what they need is free, and changes the queue as people ask."""

    def __init__(self, works: Works) -> None:
        self._works = works
        self._waiting: dict[str, Waiting] = {}
        self._needs: dict[str, frozenset[str]] = {}
        self._running: dict[str, JobRun] = {}
        self._board = Board(works, self._waiting, self._running)
        self._trouble = False
        self._wake = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._declared: list[Declared] = []
        self._timed = asyncio.Event()
        self._arranging = asyncio.Lock()
        works.leases.listen(lambda _: self.wake())

    async def start(self) -> None:
        """Close what an earlier coordinator left running, then begin with the queue. Raises `JournalError`."""
        works = self._works
        left: list[tuple[JobRow, Job]] = []
        for row in await works.runs(works.journal.unended):
            job = await works.runs(works.journal.job, row.id)
            assert job is not None
            if row.state == "queued":
                self._waiting[row.id] = Waiting(row, job, row.after)
            else:
                left.append((row, job))
        for row, job in left:
            reason = f"the coordinator ended while the job was {row.state}"
            await self._end(row, job, self._report_of(row, job), "interrupted", reason, "coordinator")
        for waiting in list(self._waiting.values()):
            await self._settle_after(waiting)
        self._declared.append(await works.bus.subscribe(works.keys.estop, self._hear_estop))
        self._spawn(self._loop)
        self._spawn(self._watch_times)
        self.wake()
        self._board.announce()

    async def close(self, reason: str) -> None:
        """End: running jobs are stopped and noted as interrupted."""
        for declared in self._declared:
            await declared.undeclare()
        runs = list(self._running.values())
        await self.interrupt(Interrupted("interrupted", reason, "coordinator"))
        ends = [run.task for run in runs if run.task is not None]
        if ends:
            await asyncio.wait(ends, timeout=CLOSE_S)
            # Their ends are noted by tasks of ours.
            until_ns = self._works.clock.now_ns() + round(CLOSE_S * NS_PER_S)
            while self._running and self._works.clock.now_ns() < until_ns:
                await sleep_ns(self._works.clock, NS_PER_MS)
        self._board.close()
        for task in self._tasks:
            task.cancel()

    def wake(self) -> None:
        """Something has come free, or the queue has changed."""
        self._wake.set()

    # What people ask

    async def enter(self, row: JobRow, job: Job) -> None:
        """A job was accepted."""
        waiting = self._waiting[row.id] = Waiting(row, job, row.after)
        await self._settle_after(waiting)
        self._timed.set()
        self.wake()
        self._board.announce()

    async def cancel(self, job_id: str, actor: str) -> Refusal | None:
        """Cancel a queued or running job."""
        run = self._running.get(job_id)
        if run is not None:
            await run.interrupt(Interrupted("cancelled", f"cancelled by {actor}", actor))
            return None
        waiting = self._waiting.pop(job_id, None)
        if waiting is None:
            return await self._refusal(job_id, "not-queued", "try again in a moment")
        await self._cancel_waiting(waiting, f"cancelled by {actor}", actor)
        self.wake()
        return None

    async def stop(self, interrupt: Interrupted, mode: StopMode = "decelerate") -> None:
        """Stop all that runs, and hold all that waits: nothing begins by itself after a stop."""
        queued = [each.row.id for each in self._waiting.values() if not each.row.held_by]
        for job_id in queued:
            self._held_now(job_id, interrupt.actor)
        await self.interrupt(interrupt, mode)
        await self._note_held(queued, interrupt.actor, f"held: {interrupt.reason}")

    async def interrupt(self, interrupt: Interrupted, mode: StopMode = "decelerate") -> None:
        """Stop all jobs that run, and end them."""
        await asyncio.gather(*(run.interrupt(interrupt, mode) for run in self._running.values()))

    async def hold(self, job_ids: Iterable[str], actor: str) -> Refusal | None:
        """Keep queued jobs from beginning until they are released."""
        for job_id in job_ids:
            if job_id not in self._waiting:
                return await self._refusal(job_id, "not-queued", "pause it: `tutti job pause`")
            if not self._waiting[job_id].row.held_by:
                self._held_now(job_id, actor)
                await self._note_held([job_id], actor, f"held by {actor}")
        return None

    async def release(self, job_ids: Iterable[str], actor: str) -> Refusal | None:
        """Let held jobs begin when it is their turn; without any, all that are held."""
        for job_id in list(job_ids) or [each.row.id for each in self._waiting.values() if each.row.held_by]:
            waiting = self._waiting.get(job_id)
            if waiting is None:
                return await self._refusal(job_id, "not-queued", "one that is paused: `tutti job resume`")
            if waiting.row.held_by:
                works = self._works
                change = works.transition("queued", f"released by {actor}", actor)
                await works.runs(works.journal.hold, [job_id], "", change)
                waiting.row = waiting.row._replace(held_by="", reason=change.reason)
                self.wake()
        return None

    async def move(self, job_id: str, before: str, actor: str) -> Refusal | None:
        """Put a queued job before another one, with that one's priority."""
        for each in (job_id, before):
            if each not in self._waiting:
                return await self._refusal(each, "not-queued", "only what is queued has a place")
        if job_id == before:
            return Refusal(code="same-job", text=f"job {job_id} can not stand before itself", remedy="name another")
        async with self._arranging:
            mine, other = self._waiting[job_id], self._waiting[before]
            order = [each for each in in_order(self._waiting) if each is not mine]
            order.insert(order.index(other), mine)
            ranks = sorted(each.row.place for each in order)
            places = {each.row.id: rank for each, rank in zip(order, ranks, strict=True) if each.row.place != rank}
            works, priority = self._works, other.row.priority
            change = works.transition("queued", f"put before job {before} by {actor}", actor)
            await works.runs(works.journal.reorder, job_id, priority, places, change)
            for each in order:
                each.row = each.row._replace(place=places.get(each.row.id, each.row.place))
            mine.row = mine.row._replace(priority=priority, reason=change.reason)
        self.wake()
        self._board.announce()
        return None

    async def pause(self, job_id: str, actor: str, now: bool = False) -> Refusal | None:
        """Hold a running job when its present step has ended; with `now`, inside a motion step."""
        run = self._running.get(job_id)
        if run is None:
            return await self._refusal(job_id, "not-running", "keep a queued one back with `tutti job hold`")
        if run.paused_by is None:
            self._works.log.info(f"to be paused by {actor}", job=job_id)
            run.pause(actor)
        if now:
            await run.brake(actor)
        return None

    async def resume(self, job_id: str, actor: str) -> Refusal | None:
        """Go on with a job that is paused, or is to be."""
        run = self._running.get(job_id)
        if run is None:
            remedy = "one that is held: `tutti job release`; one that has ended: `tutti job resume --from-step`"
            return await self._refusal(job_id, "not-running", remedy)
        if run.paused_by is None:
            return Refusal(code="not-paused", text=f"job {job_id} is not paused; it is {run.state}")
        run.resume(actor)
        return None

    async def _refusal(self, job_id: str, code: str, remedy: str) -> Refusal:
        """Why a job is not what somebody takes it for."""
        row = await self._works.runs(self._works.journal.row, job_id)
        if row is None:
            return Refusal(code="unknown-job", text=f"no job {job_id}", remedy="see `tutti job ls`")
        state = self._running[job_id].state if job_id in self._running else row.state
        if state in ENDED:
            return Refusal(code="ended", text=f"job {job_id} is {state} already")
        return Refusal(code=code, text=f"job {job_id} is {state}", remedy=remedy)

    # The loop

    async def _loop(self) -> None:
        works = self._works
        while not works.throne.over:
            await self._wake.wait()
            self._wake.clear()
            if self._trouble:
                await sleep_ns(works.clock, AGAIN_NS)
                self._trouble = False
                self._wake.set()
            # The longer the queue, the more is decided at once: looking through it takes some microseconds a job.
            await sleep_ns(works.clock, len(self._waiting) * PATIENCE_NS)
            choice = self._choose()
            for each in choice.begin:
                self._begin(each)
            self._board.decided(in_order(self._waiting), choice.reasons)
            if choice.begin:
                self._board.announce()

    def _choose(self) -> Choice:
        busy = {controller: run.words for run in self._running.values() for controller in run.needs}
        for held in self._works.leases.held:
            if held.holder not in self._running:
                for controller in by_controller(held.axes):
                    busy.setdefault(controller, f"in use by {held.actor} ({held.what})")
        return choose(((each, self._needs_of(each)) for each in in_order(self._waiting)), busy)

    def _needs_of(self, waiting: Waiting) -> frozenset[str]:
        """Kept, because the queue may be long; what the fleet file does not have any more is refused at the start."""
        known = self._needs.get(waiting.row.id)
        if known is None:
            row, steps = waiting.row, waiting.job.steps
            try:
                remaining = steps_to_run(row, waiting.job)[row.from_step :] if row.from_step else steps
                known = needs_of(self._works.view.fleet, remaining)
            except UnknownName:
                known = frozenset[str]()
            self._needs[waiting.row.id] = known
        return known

    def forget_needs(self) -> None:
        """The fleet file has changed."""
        self._needs.clear()
        self.wake()

    def _begin(self, waiting: Waiting) -> None:
        row = waiting.row
        del self._waiting[row.id]
        run = self._running[row.id] = JobRun(self._works, row, waiting.job, self._report_of(row, waiting.job))
        run.needs = self._needs.pop(row.id)
        run.task = asyncio.get_running_loop().create_task(run.run())
        self._spawn(self._finish, run, waiting)

    async def _finish(self, run: JobRun, waiting: Waiting) -> None:
        """Wait for a job's end and note it."""
        assert run.task is not None
        await asyncio.wait([run.task])
        error = None if run.task.cancelled() else run.task.exception()
        if run.task.cancelled() or error is not None:
            outcome = run.broken_off(error)
            await self._works.leases.give_back(run.row.id)
        else:
            outcome = run.task.result()
        if outcome.begun:
            await self._note_end(run, outcome)
        else:
            self._waiting[run.row.id] = waiting
            self._trouble = self._trouble or outcome.trouble
            self._works.log.warning(f"job has to wait: {outcome.reason}", job=run.row.id)
        del self._running[run.row.id]
        if not outcome.begun:
            self._board.decided(in_order(self._waiting), {run.row.id: outcome.reason})
        self.wake()
        self._board.announce()

    async def _note_end(self, run: JobRun, outcome: Outcome) -> None:
        """Note an end as soon as the journal can be written. Nothing else begins on its controllers before that."""
        while True:
            try:
                await self._end(run.row, run.job, outcome.report, outcome.state, outcome.reason, outcome.actor)
                return
            except HasEnded as error:
                self._works.log.warning(str(error), job=run.row.id)
                return
            except JournalError as error:
                self._works.log.warning(f"the end of a job can not be noted yet: {error}", job=run.row.id)
                await sleep_ns(self._works.clock, AGAIN_NS)

    # Ends

    async def _end(self, row: JobRow, job: Job, report: JobReport, state: JobState, reason: str, actor: str) -> None:
        """Note the end of a job, and say it. Raises `JournalError`; then nothing is noted, and nothing said."""
        works = self._works
        transition = works.transition(state, reason, actor)
        before = await works.runs(works.journal.transitions, row.id)
        report = report.model_copy(
            update={"state": state, "reason": reason, "ended_utc": transition.utc, "transitions": [*before, transition]}
        )
        await works.runs(works.journal.change, row.id, transition, report)
        self._needs.pop(row.id, None)
        works.log.info(f"job is {state}: {reason}" if reason else f"job is {state}", job=row.id)
        works.bus.put(works.keys.job_report(row.id), report.to_json(), Priority.EVENT)
        steps = len(job.steps) * row.repeat
        done = len([step for step in report.steps if step.state == "done"])
        progress = queued_progress(row, state, reason, transition.utc, steps).model_copy(
            update={
                "step": row.from_step + max(0, len(report.steps) - 1),
                "fraction": min(1.0, (row.from_step + done) / steps),
                "remaining_s": 0.0,
            }
        )
        works.bus.put(works.keys.job_state(row.id), progress.to_json(), Priority.EVENT)
        self._spawn(self._settle_followers, row.id)
        self._board.announce()

    async def _settle_followers(self, job_id: str) -> None:
        """Free, or end, those that come after a job that has ended."""
        for waiting in [each for each in self._waiting.values() if each.pending == job_id]:
            while True:
                try:
                    await self._settle_after(waiting)
                    break
                except JournalError as error:
                    self._works.log.warning(f"job has to wait: {error}", job=waiting.row.id)
                    await sleep_ns(self._works.clock, AGAIN_NS)

    async def _settle_after(self, waiting: Waiting) -> None:
        """Free a job of the one that it comes after, or end it, if that one has ended."""
        works, before = self._works, waiting.pending
        if before is None:
            return
        row = await works.runs(works.journal.row, before)
        if row is not None and row.state not in ENDED:
            return
        if row is not None and row.state == "done":
            waiting.pending = None
            self.wake()
            return
        if self._waiting.pop(waiting.row.id, None) is None:
            return
        found = f"is {row.state}: {row.reason}" if row is not None else "is not in the journal any more"
        await self._cancel_waiting(waiting, f"job {before}, which must be done before, {found}", "coordinator")

    async def _cancel_waiting(self, waiting: Waiting, reason: str, actor: str) -> None:
        """End a job that has been taken out of the queue; it is back there if that can not be noted."""
        report = self._report_of(waiting.row, waiting.job)
        try:
            await self._end(waiting.row, waiting.job, report, "cancelled", reason, actor)
        except JournalError:
            self._waiting[waiting.row.id] = waiting
            raise

    def _report_of(self, row: JobRow, job: Job) -> JobReport:
        return JobReport(
            job_id=row.id,
            name=row.name,
            actor=row.actor,
            state=row.state,
            reason=row.reason,
            epoch=self._works.throne.epoch,
            submitted_utc=row.submitted_utc,
            max_start_skew_ns=job.max_start_skew,
            repeat=row.repeat,
            origin=row.origin,
            from_step=row.from_step,
        )

    # Times

    async def _watch_times(self) -> None:
        """Let jobs become due when their time has come; what was missed is run or skipped, as its terms say."""
        works = self._works
        while not works.throne.over:
            now = parse_utc(works.clock.utc())
            left = timedelta.max
            for each in list(self._waiting.values()):
                if each.row.due or each.row.at_utc is None:
                    continue
                at = parse_utc(each.row.at_utc)
                if at <= now:
                    try:
                        await self._come_due(each, now - at)
                    except JournalError as error:
                        works.log.warning(f"job has to wait: {error}", job=each.row.id)
                        left = min(left, timedelta(seconds=AGAIN_NS / NS_PER_S))
                else:
                    left = min(left, at - now)
            if left == timedelta.max:
                await self._timed.wait()
                self._timed.clear()
            else:
                await sleep_ns(works.clock, min(TICK_NS, round(left / timedelta(microseconds=1)) * NS_PER_US))

    async def _come_due(self, waiting: Waiting, late: timedelta) -> None:
        works, row = self._works, waiting.row
        if late > LATE and row.missed == "skip":
            if self._waiting.pop(row.id, None) is not None:
                await self._cancel_waiting(waiting, f"missed: no coordinator was there at {row.at_utc}", "coordinator")
            return
        reason = f"{row.at_utc} has come" if late <= LATE else f"begins late: no coordinator was there at {row.at_utc}"
        change = works.transition("queued", reason, "coordinator")
        await works.runs(works.journal.come_due, row.id, change)
        waiting.row = waiting.row._replace(due=True, reason=reason)
        self.wake()

    # Holding

    def _held_now(self, job_id: str, actor: str) -> None:
        waiting = self._waiting[job_id]
        waiting.row = waiting.row._replace(held_by=actor)

    async def _note_held(self, job_ids: list[str], actor: str, reason: str) -> None:
        works = self._works
        if job_ids:
            await works.runs(works.journal.hold, job_ids, actor, works.transition("queued", reason, actor))
            self.wake()

    def _hear_estop(self, sample: Sample) -> None:
        """Nothing begins by itself after an e-stop, when it is reset: neither jobs nor steps."""
        try:
            estop = Estop.model_validate_json(sample.payload)
            actor, why = estop.actor, f": {estop.reason}" if estop.reason else ""
        except ValidationError:
            actor, why = "an e-stop", ""
        reason = f"e-stop by {actor}{why}"
        for run in self._running.values():
            run.give_up(Interrupted("aborted", reason, actor))
        queued = [each.row.id for each in self._waiting.values() if not each.row.held_by]
        for job_id in queued:
            self._held_now(job_id, actor)
        self._spawn(self._note_held, queued, actor, f"held: {reason}")

    def entries(self, rows: Iterable[JobRow]) -> list[QueueEntry]:
        """Jobs as a list shows them."""
        return self._board.entries(rows)

    def entry(self, row: JobRow) -> QueueEntry:
        """A job as a list shows it."""
        return self._board.entry(row)

    # Inside

    def _spawn(self, function: Callable[P, Coroutine[Any, Any, None]], *values: P.args, **names: P.kwargs) -> None:
        async def work() -> None:
            try:
                await function(*values, **names)
            except JournalError as error:
                self._works.log.warning(str(error))

        task = asyncio.get_running_loop().create_task(work())
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
