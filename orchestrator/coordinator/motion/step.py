"""A motion step: plan, negotiate, start in two phases, watch, report."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import Protocol

from orchestrator.clock.executor import run_while_recording
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.motion.chain import BetweenSteps, PresentMove
from orchestrator.coordinator.motion.negotiation import StartAgreement, StartNegotiation
from orchestrator.coordinator.motion.planning import PlannedStep, StepRequest, plan_request
from orchestrator.coordinator.motion.recorder import StepRecorder
from orchestrator.coordinator.motion.report import judge_completed_step, make_step_report
from orchestrator.coordinator.motion.sampling import StepSampler
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import FEED_HOLD, StartSequence, StateCallback
from orchestrator.coordinator.motion.watch import StepWatch
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import RefusalDetails
from orchestrator.model.report import StepReport


class StepObserver(Protocol):
    """Receives the progress of a step."""

    @property
    def on_state(self) -> StateCallback:
        """Called with each new state of the job, and its reason."""
        ...

    @property
    def on_started(self) -> Callable[[int, float], None]:
        """Called with T0 (fleet ns) and the planned duration (s) once all members are released."""
        ...


async def rehearse_step(services: MotionServices, planned: PlannedStep) -> StartAgreement:
    """What the members make of a planned step: durations, budget, commands. Raises `Refusal`."""
    return await StartNegotiation(services, planned).agree()


@dataclass(frozen=True, slots=True)
class PlannedMotion:
    """A planned step that its members have agreed on, and the parts that start it and watch it."""

    planned: PlannedStep
    agreement: StartAgreement
    start: StartSequence
    watch: StepWatch

    @classmethod
    async def agree(
        cls, services: MotionServices, planned: PlannedStep, present: PresentMove | None = None
    ) -> "PlannedMotion":
        """Negotiate with the members. Raises `Refusal`. present: the moving step that it follows."""
        negotiation = StartNegotiation(services, planned, present)
        agreement = await negotiation.agree()
        stop_times_ns = {name: each.costs.stop_ns for name, each in agreement.proposals.items() if each.costs}
        services.stop_times_ns.update(stop_times_ns)
        # Events and permits count from before arming: a stop, or the loss of a permit, may come at any moment.
        permit_watch = services.fleet.permits.watch_losses(agreement.plan.profiles)
        start = StartSequence(services, planned.request, negotiation, agreement, permit_watch)
        watch = StepWatch(services, planned, agreement, start.state, permit_watch)
        return cls(planned, agreement, start, watch)

    def make_present(self, between: BetweenSteps) -> PresentMove:
        """The step as the one that another step follows; once T0 is decided."""
        t0_ns, agreement = self.start.state.t0_fleet_ns, self.agreement
        return PresentMove(
            self.planned.request.index,
            t0_ns + agreement.longest_ns(with_start=True),
            t0_ns + agreement.longest_ns(with_start=False),
            between,
        )

    async def feed_hold(self, fleet: FleetAccess, actor: str, *, begun: bool = True) -> None:
        """Prevent the start, and brake the members, once. begun: they may be moving, or about to."""
        state = self.start.state
        if state.paused_by is None:
            state.paused_by = actor
            if begun:
                await fleet.stop_members(self.agreement.movers, "feed-hold", actor, f"paused by {actor}")


class MotionStep:
    """One motion step of a job. After a feed hold, `run` again continues to the same targets."""

    def __init__(self, services: MotionServices, request: StepRequest) -> None:
        self._services = services
        self._request = request
        self._goal: dict[str, Fraction] = {}
        self._motion: PlannedMotion | None = None

    @property
    def request(self) -> StepRequest:
        """Its number, its move and its job."""
        return self._request

    @property
    def motion(self) -> PlannedMotion | None:
        """Its plan and start, once it is planned; None when it is over."""
        return self._motion

    async def run(self, observer: StepObserver, seen_ns: int | None) -> StepReport:
        """Run the step to its end; the report tells how it went. Raises `Refusal` when nothing has moved.

        seen_ns: since when nothing has been done with its axes; None: unknown.
        """
        services, request = self._services, self._request
        planned = await run_while_recording(
            observer.on_state("planning", ""), plan_request(services, request, self._goal, seen_ns)
        )
        self._goal = {axis: exact for axis, (exact, _) in planned.resolved.exact.items()}
        if not planned.plan.profiles:
            name = request.move.name or ""
            return StepReport(index=request.index, do=request.move.do, name=name, state="done", reason="already there")
        motion = self._motion = await PlannedMotion.agree(services, planned)
        recorder = StepRecorder(services.fleet.view, motion.agreement.plan.profiles)
        sampler = StepSampler(services, request)
        try:
            await sampler.begin(motion.agreement.plan.duration_s, motion.agreement.lead_ns)
            await motion.start.run(observer.on_state)
        except BaseException as error:
            self._end_motion(motion)
            recorder.close()
            if isinstance(error, Refusal):
                # A member that was stopped while it was being armed refuses for a reason of its own.
                motion.start.require_not_paused()
            else:
                await motion.start.disarm_line_driver()
            raise
        report = await self._watch_motion(motion, observer, recorder)
        return report.model_copy(update={"sampling": await sampler.take()})

    async def run_released(self, motion: PlannedMotion, observer: StepObserver) -> StepReport:
        """Watch a step that was released behind the one before it, to its end; otherwise like `run`."""
        self._motion = motion
        self._goal = {axis: exact for axis, (exact, _) in motion.planned.resolved.exact.items()}
        recorder = StepRecorder(self._services.fleet.view, motion.agreement.plan.profiles)
        return await self._watch_motion(motion, observer, recorder)

    async def feed_hold(self, actor: str) -> None:
        """Brake the step if it is being started or moving; `run` then reports it as stopped."""
        if self._motion is not None:
            await self._motion.feed_hold(self._services.fleet, actor)

    def _end_motion(self, motion: PlannedMotion) -> None:
        self._motion = None
        motion.watch.close()

    async def _watch_motion(self, motion: PlannedMotion, observer: StepObserver, recorder: StepRecorder) -> StepReport:
        """Watch the members, which are released, and store what was recorded meanwhile."""
        services, request, start = self._services, self._request, motion.start
        done: StepReport | None = None
        try:
            await observer.on_state("running", "")
            observer.on_started(start.state.t0_fleet_ns, motion.agreement.plan.duration_s)
            await motion.watch.run()
            done = report = await self._finish(start, motion.watch, motion.agreement)
        except asyncio.CancelledError:
            # The job was interrupted, and its members were stopped. Nothing stops the driver of a trigger line, which
            # would wait for T0, and refuse the next job until then.
            await start.disarm_line_driver()
            raise
        finally:
            self._end_motion(motion)
            recording = recorder.finish(request.index, request.move.name or "", start.state.t0_fleet_ns)
            for listener in services.listeners:
                listener(recording, done)
        if report.state == "done":
            for axis, (exact, counts) in motion.planned.resolved.exact.items():
                services.targets.record_target(axis, exact, counts)
        services.publisher.publish_plan(request.job_id, recording)
        await services.execute(services.journal.store_recording, request.job_id, recording)
        return report

    async def _finish(self, start: StartSequence, watch: StepWatch, agreement: StartAgreement) -> StepReport:
        """Stop all members if one has failed, and make the report."""
        failure, request, fleet = watch.failure, self._request, self._services.fleet
        if failure is not None:
            await fleet.stop_members(agreement.movers, "decelerate", request.job.actor, failure[1])
            await start.disarm_line_driver()
        elif watch.paused:
            reason = f"paused by {start.state.paused_by}"
            report = make_step_report(request, agreement, start.state, watch.reports, ("stopped", reason))
            return report.model_copy(update={"refused": RefusalDetails(code=FEED_HOLD, text=reason)})
        report = make_step_report(request, agreement, start.state, watch.reports, failure)
        if failure is not None:
            return report
        view = self._services.fleet.view
        states = {member: state for member in agreement.proposals if (state := view.last_state(member)) is not None}
        return judge_completed_step(report, agreement, states)
