"""The motion steps of one job that follow each other: what is prepared behind the present one, and what breaks it."""

from orchestrator.coordinator.jobs.run.look_ahead import ChainBreak, NumberedSteps, find_armed_terms, find_next_motion
from orchestrator.coordinator.motion.ahead import StepAhead
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.report import measure_gap_s
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import FEED_HOLD
from orchestrator.coordinator.motion.step import MotionStep, PlannedMotion
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import StepChain, StepReport
from orchestrator.model.steps.kinds import Motion
from orchestrator.plan.curved_move import straighten


class MotionChain:
    """The chain of job `job_id`."""

    def __init__(self, services: MotionServices, job_id: str, job: Job, steps: NumberedSteps) -> None:
        self._services = services
        self._job_id = job_id
        self._job = job
        self._steps = steps
        self._ahead: StepAhead | None = None
        self._after_next: StepAhead | None = None
        """The step behind the one ahead, which is planned already."""
        self._breaks: dict[int | None, str] = {}
        """Why motion steps begin from rest, by number; None: the next one, whatever its number is."""
        self._kept: int | None = None
        """The last step that began behind the one before it."""
        self._paused = False
        self._rested_ns = 0
        self.rate = 1.0
        """Of the speed of moves that are not planned yet."""

    @property
    def is_prepared(self) -> bool:
        """Whether a step is being prepared behind the present one."""
        return self._ahead is not None

    @property
    def is_decided(self) -> bool:
        """Whether the step behind the present one starts, whatever the job does now."""
        return self._ahead is not None and self._ahead.is_decided

    # Ahead

    def look_ahead(self, motion: PlannedMotion) -> None:
        """Prepare the next motion step: `motion`, the present one, moves."""
        self._ahead, self._after_next = self._after_next, None
        self._paused = False
        if self._ahead is None:
            self._ahead = self._prepare_behind(motion)
        if self._ahead is not None:
            self._ahead.allow_arming()

    def look_again(self, motion: PlannedMotion) -> None:
        """A step was added: prepare it if it is the next one behind `motion`, the present one."""
        if not motion.start.state.decided or self._paused:
            return
        if self._ahead is None:
            self.look_ahead(motion)
        elif self._after_next is None and (ahead_motion := self._ahead.released) is not None:
            self._plan_after(self._ahead, ahead_motion)

    def _plan_after(self, ahead: StepAhead, motion: PlannedMotion) -> None:
        """Plan the step behind `ahead`, which is released: only its arming waits until that one moves."""
        if ahead is self._ahead and not self._paused:
            self._after_next = self._prepare_behind(motion)

    def _prepare_behind(self, motion: PlannedMotion) -> StepAhead | None:
        """The motion step behind `motion`, being prepared; None where none can follow it."""
        fleet = self._services.fleet.view.fleet
        found_motion = find_next_motion(fleet, self._steps, motion.planned.request.index)
        if isinstance(found_motion, ChainBreak):
            self._breaks[found_motion.index] = found_motion.reason
            return None
        following = MotionStep(self._services, self._make_request(found_motion.index, found_motion.move))
        return StepAhead(self._services, following, motion, found_motion.between, self._plan_after)

    # The next step

    def begin_step(self, index: int, move: Motion) -> MotionStep:
        """The motion step `index`: the one that is prepared behind the present one, or a new one."""
        step_ahead = self._ahead
        if step_ahead is not None and step_ahead.step.request.index == index:
            return step_ahead.step
        return MotionStep(self._services, self._make_request(index, move))

    async def wait_until_released(self, step: MotionStep) -> PlannedMotion | None:
        """The start of `step` behind the one before; None: it begins from rest.

        Raises `Refusal` when it was paused, or was decided and failed."""
        step_ahead = self._ahead
        if step_ahead is None or step_ahead.step is not step:
            self._note_rest(step.request.index)
            return None
        if step_ahead.between.acts:
            acted_ns = self._services.fleet.clock.now_ns() - self._rested_ns - step_ahead.between.pause_ns
            self._services.estimator.record_acting(max(0, acted_ns))
        try:
            motion = await step_ahead.wait_until_released()
        except Refusal as error:
            self._ahead = None
            if error.code == FEED_HOLD or step_ahead.is_decided:
                raise
            self._breaks[step.request.index] = error.text
            return None
        self._ahead, self._kept = None, step.request.index
        return motion

    def _make_request(self, index: int, move: Motion) -> StepRequest:
        if self.rate < 1.0:
            move = move.slow_down(self.rate, self._services.fleet.view.fleet)
        fleet, terms = self._services.fleet.view.fleet, find_armed_terms(self._steps, index)
        return StepRequest(self._job_id, self._job, index, straighten(fleet, move), move.find_axes(fleet), terms)

    def _note_rest(self, index: int) -> None:
        """The motion step `index` begins from rest, for the reason that is known already or was found without its
        number."""
        self._breaks.setdefault(index, self._breaks.pop(None, ""))
        if self._kept == index:
            self._kept, self._breaks[index] = None, "it was braked on the way"

    # Pauses and ends

    def prevent_release(self, reason: str) -> None:
        """Let the step behind the present one not start there, unless that is decided."""
        self._paused = True
        if self._ahead is not None:
            self._ahead.prevent_release(reason)

    def starts_behind(self, step: MotionStep) -> bool:
        """Whether `step`, the present one, is still being started behind the one before it."""
        return self._ahead is not None and self._ahead.step is step

    async def settle_pause(self) -> None:
        """Wait until it is known whether the step behind the present one starts."""
        if self._ahead is not None:
            await self._ahead.settle()

    async def feed_hold(self, actor: str) -> None:
        """Brake the step behind the present one if it moves already, or prevent its start."""
        if self._ahead is not None:
            await self._ahead.feed_hold(actor)

    async def drop(self, reason: str, actor: str) -> None:
        """Unload what is prepared behind the present step; return when that is done."""
        steps_ahead = (self._after_next, self._ahead)
        self._ahead = self._after_next = None
        for step_ahead in steps_ahead:
            if step_ahead is not None:
                self._breaks[step_ahead.step.request.index] = reason
                await step_ahead.withdraw(reason, actor)

    def complete_report(self, report: StepReport, before: StepReport | None) -> StepReport:
        """The report of a step with how it followed `before`, the motion step before it."""
        if report.t0_fleet_ns is None:
            return report
        self._rested_ns = self._services.fleet.clock.now_ns()
        if before is None:
            return report
        reason = self._breaks.get(report.index, "")
        self._breaks = {at: text for at, text in self._breaks.items() if at is None or at > report.index}
        gap_s = measure_gap_s(before, report)
        chain = StepChain(step=before.index, kept=self._kept == report.index, gap_s=gap_s, broken=reason)
        return report.model_copy(update={"chain": chain})
