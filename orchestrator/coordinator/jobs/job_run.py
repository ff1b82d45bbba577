"""One job that runs: its leases, its steps one after the other, its pauses, and its report."""

import asyncio
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.bus.base import Bus, BusError, Priority
from orchestrator.bus.keys import Keys
from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Runs
from orchestrator.coordinator.fleet.leases import InUse, LeaseBook
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.jobs.queue import axes_of, steps_to_run
from orchestrator.coordinator.jobs.steps import PlainSteps, check_job
from orchestrator.coordinator.journal.journal import JobRow, Journal, JournalError
from orchestrator.coordinator.leadership.leadership import Throne
from orchestrator.coordinator.motion.motion import HELD, Motion
from orchestrator.coordinator.motion.targets import Refuse
from orchestrator.model.fleet import by_controller
from orchestrator.model.job import Home, Job, Move, Step
from orchestrator.model.messages import StopMode
from orchestrator.model.report import Held, JobReport, JobState, Progress, StepReport, Transition

PROGRESS_NS = NS_PER_S // 5
REST_NS = NS_PER_S // 2  # beyond a declared stop time, for a poll to show that it is over
REST_LOOK_NS = NS_PER_S // 20


class Interrupted(Exception):
    """A running job is to end: in which state, and why."""

    def __init__(self, state: JobState, reason: str, actor: str) -> None:
        super().__init__(reason)
        self.state: JobState = state
        self.reason = reason
        self.actor = actor


