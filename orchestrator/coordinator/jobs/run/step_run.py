"""The present step of a job: run once, or in parts with pauses between them."""

from collections.abc import Callable
from dataclasses import dataclass

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.zone_reservations import ZONE_BUSY
from orchestrator.coordinator.jobs.check import predict_s
from orchestrator.coordinator.jobs.run.held_probe import HeldProbes
from orchestrator.coordinator.jobs.run.job_axes import JobAxes
from orchestrator.coordinator.jobs.run.measured_contacts import MeasuredContacts
from orchestrator.coordinator.jobs.run.motion_chain import MotionChain
from orchestrator.coordinator.jobs.run.retargets import RETARGETED, StepRetargets
from orchestrator.coordinator.jobs.run.run_state import JobPause, RunState
from orchestrator.coordinator.jobs.run.zone_wait import ZoneWait
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.motion.start import FEED_HOLD, StateCallback
from orchestrator.coordinator.motion.step import MotionStep
from orchestrator.coordinator.steps.context import StepContext
from orchestrator.coordinator.steps.kinds import run_step
from orchestrator.model.errors import NOT_REFERENCED, SETTING_CHANGED, Refusal
from orchestrator.model.jobs.service import JobRetargeted, RetargetJob
from orchestrator.model.messages import RefusalDetails
from orchestrator.model.report import FeedHold, JobState, StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.tree import as_held_probe, as_motion
from orchestrator.plan.flying.path import FlightPath


@dataclass(frozen=True, slots=True)
class _StepCallbacks:
    """What a motion step reports to its job."""

    on_state: StateCallback
    on_started: Callable[[int, float], None]


