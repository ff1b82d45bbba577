"""Execution of one job: its steps one after the other, its pauses, its end, and its report."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress

from orchestrator.clock.owner import running
from orchestrator.coordinator.fleet.leases import AxesInUse
from orchestrator.coordinator.jobs.run.flight_rows import FlightRows
from orchestrator.coordinator.jobs.run.flight_run import FlightRun
from orchestrator.coordinator.jobs.run.job_axes import JobAxes
from orchestrator.coordinator.jobs.run.live_sequence import LiveSequence, make_sequence
from orchestrator.coordinator.jobs.run.motion_chain import MotionChain
from orchestrator.coordinator.jobs.run.motors import JobMotors
from orchestrator.coordinator.jobs.run.outcome import JobInterrupted, JobOutcome
from orchestrator.coordinator.jobs.run.point_feed import PointFeed, PointPublisher
from orchestrator.coordinator.jobs.run.point_readings import PointReadings
from orchestrator.coordinator.jobs.run.preparation import JobPreparation, PlanDeviates, SettingsDiffer
from orchestrator.coordinator.jobs.run.report_collector import ReportCollector
from orchestrator.coordinator.jobs.run.rest import RestMonitor
from orchestrator.coordinator.jobs.run.run_control import RunControl
from orchestrator.coordinator.jobs.run.run_state import RunState
from orchestrator.coordinator.jobs.run.step_run import StepRun
from orchestrator.coordinator.jobs.run.step_turns import StepTurns
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.journal.records import JobRecord, JournalError
from orchestrator.coordinator.steps.context import StepContext
from orchestrator.model.errors import Refusal, shorten_text
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import StopMode
from orchestrator.model.report import JobProgress, JobReport, JobState, PointRecord, StepReport
from orchestrator.model.steps.order import StepPlace
from orchestrator.plan.flying.path import FlightPath


class JobRun:
    """The execution of job `row`. needs: controllers that no other job may use meanwhile."""

    def __init__(
        self, services: JobServices, row: JobRecord, job: Job, report: JobReport, needs: frozenset[str]
    ) -> None:
        self.row = row
        self.job = job
        self.task: asyncio.Task[JobOutcome] | None = None
        self._services = services
        self._steps = make_sequence(services, row, job, self._prepare_added)
        self._state = RunState(services, row, self._steps, needs)
        self._turns = StepTurns(self._steps, self._state, is_open=job.is_open)
        self._rest = RestMonitor(services, self._steps, row.from_step)
        self._motors = JobMotors(services, row, self._steps)
        axes = JobAxes(services, row, self._steps, self._rest)
        self._preparation = JobPreparation(services, row, job, self._steps, axes)
        self._chain = MotionChain(services.motion, row.id, job, self._steps)
        self._context = StepContext(
            services.fleet,
            services.motion.targets,
            services.positions,
            services.motion.zones,
            row.id,
            row.actor,
            services.clock.now_ns(),
            self._state.note_part,
        )
        self._step_run = StepRun(services, self._context, self._state, self._chain, axes)
        self.control = RunControl(row, self._steps, self._state, self._chain, self._step_run)
        self._interrupt: JobInterrupted | None = None
        self._over = False
        self._report = report
        self._readings = PointReadings(services.view)
        publisher = PointPublisher(services.bus, services.keys, row.id)
        self._points = PointFeed(services.clock, publisher.publish_rows, self._store_points)
        self._reports = ReportCollector(services.clock, self._points, self._readings)

    @property
    def state(self) -> JobState:
        """Its state."""
        return self._state.state

    @property
    def needs(self) -> frozenset[str]:
        """Controllers that no other job may use meanwhile."""
        return self._state.needs

    @property
    def lends_axes(self) -> bool:
        """Whether it waits for a person, whose commands may use its axes meanwhile."""
        return self._state.pause.lends_axes

    @property
    def description(self) -> str:
        """A description of the job for those that wait for it."""
        return f"job {self.row.name!r} {self.row.id} of {self.row.actor}"

    @property
    def live_steps(self) -> LiveSequence | None:
        """The steps that it was asked for, if it is a live job."""
        return self._steps if isinstance(self._steps, LiveSequence) else None

    @property
    def unwritten_points(self) -> list[PointRecord]:
        """The rows of points that are not in the journal yet."""
        return self._points.unwritten

    @property
    def last_motion(self) -> StepReport | None:
        """The report of the last motion step that has ended."""
        return self._reports.last_motion

    def make_progress(self) -> JobProgress:
        """The progress of the job: steps done, and the fraction of the current one."""
        return self._state.make_progress()

    async def interrupt_job(self, interrupt: JobInterrupted, mode: StopMode = "decelerate") -> None:
        """Stop its axes and end it. Does nothing to a job that is ending already."""
        if self._over or self._interrupt is not None or self.task is None:
            return
        self._interrupt = interrupt
        if not self.lends_axes:  # what moves them now is not the job
            await self._services.fleet.stop_members(self._rest.members, mode, interrupt.actor, interrupt.reason)
        if not self._over:
            self.task.cancel()

    async def stop_motion(self, reason: str, actor: str) -> None:
        """Stop the present motion, and unload what is prepared behind it. The job goes on."""
        await self._chain.drop(reason, actor)
        if self._state.motion_step is not None:
            await self._services.fleet.stop_members(self._rest.members, "decelerate", actor, reason)

    def abandon(self, interrupt: JobInterrupted) -> None:
        """Begin no further step. Motion is left to the originator of the stop."""
        self._state.pause.give_up(interrupt)
        self._steps.end()

    # Execution

    async def run(self) -> JobOutcome:
        """Run all steps; raises nothing."""
        reservations = self._services.motion.zone_reservations
        reservations.enter(self.row.id)
        try:
            async with running(self._state.keep_publishing()):
                outcome = await self._run_job()
        finally:
            await self._readings.wait_for_last(self._services.clock)
            self._readings.close()
            with suppress(JournalError):
                await self._reports.finish()
        if outcome.state != "done" and self._holds_axes():
            # A stop takes time to arrive, and so does its ramp: no other job gets the axes meanwhile.
            await self._rest.wait_for_rest()
        if self._holds_axes():
            await self._motors.disable_by_policy(self._context)
        await self._services.leases.release(self.row.id)
        reservations.leave(self.row.id)
        return outcome

    def make_broken_outcome(self, error: BaseException | None) -> JobOutcome:
        """The outcome of a run that could not report it itself: it ended with an error, or was cancelled."""
        ended_interrupt = self._interrupt or JobInterrupted("interrupted", "the coordinator ended", "coordinator")
        if error is not None:
            ended_interrupt = JobInterrupted("failed", f"a defect of the coordinator: {error!r}", "coordinator")
        reason = shorten_text(ended_interrupt.reason)
        return JobOutcome(ended_interrupt.state, reason, ended_interrupt.actor, self._make_report())

    def _make_report(self) -> JobReport:
        return self._report.model_copy(update={"steps": self._reports.reports})

    async def _run_job(self) -> JobOutcome:
        services = self._services
        self._report = self._report.model_copy(update={"started_utc": services.clock.utc()})
        state: JobState = "done"
        reason, actor = "", self.row.actor
        try:
            try:
                await self._prepare()
                failed_step = await self._run_steps()
            finally:
                # A stop that has ended the last step may still wait for the answer of a member: it cuts nothing off.
                self._over = True
            if failed_step is not None:
                index, report = failed_step
                state = "aborted" if report.state == "stopped" else "failed"
                reason = f"{self._steps.locate(index).describe()}: {report.reason}"
                if self._interrupt is not None:
                    # Its stop has reached the step before the step was cancelled.
                    state, reason, actor = self._interrupt.state, self._interrupt.reason, self._interrupt.actor
        except asyncio.CancelledError:
            interrupt = self._interrupt or JobInterrupted("interrupted", "the coordinator ended", "coordinator")
            state, reason, actor = interrupt.state, interrupt.reason, interrupt.actor
        except JobInterrupted as given_up:
            state, reason, actor = given_up.state, given_up.reason, given_up.actor
        except (AxesInUse, PlanDeviates, SettingsDiffer) as error:
            deviates = isinstance(error, PlanDeviates)
            return JobOutcome("queued", error.text, actor, self._report, begun=False, deviates=deviates)
        except Refusal as error:
            state, reason = "failed", f"not begun: {error.text}; {error.remedy}".rstrip("; ")
        except JournalError as error:
            if not self._state.is_recorded:
                return JobOutcome("queued", str(error), actor, self._report, begun=False, trouble=True)
            state, reason = "failed", str(error)
            await services.fleet.stop_members(self._rest.members, "decelerate", "coordinator", reason)
        except Exception as error:
            state, reason = "failed", f"a defect of the coordinator: {error!r}"
            await services.fleet.stop_members(self._rest.members, "decelerate", "coordinator", reason)
        finally:
            await self._chain.drop("its job has ended", self.row.actor)
            self._steps.drop_waiting("its job has ended")
        # A reason that its record does not take would leave the job without an end.
        return JobOutcome(state, shorten_text(reason), actor, self._make_report())

    async def _run_steps(self) -> tuple[int, StepReport] | None:
        """Run all steps; return the number and the report of one that ends the job before its last one. Raises
        `JournalError`, `JobInterrupted`."""
        async for index in self._turns.iterate(self.row.from_step):
            self._state.begin_step(index)
            await self._step_run.wait_while_paused()
            report = await self._run_numbered_step(index)
            if not self._steps.note_report(index, report):
                return index, report
            if report.state != "done":
                await self._chain.drop("the move before it was not done", self.row.actor)
                await self._rest.wait_for_rest()
        return None

    async def _prepare(self) -> None:
        """Do all that comes before the first step. Raises `Refusal`, `AxesInUse`, `PlanDeviates`, `SettingsDiffer`,
        `JournalError`."""
        preparation = self._preparation
        try:
            prepare = preparation.prepare_approved if self.row.proposed else preparation.prepare
            since_ns = await prepare(self.needs)
        finally:
            self._report = self._report.model_copy(update={"positions_used": preparation.positions_used})
        await self._rest.wait_for_rest(since_ns)
        await preparation.compare_settings()
        await preparation.publish_beginning()
        if await self._motors.enable_by_policy(self._context):
            self._rest.seen_ns = None

    def _prepare_added(self) -> None:
        """A step was added: it may be the one that follows the present motion."""
        step = self._state.motion_step
        if step is not None and step.motion is not None:
            self._chain.look_again(step.motion)

    async def _run_numbered_step(self, index: int) -> StepReport:
        """Run step number `index`, and record its report. Raises `JournalError`, `JobInterrupted`."""
        location, step = self._steps.locate(index), await self._steps.read_step(index)
        self._reports.begin_step(location)
        if isinstance(step, FlightPath):
            return await self._run_flight(location, step)
        report = await self._step_run.run_step(index, step)
        self._rest.seen_ns = None
        report = self._chain.complete_report(report, self._reports.last_motion)
        lines = self._steps.find_lines(location)
        if lines is not None:
            await self._reports.add_line_report(location, report, lines, self._steps.flights.find_begin(location))
            return report
        target = report.retargets[-1].to if report.retargets else self._steps.find_target(location)
        await self._reports.add_report(location, report, target)
        return report

    async def _run_flight(self, place: StepPlace, step: FlightPath) -> StepReport:
        """Run lines of a scan in one motion, and give out their rows meanwhile. Raises `JournalError`,
        `JobInterrupted`."""
        flight = FlightRows(self._services.motion, place, step.part)
        self._state.flight = flight
        following = FlightRun(self._services, self._state, self._reports, flight)
        try:
            async with following.running():
                report = await self._step_run.run_step(place.index, step)
        finally:
            self._state.flight = None
        self._rest.seen_ns = None
        return await following.finish(self._steps.flights, place, report)

    async def _store_points(self, points: Sequence[PointRecord]) -> None:
        journal = self._services.journal
        await self._services.execute(journal.point_rows.store_points, self.row.id, points)

    def _holds_axes(self) -> bool:
        return any(held_lease.holder == self.row.id for held_lease in self._services.leases.all_leases)