@dataclass(frozen=True, slots=True)
class Works:
    """What jobs are run with."""

    bus: Bus
    keys: Keys
    clock: Clock
    journal: Journal
    runs: Runs
    view: FleetView
    motion: Motion
    plain: PlainSteps
    leases: LeaseBook
    throne: Throne
    log: Log

    def transition(self, state: JobState, reason: str, actor: str) -> Transition:
        """A change of a job's state, now."""
        fleet_ns = self.throne.fleet_now_ns()
        return Transition(state=state, reason=reason, actor=actor, utc=self.clock.utc(), fleet_ns=fleet_ns)


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a job came to its end.

    begun: False when its axes were taken, or the journal could not be written (trouble), before it could begin: then it
    waits on.
    """

    state: JobState
    reason: str
    actor: str
    report: JobReport
    begun: bool = True
    trouble: bool = False


class JobRun:
    """`row` under way. needs: controllers that it has for itself."""

    def __init__(self, works: Works, row: JobRow, job: Job, report: JobReport) -> None:
        self.row = row
        self.job = job
        self.needs: frozenset[str] = frozenset()
        self.state: JobState = "queued"
        self.task: asyncio.Task[Outcome] | None = None
        self._works = works
        self._interrupt: Interrupted | None = None
        self._given_up: Interrupted | None = None
        self._noted = False
        self._over = False
        self._steps = steps_to_run(row, job)
        self._report = report
        self._reports: list[StepReport] = []
        self._reason = ""
        self._step = row.from_step
        self._step_t0_ns = 0
        self._step_s = 0.0
        self._seen_ns: int | None = None
        """Since when its axes rest and nothing has been done with them; None: nobody has looked."""
        self._part = 0.0
        self._doing = ""
        self._paused_by: str | None = None
        self._braked = False
        self._resumed: asyncio.Event = asyncio.Event()
        self._resumed_by = ""

    @property
    def words(self) -> str:
        """Which job it is, for those who wait for it."""
        return f"job {self.row.id} {self.row.name!r} of {self.row.actor}"

    @property
    def to_run(self) -> list[Step]:
        """The steps that it runs, from the one that it begins with."""
        return self._steps[self.row.from_step :]

    @property
    def members(self) -> list[str]:
        """Controllers that it can move, for stopping them all."""
        return list(by_controller(axes_of(self._works.view.fleet, self.to_run)))

    async def interrupt(self, interrupt: Interrupted, mode: StopMode = "decelerate") -> None:
        """Stop its axes and end it. Does nothing to one that ends already."""
        if self._over or self._interrupt is not None or self.task is None:
            return
        self._interrupt = interrupt
        await self._works.motion.stop(self.members, mode, interrupt.actor, interrupt.reason)
        if not self._over:
            self.task.cancel()

    # Pause

    @property
    def paused_by(self) -> str | None:
        """Who has paused it, or asked for it."""
        return self._paused_by

    def pause(self, actor: str) -> None:
        """Hold the job when the present step has ended. Its axes stay its own."""
        self._paused_by = actor
        self._resumed.clear()
        self.publish()

    async def brake(self, actor: str) -> None:
        """Hold inside a motion step: its axes brake together, and it goes on from where they stand. Any other step is
        held at its end."""
        self._braked = True
        await self._works.motion.hold(self.row.id, actor)

    def resume(self, actor: str) -> None:
        """Go on with the step that is held inside, or the next one, or do not hold at all."""
        self._paused_by, self._resumed_by, self._braked = None, actor, False
        self._resumed.set()
        self.publish()

    def give_up(self, interrupt: Interrupted) -> None:
        """Begin no step any more. What moves is left to who has stopped it."""
        self._given_up = interrupt
        self._resumed.set()

    async def _hold(self) -> None:
        """Wait until somebody resumes the job, if it is paused. Raises `Interrupted` when it is given up."""
        while self._paused_by is not None:
            self._seen_ns = None
            where = f"before step {self._step}" if self._step == self.row.from_step else f"after step {self._step - 1}"
            if self._part:
                where = f"in step {self._step}"
            await self._change("holding", f"paused by {self._paused_by} {where}", self._paused_by)
            await self._resumed.wait()
            if self._given_up is not None:
                break
            await self._change("running", f"resumed by {self._resumed_by}", self._resumed_by)
        if self._given_up is not None:
            raise self._given_up

    # The way of a job

    async def run(self) -> Outcome:
        """Run all steps; raises nothing."""
        beat = asyncio.get_running_loop().create_task(self._beat())
        try:
            outcome = await self._run()
        finally:
            self._over = True
            beat.cancel()
        if outcome.state != "done" and self._holds_axes():
            # A stop takes its time to arrive, and its ramp as well: nobody else has the axes meanwhile.
            await self._until_at_rest()
        await self._disable_by_policy()
        await self._works.leases.give_back(self.row.id)
        return outcome

    def broken_off(self, error: BaseException | None) -> Outcome:
        """How a run ended that could not say it itself: with an error, or cancelled at an unlucky moment."""
        ended = self._interrupt or Interrupted("interrupted", "the coordinator ended", "coordinator")
        if error is not None:
            ended = Interrupted("failed", f"a defect of the coordinator: {error!r}", "coordinator")
        report = self._report.model_copy(update={"steps": self._reports})
        return Outcome(ended.state, ended.reason, ended.actor, report)

    async def _run(self) -> Outcome:
        works = self._works
        self._report = self._report.model_copy(update={"started_utc": works.clock.utc()})
        state: JobState = "done"
        reason, actor = "", self.row.actor
        try:
            check_job(works.view.fleet, self.to_run)
            axes = axes_of(works.view.fleet, self.to_run)
            since_ns = works.clock.now_ns()
            await works.leases.take(self.row.id, self.row.actor, f"job {self.row.name!r}", axes)
            await self._until_at_rest(since_ns)
            await self._enable_by_policy()
            for index in range(self.row.from_step, len(self._steps)):
                self._step, self._step_t0_ns, self._step_s = index, 0, 0.0
                self._part, self._doing = 0.0, ""
                await self._hold()
                step = self._steps[index]
                report = await self._run_through_holds(index, step)
                self._seen_ns = None
                self._reports.append(report)
                if report.state != "done":
                    state = "aborted" if report.state == "stopped" else "failed"
                    reason = f"step {index} ({step.do}): {report.reason}"
                    break
        except asyncio.CancelledError:
            interrupt = self._interrupt or Interrupted("interrupted", "the coordinator ended", "coordinator")
            state, reason, actor = interrupt.state, interrupt.reason, interrupt.actor
        except Interrupted as given_up:
            state, reason, actor = given_up.state, given_up.reason, given_up.actor
        except InUse as error:
            return Outcome("queued", error.refusal.text, actor, self._report, begun=False)
        except Refuse as error:
            state, reason = "failed", f"not begun: {error.refusal.text}; {error.refusal.remedy}".rstrip("; ")
        except JournalError as error:
            if not self._noted:
                return Outcome("queued", str(error), actor, self._report, begun=False, trouble=True)
            state, reason = "failed", str(error)
            await works.motion.stop(self.members, "decelerate", "coordinator", reason)
        except Exception as error:
            state, reason = "failed", f"a defect of the coordinator: {error!r}"
            await works.motion.stop(self.members, "decelerate", "coordinator", reason)
        return Outcome(state, reason, actor, self._report.model_copy(update={"steps": self._reports}))

    async def _run_through_holds(self, index: int, step: Step) -> StepReport:
        """Run a step; one that is held inside goes on to the same targets from where its axes stand."""
        holds: list[Held] = []
        goal: dict[str, Fraction] = {}
        while True:
            report = await self._run_step(index, step, goal)
            if report.refused is None or report.refused.code != HELD:
                return report.model_copy(update={"holds": holds})
            if report.state == "stopped":
                works, by = self._works, self._paused_by or self._resumed_by
                holds.append(Held(by=by, utc=works.clock.utc(), rest_skew=report.end_skew))
                self._part = self._within()
            self._step_t0_ns = 0
            await self._hold()
            await self._until_at_rest()

    async def _run_step(self, index: int, step: Step, goal: dict[str, Fraction]) -> StepReport:
        works = self._works

        async def on_state(state: JobState, reason: str) -> None:
            await self._change(state, reason)
            if self._braked and state != "planning":
                # It was asked for while there was nothing to brake yet.
                await works.motion.hold(self.row.id, self._paused_by or "")

        def on_progress(part: float, doing: str) -> None:
            self._part, self._doing = part, doing
            self.publish()

        def on_started(t0_fleet_ns: int, duration_s: float) -> None:
            self._step_t0_ns, self._step_s = t0_fleet_ns, duration_s

        began_ns = works.clock.now_ns()
        try:
            if isinstance(step, Move):
                return await works.motion.run(
                    self.row.id, self.job, index, step, on_state, on_started, goal, self._seen_ns
                )
            await on_state("running", "")
            await works.plain.run(step, self.row.id, self.row.actor, on_progress)
        except Refuse as error:
            refusal = error.refusal
            works.log.warning(refusal.text, job=self.row.id, step=index, code=refusal.code)
            reason = f"{refusal.text}" + (f"; {refusal.remedy}" if refusal.remedy else "")
            return StepReport(
                index=index, do=step.do, name=step.name or "", state="failed", reason=reason, refused=refusal
            )
        took_s = (works.clock.now_ns() - began_ns) / NS_PER_S
        return StepReport(index=index, do=step.do, name=step.name or "", state="done", actual_s=took_s)

    async def _change(self, state: JobState, reason: str, actor: str | None = None) -> None:
        if state == self.state and state != "planning":
            return
        works = self._works
        transition = works.transition(state, reason, actor or self.row.actor)
        await works.runs(works.journal.change, self.row.id, transition)
        self.state, self._reason, self._noted = state, reason, True
        works.log.info(f"job is {state}", job=self.row.id, step=self._step, epoch=works.throne.epoch)
        self.publish()

    # Progress

    async def _beat(self) -> None:
        while True:
            self.publish()
            await sleep_ns(self._works.clock, PROGRESS_NS)

    def publish(self) -> None:
        """Put how far it has come."""
        key = self._works.keys.job_state(self.row.id)
        self._works.bus.put(key, self.progress().to_json(), Priority.STATE)

    def progress(self) -> Progress:
        """How far the job has come: steps done, and the part of the present one."""
        within, remaining_s = self._within(), None
        if self._step_t0_ns and self._step_s > 0:
            remaining_s = max(0.0, self._step_s - self._gone_s())
        step = self._steps[self._step]
        reason = self._reason
        if self._paused_by is not None and self.state != "holding":
            reason = f"pauses after this step: {self._paused_by}"
        return Progress(
            job_id=self.row.id,
            name=self.row.name,
            actor=self.row.actor,
            state=self.state,
            step=self._step,
            steps=len(self._steps),
            step_name=self._doing or step.name or step.do,
            fraction=min(1.0, (self._step + within) / len(self._steps)),
            remaining_s=remaining_s,
            reason=reason,
            utc=self._works.clock.utc(),
        )

    def _gone_s(self) -> float:
        return (self._works.throne.fleet_now_ns() - self._step_t0_ns) / NS_PER_S

    def _within(self) -> float:
        """The part of the present step that is done: of the rest behind `_part`, by time."""
        if not self._step_t0_ns or self._step_s <= 0:
            return self._part
        return self._part + (1 - self._part) * min(1.0, max(0.0, self._gone_s() / self._step_s))

    # Motors

    def _moved(self) -> list[str]:
        """Axes that it moves, and that are enabled for it if the fleet file says so."""
        return axes_of(self._works.view.fleet, [step for step in self.to_run if isinstance(step, Move | Home)])

    async def _enable_by_policy(self) -> None:
        """Enable what the fleet file wants enabled for a job and is not. Raises `Refuse`."""
        fleet = self._works.view.fleet
        off = [axis for axis in self._moved() if fleet.axis(axis).enable != "manual" and not self._is_enabled(axis)]
        if off:
            self._seen_ns = None
            await self._works.plain.enable(off, True, self.row.id, self.row.actor)

    async def _disable_by_policy(self) -> None:
        """Disable what is enabled for jobs only. What still ramps down stays on, and that is said."""
        works = self._works
        if not self._holds_axes():
            return
        per_job = [axis for axis in self._moved() if works.view.fleet.axis(axis).enable == "per_job"]
        if per_job:
            try:
                await works.plain.enable(per_job, False, self.row.id, self.row.actor)
            except Refuse as error:
                works.log.warning(f"left enabled after the job: {error.refusal.text}", job=self.row.id)

    async def _until_at_rest(self, since_ns: int | None = None) -> None:
        """Wait until what was stopped, with this job or an earlier reign or hand, has come to the end of its ramp. Who
        does not answer, or takes longer than it has declared, is waited for only as long as that: planning refuses
        it. since_ns: from when on an answer counts."""
        self._seen_ns = self._works.clock.now_ns() if since_ns is None else since_ns
        await asyncio.gather(*(self._rests(member, since_ns) for member in self.members))

    async def _rests(self, member: str, since_ns: int | None) -> None:
        works = self._works
        # The ramps of a step may be gentler than any that its axes can do.
        stop_ns = works.motion.stops_ns.get(member, 0)
        with suppress(BusError):
            stop_ns = max(stop_ns, (await works.view.info(member)).costs.stop_ns)
        until_ns = works.clock.now_ns() + stop_ns + REST_NS
        while works.clock.now_ns() < until_ns:
            # Who can not be asked is stopped by others, its guardian or its own watchdog, which takes as long.
            with suppress(BusError):
                state, since_ns = await works.view.fresh(member, since_ns), None
                # Who has just begun to look for its reference has not been seen to move yet.
                busy = any(each.moving or each.homing for each in state.axes.values())
                if state.mode not in ("moving", "stopping") and not busy:
                    return
            await sleep_ns(works.clock, REST_LOOK_NS)

    def _holds_axes(self) -> bool:
        return any(held.holder == self.row.id for held in self._works.leases.held)

    def _is_enabled(self, axis: str) -> bool:
        controller, _, name = axis.partition(".")
        state = self._works.view.state(controller)
        return state is not None and state.axes[name].enabled
