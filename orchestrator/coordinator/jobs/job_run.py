"""Execution of one job: its leases, its steps one after the other, its pauses, and its report."""

import asyncio
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass

from orchestrator.bus.base import Bus, BusError, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.lease_states import LeaseUser
from orchestrator.coordinator.fleet.leases import AxesInUse, LeaseRegistry
from orchestrator.coordinator.fleet.positions import PositionBook
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.jobs.check import check_job, predict_s
from orchestrator.coordinator.jobs.job_plan import PlannedJob, list_written, make_plan
from orchestrator.coordinator.jobs.motion_chain import MotionChain
from orchestrator.coordinator.jobs.point_readings import PointReadings
from orchestrator.coordinator.jobs.queue import find_axes
from orchestrator.coordinator.jobs.report_collector import ReportCollector
from orchestrator.coordinator.jobs.sequence import StepSequence
from orchestrator.coordinator.journal.records import DamagedRecord, JobRecord, JournalError
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.leadership import Leadership
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import FEED_HOLD, StateCallback
from orchestrator.coordinator.motion.step import MotionStep
from orchestrator.coordinator.statistics.collector import StatisticsCollector
from orchestrator.coordinator.steps.context import StepContext
from orchestrator.coordinator.steps.kinds import run_step
from orchestrator.coordinator.steps.motors import switch_motors
from orchestrator.model.base import UnknownName
from orchestrator.model.errors import Refusal, TuttiError
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import RefusalDetails, StopMode
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.operation.approval import JobApproval, join_changes, list_changes
from orchestrator.model.operation.recording import JobBegun
from orchestrator.model.report import (
    FeedHold,
    JobProgress,
    JobReport,
    JobState,
    JobTransition,
    PointRecord,
    StepReport,
)
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.order import StepOrder
from orchestrator.model.steps.tree import as_motion, iterate_steps

PROGRESS_NS = NS_PER_S // 5
REST_NS = NS_PER_S // 2  # beyond a declared stop time, for a poll to show rest
REST_POLL_NS = NS_PER_S // 20


class JobInterrupted(TuttiError):
    """The reason to end a running job: the state to end in, why, and the originator."""

    def __init__(self, state: JobState, reason: str, actor: str) -> None:
        super().__init__(reason)
        self.state: JobState = state
        self.reason = reason
        self.actor = actor


class PlanDeviates(Refusal):
    """A proposed job would not begin with the plan that was approved."""

    def __init__(self, changes: str) -> None:
        super().__init__("plan-changed", f"held again: {changes}", "look at the plan again: `tutti job approve`")


@dataclass(frozen=True, slots=True)
class JobServices:
    """The services that jobs need."""

    bus: Bus
    keys: FleetKeys
    clock: Clock
    journal: JournalStore
    execute: Executor
    view: FleetView
    fleet: FleetAccess
    motion: MotionServices
    leases: LeaseRegistry
    positions: PositionBook
    alarms: AlarmRegister
    statistics: StatisticsCollector
    leadership: Leadership
    log: ProcessLog

    def make_transition(self, state: JobState, reason: str, actor: str) -> JobTransition:
        """A change of a job's state, now."""
        fleet_ns = self.leadership.fleet_now_ns()
        return JobTransition(state=state, reason=reason, actor=actor, utc=self.clock.utc(), fleet_ns=fleet_ns)

    async def load_approval(self, job_id: str) -> JobApproval | None:
        """The last approval of a job, also one that is void. One that cannot be read is logged, and counts as none.
        Raises `JournalError`."""
        try:
            return await self.execute(self.journal.approvals.load_approval, job_id)
        except DamagedRecord as error:
            self.log.warning(str(error), job=job_id)
            return None


@dataclass(frozen=True, slots=True)
class JobOutcome:
    """The end of a job's execution.

    begun: False when its axes were taken, its plan is not the approved one (deviates), or the journal could not be
    written (trouble), before it could begin; then it waits again.
    """

    state: JobState
    reason: str
    actor: str
    report: JobReport
    begun: bool = True
    deviates: bool = False
    trouble: bool = False


@dataclass(frozen=True, slots=True)
class _StepCallbacks:
    """What a motion step reports to its job."""

    on_state: StateCallback
    on_started: Callable[[int, float], None]


