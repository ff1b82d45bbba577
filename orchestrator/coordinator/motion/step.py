"""A motion step: plan, negotiate, start in two phases, watch, report."""

import asyncio
from collections.abc import Callable
from fractions import Fraction
from typing import Protocol

from orchestrator.clock.executor import run_while_recording
from orchestrator.coordinator.motion.negotiation import StartAgreement, StartNegotiation
from orchestrator.coordinator.motion.planning import PlannedStep, StepRequest, plan_request
from orchestrator.coordinator.motion.recorder import StepRecorder
from orchestrator.coordinator.motion.report import judge_completed_step, make_step_report
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


class MotionStep:
    """One motion step of a job. After a feed hold, `run` again continues to the same targets."""

    def __init__(self, services: MotionServices, request: StepRequest) -> None:
        self._services = services
        self._request = request
        self._goal: dict[str, Fraction] = {}
        self._start: StartSequence | None = None
        self._movers: list[str] = []

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
            return StepReport(index=request.index, do="move", name=name, state="done", reason="already there")
        negotiation = StartNegotiation(services, planned)
        agreement = await negotiation.agree()
        stop_times_ns = {name: each.costs.stop_ns for name, each in agreement.proposals.items() if each.costs}
        services.stop_times_ns.update(stop_times_ns)
        report = await self._move(planned, negotiation, agreement, observer)
        if report.state == "done":
            for axis, (exact, counts) in planned.resolved.exact.items():
                services.targets.record_target(axis, exact, counts)
        return report

    async def feed_hold(self, actor: str) -> None:
        """Brake the step if it is being started or moving; `run` then reports it as stopped."""
        if self._start is not None and self._start.state.paused_by is None:
            self._start.state.paused_by = actor
            await self._services.fleet.stop_members(self._movers, "feed-hold", actor, f"paused by {actor}")

    async def _move(
        self, planned: PlannedStep, negotiation: StartNegotiation, agreement: StartAgreement, observer: StepObserver
    ) -> StepReport:
        """Start the members, watch them, and store what was recorded meanwhile."""
        services, request = self._services, self._request
        # Events and permits count from before arming: a stop, or the loss of a permit, may come at any moment.
        permit_watch = services.fleet.permits.watch_losses(agreement.plan.profiles)
        start = StartSequence(services, request, negotiation, agreement, permit_watch)
        watch = StepWatch(services, planned, agreement, start.state, permit_watch)
        recorder = StepRecorder(services.fleet.view, agreement.plan.profiles)
        self._start, self._movers = start, agreement.movers
        try:
            try:
                await start.run(observer.on_state)
            except Refusal:
                # A member that was stopped while it was being armed refuses for a reason of its own.
                start.require_not_paused()
                raise
            await observer.on_state("running", "")
            observer.on_started(start.state.t0_fleet_ns, agreement.plan.duration_s)
            await watch.run()
            report = await self._finish(start, watch, agreement)
        except asyncio.CancelledError:
            # The job was interrupted, and its members were stopped. Nothing stops the driver of a trigger line, which
            # would wait for T0, and refuse the next job until then.
            await start.disarm_line_driver()
            raise
        finally:
            self._start = None
            watch.close()
            recording = recorder.finish(request.index, request.move.name or "", start.state.t0_fleet_ns)
        await services.execute(services.journal.store_recording, request.job_id, recording)
        return report

    async def _finish(self, start: StartSequence, watch: StepWatch, agreement: StartAgreement) -> StepReport:
        """Stop all members if one has failed, and make the report."""
        failure, request, fleet = watch.failure, self._request, self._services.fleet
        if failure is not None:
            await fleet.stop_members(self._movers, "decelerate", request.job.actor, failure[1])
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
