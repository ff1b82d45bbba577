"""The jobs that wait and run. Each change of a job's state is in the journal before it is on the bus.

Which of the waiting ones begin is decided in `queue`, how one runs in `job_run`.
"""

import asyncio
from collections.abc import Coroutine, Iterable
from datetime import timedelta
from typing import Any

from pydantic import ValidationError

from orchestrator.bus.base import Declared, Priority, Sample
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.coordinator.job_run import Interrupted, JobRun, Outcome, Works
from orchestrator.coordinator.journal import JobRow, JournalError
from orchestrator.coordinator.queue import Choice, Waiting, choose, needs_of, steps_to_run
from orchestrator.model.base import UnknownName
from orchestrator.model.fleet import by_controller
from orchestrator.model.job import Job
from orchestrator.model.messages import Estop, Refusal
from orchestrator.model.queue import parse_utc
from orchestrator.model.report import ENDED, JobReport, JobState, Progress, QueueEntry, QueueState

SHOWN = 200  # entries of the queue on the bus: what is behind them waits for long
QUIET_NS = 50 * NS_PER_MS  # between two puts of the queue, however fast jobs come
TICK_NS = NS_PER_S  # how often the wall clock is looked at while a job waits for a time: it may be set
LATE = timedelta(seconds=10)  # a coordinator that is back within that has not missed a job's time
AGAIN_NS = 5 * NS_PER_S  # before another try on a journal that could not be written