class StepRun:
    """Runs the steps of a job one after the other. context: what the steps that do not move use."""

    def __init__(
        self, services: JobServices, context: StepContext, state: RunState, chain: MotionChain, axes: JobAxes
    ) -> None:
        self._services = services
        self._context = context
        self._state = state
        self._pause = state.pause
        self._chain = chain
        self._retargets = StepRetargets(services, state, chain)
        self._axes = axes
        self._rest = axes.rest
        self._contacts = MeasuredContacts(services.view)
        self._zone_wait = ZoneWait(
            services.motion.zone_reservations, state, services.clock, context.holder, now=state.is_urgent
        )
        self._held_probes = HeldProbes(services, context, state, chain)

    async def retarget(self, request: RetargetJob) -> JobRetargeted:
        """Send the axes of the present move to other targets. Raises `Refusal`: nothing has changed."""
        return await self._retargets.retarget(request)

    async def wait_while_paused(self) -> None:
        """Wait until the job is resumed, if it is paused. Raises `JobInterrupted` when it is ended."""
        pause, state = self._pause, self._state
        if pause.paused_by is not None and self._chain.is_prepared:
            await self._chain.settle_pause()
            if self._chain.is_decided and not pause.braked:
                return  # it was too late to pause before that step
            await self._chain.drop("the job is paused", self._context.actor)
        while pause.paused_by is not None:
            self._rest.seen_ns = None
            await state.change_state("paused", _describe_pause(pause, state.describe_place()), pause.paused_by)
            await pause.resumed.wait()
            if self._pause.given_up is not None:
                break
            await state.change_state("running", f"resumed by {pause.resumed_by}", pause.resumed_by)
        if self._pause.given_up is not None:
            raise self._pause.given_up

    async def run_step(self, index: int, step: Step) -> StepReport:
        """Run a step; after a feed hold it continues to the same targets from where its axes stand, after a retarget to
        the new ones."""
        try:
            step = await self._contacts.fill_measured(step)
        except Refusal as error:
            return self._fail(index, step, error)
        report = await self._run_filled(index, step)
        self._contacts.take_report(step, report)
        return report

    async def _run_filled(self, index: int, step: Step) -> StepReport:
        holds: list[FeedHold] = []
        waited_codes = {SETTING_CHANGED}
        motion = as_motion(step)
        self._retargets.begin_step()
        if motion is not None:
            self._state.motion_step = self._chain.begin_step(index, motion)
        try:
            while True:
                report = await self._run_in_turn(index, step)
                refused_code = None if report.refused is None else report.refused.code
                if refused_code in waited_codes and report.state == "failed":
                    waited_codes.add(NOT_REFERENCED)  # by the change, if not by what ends it
                    await self._wait_for_cause(report.reason)
                    continue
                is_retargeted = await self._retargets.continue_step(report)
                # Of a flight that was braked, the scan flies again what was disturbed.
                if isinstance(step, FlightPath) or (refused_code != FEED_HOLD and not is_retargeted):
                    return report.model_copy(update={"feed_holds": holds, "retargets": self._retargets.entries})
                is_held = self._pause.braked or not is_retargeted
                await self._chain.drop("the job is paused" if is_held else RETARGETED, self._context.actor)
                if report.state == "stopped" and is_held:
                    services, by = self._services, self._pause.paused_by or self._pause.resumed_by
                    holds.append(FeedHold(by=by, utc=services.clock.utc(), rest_skew=report.end_skew))
                self._state.note_hold(is_moved=report.state == "stopped")
                if is_held:  # a pause at the end of the step comes there
                    await self.wait_while_paused()
                await self._rest.wait_for_rest()
        finally:
            self._state.motion_step = None
            self._zone_wait.end(index)

    async def _wait_for_cause(self, cause: str) -> None:
        """Wait at a step that was refused because another client has changed a setting: nothing of it has moved, and a
        person resumes the job once the setting is as before, and the axis homed where its reference was lost. Until
        then commands of persons may use the axes. Raises `JobInterrupted`."""
        job_id = self._context.holder
        await self._chain.drop("a setting was changed", self._context.actor)
        while cause:
            self._pause.request_pause("coordinator", f"{cause}; then `tutti job resume {job_id}`")
            await self._axes.give_back()
            await self.wait_while_paused()
            try:
                await self._axes.take()
                cause = ""
            except Refusal as refusal:
                cause = f"{refusal.text}; {refusal.remedy}" if refusal.remedy else refusal.text
        await self._rest.wait_for_rest()

    async def _run_in_turn(self, index: int, step: Step) -> StepReport:
        """Run a step; where a zone refuses it beside another job, again when that has moved on."""
        while True:
            report = await self._run_once(index, step)
            if report.refused is None or report.refused.code != ZONE_BUSY:
                return report
            obstacle = await self._zone_wait.wait(report.reason)
            if obstacle:
                return report.model_copy(update={"reason": f"{report.reason}; {obstacle}"})
            await self.wait_while_paused()

    async def _run_once(self, index: int, step: Step) -> StepReport:
        services = self._services
        began_ns = services.clock.now_ns()
        try:
            if self._state.motion_step is not None:
                return await self._run_motion(self._state.motion_step)
            services.fleet.certificates.require_until(self._state.needs, predict_s(services.view.fleet, step))
            held_probe = as_held_probe(step)
            if held_probe is not None:
                return await self._held_probes.run(index, held_probe, self._state.change_state)
            await self._on_state("running", "")
            added_fields = await run_step(self._context, step)
        except Refusal as error:
            return self._fail(index, step, error)
        took_s = (services.clock.now_ns() - began_ns) / NS_PER_S
        name = step.name or ""
        report = StepReport(index=index, do=step.kind, name=name, state="done", actual_s=took_s)
        return report.model_copy(update=added_fields)

    def _fail(self, index: int, step: Step, error: Refusal) -> StepReport:
        self._services.log.warning(error.text, job=self._context.holder, step=index, code=error.code)
        reason = f"{error.text}; {error.remedy}" if error.remedy else error.text
        return StepReport(
            index=index,
            do=step.kind,
            name=step.name or "",
            state="failed",
            reason=reason,
            refused=RefusalDetails.of(error),
        )

    async def _run_motion(self, step: MotionStep) -> StepReport:
        """Run a motion step: behind the one before, if it is loaded there; otherwise from rest. Raises `Refusal`."""
        callbacks = _StepCallbacks(self._on_state, self._on_started)
        motion = await self._chain.wait_until_released(step)
        if motion is not None:
            return await step.run_released(motion, callbacks)
        return await step.run(callbacks, self._rest.seen_ns)

    async def _on_state(self, state: JobState, reason: str) -> None:
        step = self._state.motion_step
        if step is None or state == "planning":
            await self._state.change_state(state, reason)
        else:
            self._state.note_state(state, reason)
        if step is not None and state != "planning" and (self._pause.braked or step.is_retargeted):
            # The pause or the retarget was requested while nothing could be braked yet.
            await step.feed_hold(self._pause.paused_by or self._context.actor)

    def _on_started(self, t0_fleet_ns: int, duration_s: float) -> None:
        self._state.note_start(t0_fleet_ns, duration_s)
        self._retargets.note_start(t0_fleet_ns)
        step = self._state.motion_step
        if step is not None and step.motion is not None:
            self._chain.look_ahead(step.motion)
            if self._pause.paused_by is not None:
                self._chain.prevent_release("the job was paused")  # before this step was started


def _describe_pause(pause: JobPause, place: str) -> str:
    return f"waits {place} for: {pause.cause}" if pause.cause else f"paused by {pause.paused_by} {place}"