class JobRun:
    """The execution of job `row`. needs: controllers that no other job may use meanwhile."""

    def __init__(self, services: JobServices, row: JobRecord, job: Job, report: JobReport) -> None:
        self.row = row
        self.job = job
        self.needs: frozenset[str] = frozenset()
        self.state: JobState = "queued"
        self.task: asyncio.Task[JobOutcome] | None = None
        self._services = services
        self._motion_step: MotionStep | None = None
        self._chain = MotionChain(services.motion, lambda: self._steps, self._make_request)
        self._interrupt: JobInterrupted | None = None
        self._given_up: JobInterrupted | None = None
        self._noted = False
        self._over = False
        self._steps = self._make_sequence(StepOrder(job.steps, row.repeat))
        self._report = report
        self._readings = PointReadings(services.view)
        self._reports = ReportCollector(services.clock, self._store_points, self._readings)
        self._reason = ""
        self._step = row.from_step
        self._step_t0_ns = 0
        self._step_s = 0.0
        self._seen_ns: int | None = None
        """Since when its axes have been at rest without any request; None: not known."""
        self._part = 0.0
        self._doing = ""
        self._paused_by: str | None = None
        self._braked = False
        self._resumed: asyncio.Event = asyncio.Event()
        self._resumed_by = ""

    @property
    def description(self) -> str:
        """A description of the job for those that wait for it."""
        return f"job {self.row.name!r} {self.row.id} of {self.row.actor}"

    @property
    def steps_to_run(self) -> list[Step]:
        """The written steps that it runs, from the one that it begins with."""
        return [step.step for step in self._steps.order.list_remaining(self.row.from_step)]

    @property
    def members(self) -> list[str]:
        """Controllers that it can move, or whose outputs it switches on the way, to stop them all."""
        moved_controller = group_by_controller(find_axes(self._services.view.fleet, self.steps_to_run))
        outputs = [output for step in iterate_steps(self.steps_to_run) for output in step.trigger_outputs]
        return list(dict.fromkeys([*moved_controller, *map(controller_of, outputs)]))

    async def interrupt_job(self, interrupt: JobInterrupted, mode: StopMode = "decelerate") -> None:
        """Stop its axes and end it. Does nothing to a job that is ending already."""
        if self._over or self._interrupt is not None or self.task is None:
            return
        self._interrupt = interrupt
        await self._services.fleet.stop_members(self.members, mode, interrupt.actor, interrupt.reason)
        if not self._over:
            self.task.cancel()

    # Pause

    @property
    def paused_by(self) -> str | None:
        """The originator of the pause, or of a requested pause."""
        return self._paused_by

    def pause(self, actor: str) -> None:
        """Pause the job after its current step. It keeps its axes."""
        self._paused_by = actor
        self._resumed.clear()
        self._chain.prevent_release("the job was paused")
        self.publish_progress()

    async def feed_hold(self, actor: str) -> None:
        """Pause inside a motion step by a feed hold: its axes brake together, and the step continues from where they
        stand. Any other step is paused at its end."""
        self._braked = True
        if self._motion_step is not None:
            await self._motion_step.feed_hold(actor)
        await self._chain.feed_hold(actor)

    @property
    def is_on_path(self) -> bool:
        """Whether its present step is a path that a feed hold would leave: a member brakes by itself."""
        motion = self._motion_step.motion if self._motion_step is not None else None
        return motion is not None and motion.leaves_path

    async def override(self, rate: float) -> None:
        """Play the path that it moves on at another rate. Raises `Refusal`."""
        if self._motion_step is None:
            text = f"job {self.row.id} is not on a path now"
            raise Refusal("not-on-path", text, "an override is for paths; see `tutti job ls`")
        await self._motion_step.override(rate)
        self.publish_progress()

    def resume(self, actor: str) -> None:
        """Continue with the step that is interrupted by a feed hold, or the next one, or cancel a requested pause."""
        self._paused_by, self._resumed_by, self._braked = None, actor, False
        self._resumed.set()
        self.publish_progress()

    def abandon(self, interrupt: JobInterrupted) -> None:
        """Begin no further step. Motion is left to the originator of the stop."""
        self._given_up = interrupt
        self._resumed.set()

    async def _wait_while_paused(self) -> None:
        """Wait until the job is resumed, if it is paused. Raises `Interrupted` when it is ended."""
        if self._paused_by is not None and self._chain.is_prepared:
            if self._chain.is_decided and not self._braked:
                return  # it was too late to pause before that step
            await self._chain.drop("the job is paused", self.row.actor)
        while self._paused_by is not None:
            self._seen_ns = None
            first = self._step == self.row.from_step
            location = self._steps.locate(self._step if first or self._part else self._step - 1)
            place_text = f"{'in' if self._part else 'before' if first else 'after'} {location.describe(kinds=False)}"
            await self._change_state("paused", f"paused by {self._paused_by} {place_text}", self._paused_by)
            await self._resumed.wait()
            if self._given_up is not None:
                break
            await self._change_state("running", f"resumed by {self._resumed_by}", self._resumed_by)
        if self._given_up is not None:
            raise self._given_up

    # Execution

    async def run(self) -> JobOutcome:
        """Run all steps; raises nothing."""
        beat = asyncio.get_running_loop().create_task(self._publish_progress())
        try:
            outcome = await self._run_job()
        finally:
            self._over = True
            beat.cancel()
            await self._readings.wait_for_last(self._services.clock)
            self._readings.close()
            with suppress(JournalError):
                await self._reports.finish()
        if outcome.state != "done" and self._holds_axes():
            # A stop takes time to arrive, and so does its ramp: no other job gets the axes meanwhile.
            await self._wait_for_rest()
        await self._disable_by_policy()
        await self._services.leases.release(self.row.id)
        return outcome

    def make_broken_outcome(self, error: BaseException | None) -> JobOutcome:
        """The outcome of a run that could not report it itself: it ended with an error, or was cancelled."""
        ended_interrupt = self._interrupt or JobInterrupted("interrupted", "the coordinator ended", "coordinator")
        if error is not None:
            ended_interrupt = JobInterrupted("failed", f"a defect of the coordinator: {error!r}", "coordinator")
        report = self._report.model_copy(update={"steps": self._reports.reports})
        return JobOutcome(ended_interrupt.state, ended_interrupt.reason, ended_interrupt.actor, report)

    async def _run_job(self) -> JobOutcome:
        services = self._services
        self._report = self._report.model_copy(update={"started_utc": services.clock.utc()})
        state: JobState = "done"
        reason, actor = "", self.row.actor
        try:
            since_ns = await (self._prepare_approved() if self.row.proposed else self._prepare())
            self._publish_beginning()
            await self._wait_for_rest(since_ns)
            await self._enable_by_policy()
            for index in range(self.row.from_step, len(self._steps)):
                self._step, self._step_t0_ns, self._step_s = index, 0, 0.0
                self._part, self._doing = 0.0, ""
                await self._wait_while_paused()
                location, step = self._steps.locate(index), await self._steps.read_step(index)
                self._reports.begin_step(location)
                report = await self._run_step_with_pauses(index, step)
                self._seen_ns = None
                report = self._chain.complete_report(report, self._reports.last_motion)
                await self._reports.add_report(location, report, self._steps.find_target(location))
                if report.state != "done":
                    state = "aborted" if report.state == "stopped" else "failed"
                    reason = f"{location.describe()}: {report.reason}"
                    if self._interrupt is not None:
                        # Its stop has reached the step before the step was cancelled.
                        state, reason, actor = self._interrupt.state, self._interrupt.reason, self._interrupt.actor
                    break
        except asyncio.CancelledError:
            interrupt = self._interrupt or JobInterrupted("interrupted", "the coordinator ended", "coordinator")
            state, reason, actor = interrupt.state, interrupt.reason, interrupt.actor
        except JobInterrupted as given_up:
            state, reason, actor = given_up.state, given_up.reason, given_up.actor
        except (AxesInUse, PlanDeviates) as error:
            deviates = isinstance(error, PlanDeviates)
            return JobOutcome("queued", error.text, actor, self._report, begun=False, deviates=deviates)
        except Refusal as error:
            state, reason = "failed", f"not begun: {error.text}; {error.remedy}".rstrip("; ")
        except JournalError as error:
            if not self._noted:
                return JobOutcome("queued", str(error), actor, self._report, begun=False, trouble=True)
            state, reason = "failed", str(error)
            await services.fleet.stop_members(self.members, "decelerate", "coordinator", reason)
        except Exception as error:
            state, reason = "failed", f"a defect of the coordinator: {error!r}"
            await services.fleet.stop_members(self.members, "decelerate", "coordinator", reason)
        finally:
            await self._chain.drop("its job has ended", self.row.actor)
        return JobOutcome(state, reason, actor, self._report.model_copy(update={"steps": self._reports.reports}))

    async def _prepare(self) -> int:
        """Take positions and axes, and check the job; return when the axes were asked for. Raises `Refusal`,
        `AxesInUse`."""
        services = self._services
        self._take_positions()
        # Again, because the fleet may have changed since the job was accepted.
        remaining = self._steps.order.list_remaining(self.row.from_step)
        least_s = await check_job(services.view.fleet, remaining, services.motion.plan)
        services.fleet.certificates.require_until(self.needs, least_s)
        axes = find_axes(services.view.fleet, self.steps_to_run)
        since_ns = services.clock.now_ns()
        user = LeaseUser(self.row.id, self.row.actor, f"job {self.row.name!r}", self.row.session or "")
        await services.leases.acquire(user, axes)
        return since_ns

    async def _prepare_approved(self) -> int:
        """`_prepare`, for a job that may only begin with its approved plan. Its axes are taken before the plan is made:
        nothing else can move them from then on. Raises `PlanDeviates`, `AxesInUse`, `JournalError`."""
        try:
            since_ns = await self._prepare()
            await self._wait_for_rest(since_ns)
            changes = await self._find_deviation(since_ns)
            if changes:
                raise PlanDeviates(changes)
        except AxesInUse:
            raise
        except (Refusal, UnknownName) as error:
            await self._services.leases.release(self.row.id)
            # A part of the plan may be one that cannot even be determined any more.
            raise error if isinstance(error, PlanDeviates) else PlanDeviates(str(error)) from None
        return since_ns

    async def _find_deviation(self, since_ns: int) -> str:
        """What differs from the approved plan, in words; empty: nothing. Raises `Refusal`, `UnknownName`,
        `JournalError`."""
        services, row = self._services, self.row
        try:
            approval = await services.execute(services.journal.approvals.load_approval, row.id)
        except DamagedRecord:
            return "its approval in the journal is damaged"
        if approval is None or approval.void:
            return "no plan of it is approved"
        steps = list_written(self._steps.order, row.from_step)
        planned_job = PlannedJob(self.job, row.repeat, row.from_step, steps, self._report.positions_used)
        plan = await make_plan(services.view, planned_job, since_ns)
        return "" if plan.hash == approval.plan.hash else join_changes(list_changes(approval.plan, plan))

    def _publish_beginning(self) -> None:
        """Publish the job itself, for what records it."""
        services, row = self._services, self.row
        begun_job = JobBegun(
            job_id=row.id,
            name=row.name,
            actor=row.actor,
            utc=services.clock.utc(),
            epoch=services.leadership.epoch,
            repeat=row.repeat,
            from_step=row.from_step,
            positions_used=self._report.positions_used,
            job=self.job,
        )
        services.bus.put(services.keys.job_begun(row.id), begun_job.to_json(), Priority.EVENT)

    def _take_positions(self) -> None:
        """Take the values of the named positions of its targets, for the whole run. Raises `Refusal`."""
        resolver = self._services.positions.make_resolver()
        self._steps = self._make_sequence(
            resolver.resolve_remaining(self.job.steps, self.row.repeat, self.row.from_step)
        )
        self._report = self._report.model_copy(update={"positions_used": resolver.used})

    def _make_sequence(self, order: StepOrder) -> StepSequence:
        services = self._services
        return StepSequence(order, services.view.fleet, services.journal.points, services.execute)

    async def _run_step_with_pauses(self, index: int, step: Step) -> StepReport:
        """Run a step; after a feed hold it continues to the same targets from where its axes stand."""
        holds: list[FeedHold] = []
        motion = as_motion(step)
        if motion is not None:
            self._motion_step = self._chain.begin_step(index, motion)
        try:
            while True:
                report = await self._run_step(index, step)
                if report.refused is None or report.refused.code != FEED_HOLD:
                    return report.model_copy(update={"feed_holds": holds})
                await self._chain.drop("the job is paused", self.row.actor)
                if report.state == "stopped":
                    services, by = self._services, self._paused_by or self._resumed_by
                    holds.append(FeedHold(by=by, utc=services.clock.utc(), rest_skew=report.end_skew))
                    self._part = self._step_fraction()
                self._step_t0_ns = 0
                await self._wait_while_paused()
                await self._wait_for_rest()
        finally:
            self._motion_step = None

    async def _run_step(self, index: int, step: Step) -> StepReport:
        services = self._services
        began_ns = services.clock.now_ns()
        try:
            if self._motion_step is not None:
                return await self._run_motion(self._motion_step)
            services.fleet.certificates.require_until(self.needs, predict_s(services.view.fleet, step))
            await self._on_state("running", "")
            added_fields = await run_step(self._make_context(), step)
        except Refusal as error:
            services.log.warning(error.text, job=self.row.id, step=index, code=error.code)
            reason = f"{error.text}; {error.remedy}" if error.remedy else error.text
            return StepReport(
                index=index,
                do=step.kind,
                name=step.name or "",
                state="failed",
                reason=reason,
                refused=RefusalDetails.of(error),
            )
        took_s = (services.clock.now_ns() - began_ns) / NS_PER_S
        name = step.name or ""
        report = StepReport(index=index, do=step.kind, name=name, state="done", actual_s=took_s)
        return report.model_copy(update=added_fields)

    def _make_context(self) -> StepContext:
        services, row = self._services, self.row
        return StepContext(services.fleet, services.motion.targets, row.id, row.actor, self._on_progress)

    async def _run_motion(self, step: MotionStep) -> StepReport:
        """Run a motion step: behind the one before, if it is loaded there; otherwise from rest. Raises `Refusal`."""
        callbacks = _StepCallbacks(self._on_state, self._on_started)
        motion = await self._chain.wait_until_released(step)
        if motion is not None:
            return await step.run_released(motion, callbacks)
        return await step.run(callbacks, self._seen_ns)

    def _make_request(self, index: int, move: Motion) -> StepRequest:
        return StepRequest(self.row.id, self.job, index, move)

    async def _on_state(self, state: JobState, reason: str) -> None:
        await self._change_state(state, reason)
        if self._braked and state != "planning" and self._motion_step is not None:
            # The pause was requested while nothing could be braked yet.
            await self._motion_step.feed_hold(self._paused_by or "")

    def _on_progress(self, part: float, doing: str) -> None:
        self._part, self._doing = part, doing
        self.publish_progress()

    def _on_started(self, t0_fleet_ns: int, duration_s: float) -> None:
        self._step_t0_ns, self._step_s = t0_fleet_ns, duration_s
        if self._motion_step is not None and self._motion_step.motion is not None:
            self._chain.look_ahead(self._motion_step.motion)

    async def _change_state(self, state: JobState, reason: str, actor: str | None = None) -> None:
        if state == self.state and state != "planning":
            return
        services = self._services
        # Of a scan, the first point stands for all: its points have rows of their own in the journal.
        point_later = self._noted and self._steps.locate(self._step).is_later_point
        if not point_later or "paused" in (state, self.state):
            transition = services.make_transition(state, reason, actor or self.row.actor)
            await services.execute(services.journal.record_transition, self.row.id, transition)
        self.state, self._reason, self._noted = state, reason, True
        services.log.info(f"job is {state}", job=self.row.id, step=self._step, epoch=services.leadership.epoch)
        self.publish_progress()

    # Progress

    async def _publish_progress(self) -> None:
        while True:
            self.publish_progress()
            await sleep_ns(self._services.clock, PROGRESS_NS)

    def publish_progress(self) -> None:
        """Publish its progress."""
        key = self._services.keys.job_state(self.row.id)
        self._services.bus.put(key, self.make_progress().to_json(), Priority.STATE)

    @property
    def last_motion(self) -> StepReport | None:
        """The report of the last motion step that has ended."""
        return self._reports.last_motion

    def make_progress(self) -> JobProgress:
        """The progress of the job: steps done, and the fraction of the current one."""
        step_share, remaining_s = self._step_fraction(), None
        if self._step_t0_ns and self._step_s > 0:
            remaining_s = self._find_times()[1]
        location, reason = self._steps.locate(self._step), self._reason
        within_scan = location.point is not None
        rate = None if self._motion_step is None else self._motion_step.rate
        if rate is not None and rate != 1.0:
            reason = f"{reason}; " * bool(reason) + f"on its path at {rate:.0%} of the planned speed"
        if self._paused_by is not None and self.state != "paused":
            reason = f"pauses after this step: {self._paused_by}"
        return JobProgress(
            job_id=self.row.id,
            name=self.row.name,
            actor=self.row.actor,
            state=self.state,
            step=self._step,
            steps=len(self._steps),
            step_name=self._doing or location.step.name or location.step.kind,
            scan_step=location.first if within_scan else None,
            point=location.point + 1 if location.point is not None else None,
            points=None if location.scan is None else location.scan.point_count,
            fraction=min(1.0, (self._step + step_share) / len(self._steps)),
            remaining_s=remaining_s,
            override_percent=None if rate is None else round(100 * rate, 3),
            reason=reason,
            utc=self._services.clock.utc(),
        )

    def _find_times(self) -> tuple[float, float]:
        """How long the current step has moved, and how long it will, s; on a path, at its present speed."""
        times_s = None if self._motion_step is None else self._motion_step.path_times_s
        if times_s is not None:
            return times_s
        elapsed_s = (self._services.leadership.fleet_now_ns() - self._step_t0_ns) / NS_PER_S
        return elapsed_s, max(0.0, self._step_s - elapsed_s)

    def _step_fraction(self) -> float:
        """The fraction of the current step that is done: of the rest after `_part`, by time."""
        if not self._step_t0_ns or self._step_s <= 0:
            return self._part
        elapsed_s, remaining_s = self._find_times()
        return self._part + (1 - self._part) * min(1.0, max(0.0, elapsed_s) / max(elapsed_s + remaining_s, 1e-9))

    # Motors

    def _moved_axes(self) -> list[str]:
        """Axes that it moves, and that are enabled for it if the fleet file says so."""
        moves = [step for step in iterate_steps(self.steps_to_run) if step.moves]
        return find_axes(self._services.view.fleet, moves)

    async def _enable_by_policy(self) -> None:
        """Enable axes with `enable: per_job` that are not enabled. Raises `Refusal`."""
        fleet = self._services.view.fleet
        off = [
            axis for axis in self._moved_axes() if fleet.axis(axis).enable != "manual" and not self._is_enabled(axis)
        ]
        if off:
            self._seen_ns = None
            await switch_motors(self._make_context(), off, on=True)

    async def _disable_by_policy(self) -> None:
        """Disable axes with `enable: per_job`. An axis that still ramps down stays enabled, and that is logged."""
        services = self._services
        if not self._holds_axes():
            return
        per_job = [axis for axis in self._moved_axes() if services.view.fleet.axis(axis).enable == "per_job"]
        if per_job:
            try:
                await switch_motors(self._make_context(), per_job, on=False)
            except Refusal as error:
                services.log.warning(f"left enabled after the job: {error.text}", job=self.row.id)

    async def _wait_for_rest(self, since_ns: int | None = None) -> None:
        """Wait until motion that was stopped, by this job or an earlier leader or holder, has come to rest. A member
        that does not answer, or takes longer than it has declared, is waited for only that long: planning refuses
        it. since_ns: answers count from then on."""
        self._seen_ns = self._services.clock.now_ns() if since_ns is None else since_ns
        await asyncio.gather(*(self._wait_for_member_rest(member, since_ns) for member in self.members))

    async def _wait_for_member_rest(self, member: str, since_ns: int | None) -> None:
        services = self._services
        # The ramps of a step may be gentler than the limits of its axes.
        stop_ns = services.motion.stop_times_ns.get(member, 0)
        with suppress(BusError):
            stop_ns = max(stop_ns, (await services.view.query_info(member)).costs.stop_ns)
        until_ns = services.clock.now_ns() + stop_ns + REST_NS
        while services.clock.now_ns() < until_ns:
            # A member that does not answer is stopped by its guardian or its own watchdog, which takes as long.
            with suppress(BusError):
                state, since_ns = await services.view.query_state(member, since_ns), None
                # A homing that has just begun is not seen as motion yet.
                busy = any(axis.moving or axis.homing for axis in state.axes.values())
                if state.mode not in ("moving", "stopping") and not busy:
                    return
            await sleep_ns(services.clock, REST_POLL_NS)

    async def _store_points(self, points: Sequence[PointRecord]) -> None:
        journal = self._services.journal
        await self._services.execute(journal.point_rows.store_points, self.row.id, points)

    def _holds_axes(self) -> bool:
        return any(held_lease.holder == self.row.id for held_lease in self._services.leases.all_leases)

    def _is_enabled(self, axis: str) -> bool:
        controller, name = split_name(axis)
        state = self._services.view.last_state(controller)
        return state is not None and state.axes[name].enabled