class Runner:
    """Begins jobs as soon as what they need is free, and changes the queue as people ask."""

    def __init__(self, works: Works) -> None:
        self._works = works
        self._waiting: dict[str, Waiting] = {}
        self._needs: dict[str, frozenset[str]] = {}
        self._running: dict[str, JobRun] = {}
        self._reasons: dict[str, str] = {}
        self._told: dict[str, str] = {}
        self._trouble = ""
        self._wake = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._declared: list[Declared] = []
        self._announcing = self._changed_since = False
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
            await self._end(row, self._report_of(row, job), "interrupted", reason, "coordinator")
        for waiting in list(self._waiting.values()):
            await self._settle_after(waiting)
        self._declared.append(await works.bus.subscribe(works.keys.estop, self._hear_estop))
        self._spawn(self._loop())
        self._spawn(self._watch_times())
        self.wake()
        self.announce()

    async def close(self, reason: str) -> None:
        """End: running jobs are stopped and noted as interrupted."""
        for declared in self._declared:
            await declared.undeclare()
        runs = list(self._running.values())
        await self.interrupt(Interrupted("interrupted", reason, "coordinator"))
        ends = [run.task for run in runs if run.task is not None]
        if ends:
            await asyncio.wait(ends, timeout=5.0)
            # The ends of jobs are journalled by tasks of ours.
            while any(run.row.id in self._running for run in runs):
                await sleep_ns(self._works.clock, NS_PER_MS)
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
        self.announce()

    async def cancel(self, job_id: str, actor: str) -> Refusal | None:
        """Cancel a queued or running job."""
        run = self._running.get(job_id)
        if run is not None:
            await run.interrupt(Interrupted("cancelled", f"cancelled by {actor}", actor))
            return None
        waiting = self._waiting.pop(job_id, None)
        if waiting is None:
            return await self._refusal(job_id, "not-queued", "try again in a moment")
        report = self._report_of(waiting.row, waiting.job)
        try:
            await self._end(waiting.row, report, "cancelled", f"cancelled by {actor}", actor)
        except JournalError:
            self._waiting[job_id] = waiting
            raise
        self.wake()
        return None

    async def stop(self, interrupt: Interrupted, mode: str = "decelerate") -> None:
        """Stop all that runs, and hold all that waits: nothing begins by itself after a stop."""
        queued = [each.row.id for each in self._waiting.values() if not each.row.held_by]
        for job_id in queued:
            self._held_now(job_id, interrupt.actor)
        await self.interrupt(interrupt, mode)
        await self._note_all_held(queued, interrupt.actor, f"held: {interrupt.reason}")

    async def interrupt(self, interrupt: Interrupted, mode: str = "decelerate") -> None:
        """Stop all jobs that run, and end them."""
        await asyncio.gather(*(run.interrupt(interrupt, mode) for run in self._running.values()))

    async def hold(self, job_ids: Iterable[str], actor: str) -> Refusal | None:
        """Keep queued jobs from beginning until they are released."""
        for job_id in job_ids:
            if job_id not in self._waiting:
                return await self._refusal(job_id, "not-queued", "pause it: `tutti job pause`")
            if not self._waiting[job_id].row.held_by:
                self._held_now(job_id, actor)
                await self._note_held(job_id, actor, f"held by {actor}")
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
                await works.runs(works.journal.hold, job_id, "", change)
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
            order = [each for each in self._in_order() if each is not mine]
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
        self.announce()
        return None

    async def pause(self, job_id: str, actor: str) -> Refusal | None:
        """Hold a running job when its present step has ended."""
        run = self._running.get(job_id)
        if run is None:
            return await self._refusal(job_id, "not-running", "keep a queued one back with `tutti job hold`")
        if run.paused_by is None:
            self._works.log.info(f"to be paused by {actor}", job=job_id)
            run.pause(actor)
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
                self._trouble = ""
                self._wake.set()
            choice = self._choose()
            for each in choice.begin:
                self._begin(each)
            self._reasons = choice.reasons
            self._tell()
            if choice.begin:
                self.announce()

    def _choose(self) -> Choice:
        busy = {controller: run.words for run in self._running.values() for controller in run.needs}
        for held in self._works.leases.held:
            if held.holder not in self._running:
                for controller in by_controller(held.axes):
                    busy.setdefault(controller, f"in use by {held.actor} ({held.what})")
        return choose(((each, self._needs_of(each)) for each in self._in_order()), busy)

    def _in_order(self) -> list[Waiting]:
        return sorted(self._waiting.values(), key=lambda each: each.order)

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
        self._told.pop(row.id, None)
        run = self._running[row.id] = JobRun(self._works, row, waiting.job, self._report_of(row, waiting.job))
        run.needs = self._needs.pop(row.id)
        run.task = asyncio.get_running_loop().create_task(run.run())
        self._spawn(self._finish(run, waiting))

    async def _finish(self, run: JobRun, waiting: Waiting) -> None:
        """Wait for a job's end and note it."""
        assert run.task is not None
        await asyncio.wait([run.task])
        outcome = run.task.result() if not run.task.cancelled() else None
        if outcome is None:
            outcome = Outcome("interrupted", "the coordinator ended", "coordinator", self._report_of(run.row, run.job))
        if not outcome.begun:
            self._waiting[run.row.id] = waiting
            del self._running[run.row.id]
            self._works.log.warning(f"job has to wait: {outcome.reason}", job=run.row.id)
        else:
            try:
                await self._end(run.row, outcome.report, outcome.state, outcome.reason, outcome.actor)
            except JournalError as error:
                self._works.log.warning(f"the end of a job is not in the journal: {error}", job=run.row.id)
                self._trouble = str(error)
            del self._running[run.row.id]
        self.wake()
        self.announce()

    # Ends

    async def _end(self, row: JobRow, report: JobReport, state: JobState, reason: str, actor: str) -> None:
        """Note the end of a job, and say it. Raises `JournalError`."""
        works = self._works
        transition = works.transition(state, reason, actor)
        before = await works.runs(works.journal.transitions, row.id)
        report = report.model_copy(
            update={"state": state, "reason": reason, "ended_utc": transition.utc, "transitions": [*before, transition]}
        )
        await works.runs(works.journal.change, row.id, transition, report)
        self._needs.pop(row.id, None)
        self._told.pop(row.id, None)
        works.log.info(f"job is {state}: {reason}" if reason else f"job is {state}", job=row.id)
        works.bus.put(works.keys.job_report(row.id), report.to_json(), Priority.EVENT)
        job = await works.runs(works.journal.job, row.id)
        steps = len(job.steps) * row.repeat if job else 0
        done = len([step for step in report.steps if step.state == "done"])
        progress = _progress(row, state, reason, transition.utc, steps).model_copy(
            update={
                "step": row.from_step + max(0, len(report.steps) - 1),
                "fraction": min(1.0, (row.from_step + done) / steps) if steps else 1.0,
                "remaining_s": 0.0,
            }
        )
        works.bus.put(works.keys.job_state(row.id), progress.to_json(), Priority.EVENT)
        for waiting in [each for each in self._waiting.values() if each.pending == row.id]:
            await self._settle_after(waiting)
        self.announce()

    async def _settle_after(self, waiting: Waiting) -> None:
        """Free a job of the one that it comes after, or end it, if that one has ended."""
        works, before = self._works, waiting.pending
        if before is None:
            return
        row = await works.runs(works.journal.row, before)
        if row is not None and row.state not in ENDED:
            return
        waiting.pending = None
        if row is not None and row.state == "done":
            self.wake()
            return
        if self._waiting.pop(waiting.row.id, None) is None:
            return
        found = f"is {row.state}: {row.reason}" if row is not None else "is not in the journal any more"
        reason = f"job {before}, which must be done before, {found}"
        await self._end(waiting.row, self._report_of(waiting.row, waiting.job), "cancelled", reason, "coordinator")

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
                    await self._come_due(each, now - at)
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
                reason = f"missed: no coordinator was there at {row.at_utc}"
                await self._end(row, self._report_of(row, waiting.job), "cancelled", reason, "coordinator")
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

    async def _note_held(self, job_id: str, actor: str, reason: str) -> None:
        works = self._works
        await works.runs(works.journal.hold, job_id, actor, works.transition("queued", reason, actor))
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
        self._spawn(self._note_all_held(queued, actor, f"held: {reason}"))

    async def _note_all_held(self, job_ids: list[str], actor: str, reason: str) -> None:
        for job_id in job_ids:
            await self._note_held(job_id, actor, reason)

    # What the bus shows

    def entries(self, rows: Iterable[JobRow]) -> list[QueueEntry]:
        """Jobs as a list shows them: with what only the present coordinator knows of those that wait."""
        places = {each.row.id: place for place, each in enumerate(self._in_order(), 1)}
        return [self._entry(row, places.get(row.id)) for row in rows]

    def entry(self, row: JobRow) -> QueueEntry:
        """A job as a list shows it."""
        waiting = self._waiting.get(row.id)
        if waiting is None:
            return self._entry(row, None)
        return self._entry(row, 1 + sum(each.order < waiting.order for each in self._waiting.values()))

    def _entry(self, row: JobRow, place: int | None) -> QueueEntry:
        run, waiting = self._running.get(row.id), self._waiting.get(row.id)
        if waiting is not None:
            row = waiting.row
        return QueueEntry(
            id=row.id,
            name=row.name,
            actor=row.actor,
            state=run.state if run is not None and row.state not in ENDED else row.state,
            reason=row.reason if waiting is None else self._reasons.get(row.id, row.reason),
            submitted_utc=row.submitted_utc,
            place=place,
            terms=row.terms,
            held_by=row.held_by,
            origin=row.origin,
            from_step=row.from_step,
        )

    def announce(self) -> None:
        """Put the queue on the bus, soon: at once after a quiet time, else when one has passed."""
        if self._announcing:
            self._changed_since = True
            return
        self._announcing = True
        self._spawn(self._announce())

    async def _announce(self) -> None:
        # The loop decides first what becomes of a job that has just come.
        await sleep_ns(self._works.clock, NS_PER_MS)
        order = self._in_order()[:SHOWN]
        rows = [run.row for run in self._running.values()] + [each.row for each in order]
        total = len(self._running) + len(self._waiting)
        state = QueueState(total=total, jobs=self.entries(rows[:SHOWN]))
        self._works.bus.put(self._works.keys.queue, state.to_json(), Priority.EVENT)
        await sleep_ns(self._works.clock, QUIET_NS)
        self._announcing = False
        if self._changed_since:
            self._changed_since = False
            self.announce()

    def _tell(self) -> None:
        """Say of each job that waits, and is shown, for what, if that has changed."""
        for each in self._in_order()[:SHOWN]:
            row, reason = each.row, self._reasons.get(each.row.id, "")
            if reason and self._told.get(row.id) != reason:
                self._told[row.id] = reason
                steps = len(each.job.steps) * row.repeat
                progress = _progress(row, "queued", reason, self._works.clock.utc(), steps)
                self._works.bus.put(self._works.keys.job_state(row.id), progress.to_json(), Priority.STATE)

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)


def _progress(row: JobRow, state: JobState, reason: str, utc: str, steps: int) -> Progress:
    """A job that does not run, as it stands."""
    return Progress(
        job_id=row.id,
        name=row.name,
        actor=row.actor,
        state=state,
        step=row.from_step,
        steps=steps,
        step_name="",
        fraction=row.from_step / steps if steps else 0.0,
        remaining_s=None,
        reason=reason,
        utc=utc,
    )
