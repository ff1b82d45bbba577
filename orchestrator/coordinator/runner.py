"""The queue and the job that runs: one at a time, each change of state in the journal before it is on the bus."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, field

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.coordinator.journal import JobRow, Journal, Runs
from orchestrator.coordinator.leases import LeaseBook
from orchestrator.coordinator.motion import Motion
from orchestrator.coordinator.reign import Throne
from orchestrator.coordinator.steps import PlainSteps, expand
from orchestrator.coordinator.targets import Refuse
from orchestrator.coordinator.view import FleetView
from orchestrator.model.fleet import by_controller
from orchestrator.model.job import Disable, Enable, Home, Job, Move, SetPosition, Step
from orchestrator.model.messages import Refusal
from orchestrator.model.report import (
    ENDED,
    JobReport,
    JobState,
    Progress,
    QueueEntry,
    QueueState,
    StepReport,
    Transition,
)

PROGRESS_NS = NS_PER_S // 5


class Interrupted(Exception):
    """The running job is to end: in which state, and why."""

    def __init__(self, state: JobState, reason: str, actor: str) -> None:
        super().__init__(reason)
        self.state: JobState = state
        self.reason = reason
        self.actor = actor


@dataclass(slots=True)
class _Running:
    """The job under way."""

    row: JobRow
    job: Job
    report: JobReport
    task: "asyncio.Task[None] | None" = None
    step: int = 0
    state: JobState = "planning"
    reason: str = ""
    interrupt: Interrupted | None = None
    step_t0_ns: int = 0
    step_s: float = 0.0
    part: float = 0.0
    doing: str = ""
    steps: list[StepReport] = field(default_factory=list[StepReport])


class Runner:
    """Takes jobs from the journal in the order of their submission and runs them."""

    def __init__(
        self,
        bus: Bus,
        keys: Keys,
        clock: Clock,
        journal: Journal,
        runs: Runs,
        view: FleetView,
        motion: Motion,
        plain: PlainSteps,
        leases: LeaseBook,
        throne: Throne,
        log: Log,
    ) -> None:
        self._bus = bus
        self._keys = keys
        self._clock = clock
        self._journal = journal
        self._runs = runs
        self._view = view
        self._motion = motion
        self._plain = plain
        self._leases = leases
        self._throne = throne
        self._log = log
        self._wake = asyncio.Event()
        self._running: _Running | None = None
        self._cancelled: set[str] = set()
        self._loop_task: asyncio.Task[None] | None = None
        self.on_ended: Callable[[JobReport], None] = lambda _: None

    async def start(self) -> None:
        """Close what an earlier coordinator left running, then begin with the queue."""
        for row in await self._runs(self._journal.unended):
            if row.state != "queued":
                reason = f"the coordinator ended while the job was {row.state}"
                report = await self._report_of(row)
                await self._end(row, report, "interrupted", reason, "coordinator")
        await self.publish_queue()
        self._loop_task = asyncio.get_running_loop().create_task(self._loop())

    async def close(self, reason: str) -> None:
        """End: a running job is stopped and noted as interrupted."""
        running = self._running
        if running is not None:
            await self.interrupt(Interrupted("interrupted", reason, "coordinator"))
            if running.task is not None:
                await asyncio.wait([running.task], timeout=5.0)
        if self._loop_task is not None:
            self._loop_task.cancel()

    def wake(self) -> None:
        """A job was accepted."""
        self._wake.set()

    @property
    def running(self) -> str | None:
        """Id of the job under way."""
        return self._running.row.id if self._running else None

    async def cancel(self, job_id: str, actor: str) -> Refusal | None:
        """Cancel a queued or running job."""
        if self._running is not None and self._running.row.id == job_id:
            await self.interrupt(Interrupted("cancelled", f"cancelled by {actor}", actor))
            return None
        row = await self._runs(self._journal.row, job_id)
        if row is None:
            return Refusal(code="unknown-job", text=f"no job {job_id}", remedy="see `tutti job ls`")
        if row.state in ENDED:
            return Refusal(code="ended", text=f"job {job_id} is {row.state} already")
        report = await self._report_of(row)
        await self._end(row, report, "cancelled", f"cancelled by {actor}", actor)
        return None

    async def interrupt(self, interrupt: Interrupted, mode: str = "decelerate") -> None:
        """Stop the running job's axes and end it. Does nothing without one."""
        running = self._running
        if running is None or running.task is None or running.interrupt is not None:
            return
        running.interrupt = interrupt
        await self._motion.stop(self._members_of(running.job), mode, interrupt.actor, interrupt.reason)
        running.task.cancel()

    # Inside

    async def _loop(self) -> None:
        while not self._throne.over:
            queued = [row for row in await self._runs(self._journal.unended) if row.state == "queued"]
            if not queued:
                await self._wake.wait()
                self._wake.clear()
                continue
            job = await self._runs(self._journal.job, queued[0].id)
            if job is None:
                continue
            running = self._running = _Running(queued[0], job, await self._report_of(queued[0]))
            running.task = asyncio.get_running_loop().create_task(self._run(running))
            beat = asyncio.get_running_loop().create_task(self._beat(running))
            await asyncio.wait([running.task])
            beat.cancel()
            self._running = None
            await self.publish_queue()

    async def _run(self, running: _Running) -> None:
        started_utc = self._clock.utc()
        running.report = running.report.model_copy(update={"started_utc": started_utc})
        state: JobState = "done"
        reason, actor = "", running.job.actor
        axes, holder = self._axes_of(running.job), running.row.id
        try:
            await self.publish_queue()
            await self._leases.take(holder, running.job.actor, f"job {running.job.name!r}", axes)
            await self._enable_by_policy(running.job, holder)
            for index, step in enumerate(running.job.steps):
                running.step, running.step_t0_ns, running.step_s = index, 0, 0.0
                running.part, running.doing = 0.0, ""
                report = await self._step(running, index, step)
                running.steps.append(report)
                if report.state != "done":
                    state = "aborted" if report.state == "stopped" else "failed"
                    reason = f"step {index} ({step.do}): {report.reason}"
                    break
        except asyncio.CancelledError:
            interrupt = running.interrupt or Interrupted("interrupted", "the coordinator ended", "coordinator")
            state, reason, actor = interrupt.state, interrupt.reason, interrupt.actor
        except Refuse as error:
            state, reason = "failed", f"not begun: {error.refusal.text}; {error.refusal.remedy}".rstrip("; ")
        except Exception as error:
            state, reason = "failed", f"a defect of the coordinator: {error!r}"
            await self._motion.stop(self._members_of(running.job), "decelerate", "coordinator", reason)
        await self._disable_by_policy(running.job, holder)
        await self._leases.give_back(holder)
        report = running.report.model_copy(update={"steps": running.steps})
        await self._end(running.row, report, state, reason, actor)

    async def _step(self, running: _Running, index: int, step: Step) -> StepReport:
        async def on_state(state: JobState, reason: str) -> None:
            await self._change(running, state, reason)

        def on_progress(part: float, doing: str) -> None:
            running.part, running.doing = part, doing
            self._publish(running)

        def on_started(t0_fleet_ns: int, duration_s: float) -> None:
            running.step_t0_ns, running.step_s = t0_fleet_ns, duration_s

        began_ns = self._clock.now_ns()
        try:
            if isinstance(step, Move):
                return await self._motion.run(running.row.id, running.job, index, step, on_state, on_started)
            await on_state("running", "")
            await self._plain.run(step, running.row.id, running.job.actor, on_progress)
        except Refuse as error:
            refusal = error.refusal
            self._log.warning(refusal.text, job=running.row.id, step=index, code=refusal.code)
            reason = f"{refusal.text}" + (f"; {refusal.remedy}" if refusal.remedy else "")
            return StepReport(
                index=index, do=step.do, name=step.name or "", state="failed", reason=reason, refused=refusal
            )
        took_s = (self._clock.now_ns() - began_ns) / NS_PER_S
        return StepReport(index=index, do=step.do, name=step.name or "", state="done", actual_s=took_s)

    async def _change(self, running: _Running, state: JobState, reason: str) -> None:
        if state == running.state and state != "planning":
            return
        running.state, running.reason = state, reason
        transition = Transition(
            state=state,
            reason=reason,
            actor=running.job.actor,
            utc=self._clock.utc(),
            fleet_ns=self._throne.fleet_now_ns(),
        )
        await self._runs(self._journal.change, running.row.id, transition)
        self._log.info(f"job is {state}", job=running.row.id, step=running.step, epoch=self._throne.epoch)
        self._publish(running)

    async def _end(self, row: JobRow, report: JobReport, state: JobState, reason: str, actor: str) -> None:
        utc = self._clock.utc()
        transition = Transition(state=state, reason=reason, actor=actor, utc=utc, fleet_ns=self._throne.fleet_now_ns())
        before = await self._runs(self._journal.transitions, row.id)
        report = report.model_copy(
            update={"state": state, "reason": reason, "ended_utc": utc, "transitions": [*before, transition]}
        )
        await self._runs(self._journal.change, row.id, transition, report)
        self._log.info(f"job is {state}: {reason}" if reason else f"job is {state}", job=row.id)
        self._bus.put(self._keys.job_report(row.id), report.to_json(), Priority.EVENT)
        job = await self._runs(self._journal.job, row.id)
        steps = len(job.steps) if job else 0
        done = len([step for step in report.steps if step.state == "done"])
        progress = Progress(
            job_id=row.id,
            name=row.name,
            actor=row.actor,
            state=state,
            step=max(0, len(report.steps) - 1),
            steps=steps,
            step_name="",
            fraction=done / steps if steps else 1.0,
            remaining_s=0.0,
            reason=reason,
            utc=utc,
        )
        self._bus.put(self._keys.job_state(row.id), progress.to_json(), Priority.EVENT)
        self.on_ended(report)

    async def _report_of(self, row: JobRow) -> JobReport:
        job = await self._runs(self._journal.job, row.id)
        return JobReport(
            job_id=row.id,
            name=row.name,
            actor=row.actor,
            state=row.state,
            reason=row.reason,
            epoch=self._throne.epoch,
            submitted_utc=row.submitted_utc,
            max_start_skew_ns=job.max_start_skew if job else 0,
        )

    async def _beat(self, running: _Running) -> None:
        while True:
            self._publish(running)
            await sleep_ns(self._clock, PROGRESS_NS)

    def _publish(self, running: _Running) -> None:
        self._bus.put(self._keys.job_state(running.row.id), self.progress(running).to_json(), Priority.STATE)

    def progress(self, running: _Running) -> Progress:
        """How far the job has come: steps done, and the part of the present move."""
        steps = running.job.steps
        within, remaining_s = running.part, None
        if running.step_t0_ns and running.step_s > 0:
            gone_s = (self._throne.fleet_now_ns() - running.step_t0_ns) / NS_PER_S
            within = min(1.0, max(0.0, gone_s / running.step_s))
            remaining_s = max(0.0, running.step_s - gone_s)
        step = steps[running.step]
        return Progress(
            job_id=running.row.id,
            name=running.row.name,
            actor=running.row.actor,
            state=running.state,
            step=running.step,
            steps=len(steps),
            step_name=running.doing or step.name or step.do,
            fraction=min(1.0, (running.step + within) / len(steps)),
            remaining_s=remaining_s,
            reason=running.reason,
            utc=self._clock.utc(),
        )

    async def publish_queue(self) -> None:
        """The jobs that wait and run, for those who watch."""
        rows = await self._runs(self._journal.unended)
        self._bus.put(self._keys.queue, queue_state(rows).to_json(), Priority.EVENT)

    # The axes of a job

    def _axes_of(self, job: Job) -> list[str]:
        """Axes that a job moves, switches or renames: those that it must hold."""
        fleet = self._view.fleet
        names: list[str] = []
        for step in job.steps:
            if isinstance(step, Move):
                names += [*step.to, *step.by]
            elif isinstance(step, Home | Enable | Disable):
                names += expand(fleet, step.axes or list(fleet.controllers))
            elif isinstance(step, SetPosition):
                names += step.axes
        return list(dict.fromkeys(names))

    def _moved_by(self, job: Job) -> list[str]:
        """Axes that a job moves, and that are enabled for it if the fleet file says so."""
        moves = [step for step in job.steps if isinstance(step, Move | Home)]
        return self._axes_of(job.model_copy(update={"steps": moves}))

    def _members_of(self, job: Job) -> list[str]:
        """Controllers that a job can move, for stopping them all."""
        return list(by_controller(self._axes_of(job)))

    async def _enable_by_policy(self, job: Job, holder: str) -> None:
        """Enable what the fleet file wants enabled for a job and is not. Raises `Refuse`."""
        fleet = self._view.fleet
        axes = self._moved_by(job)
        off = [axis for axis in axes if fleet.axis(axis).enable != "manual" and not self._is_enabled(axis)]
        if off:
            await self._plain.enable(off, True, holder, job.actor)

    async def _disable_by_policy(self, job: Job, holder: str) -> None:
        """Disable what is enabled for jobs only. What still ramps down stays on, and that is said."""
        per_job = [axis for axis in self._moved_by(job) if self._view.fleet.axis(axis).enable == "per_job"]
        if per_job:
            try:
                await self._plain.enable(per_job, False, holder, job.actor)
            except Refuse as error:
                self._log.warning(f"left enabled after the job: {error.refusal.text}")

    def _is_enabled(self, axis: str) -> bool:
        controller, _, name = axis.partition(".")
        state = self._view.state(controller)
        return state is not None and state.axes[name].enabled


def queue_state(rows: list[JobRow]) -> QueueState:
    """Rows of the journal as they stand on the bus."""
    return QueueState(jobs=[QueueEntry(**row._asdict()) for row in rows])
