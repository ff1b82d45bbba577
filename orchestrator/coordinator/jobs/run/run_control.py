"""What users change about a running job: pauses, overrides, other targets, the start of what waits armed."""

from orchestrator.coordinator.jobs.run.motion_chain import MotionChain
from orchestrator.coordinator.jobs.run.run_state import RunState
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.run.step_run import StepRun
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobRetargeted, RetargetJob


class RunControl:
    """Changes the run of job `row`."""

    def __init__(
        self, row: JobRecord, steps: StepSequence, state: RunState, chain: MotionChain, step_run: StepRun
    ) -> None:
        self._row = row
        self._steps = steps
        self._state = state
        self._chain = chain
        self._step_run = step_run

    @property
    def paused_by(self) -> str | None:
        """The originator of the pause, or of a requested pause."""
        return self._state.pause.paused_by

    def pause(self, actor: str) -> None:
        """Pause the job after its current step. It keeps its axes."""
        self._state.pause.request_pause(actor)
        self._chain.prevent_release("the job was paused")
        start = None if self._state.motion_step is None else self._state.motion_step.armed_start
        if start is not None:
            start.pause(actor)
        self._state.publish_progress()

    async def feed_hold(self, actor: str) -> None:
        """Pause inside a motion step by a feed hold: its axes brake together, and the step continues from where they
        stand. Any other step is paused at its end."""
        self._state.pause.braked = True
        if self._state.motion_step is not None:
            await self._state.motion_step.feed_hold(actor)
        await self._chain.feed_hold(actor)

    @property
    def is_on_path(self) -> bool:
        """Whether its present step is a path that a feed hold would leave: a member brakes by itself."""
        step = self._state.motion_step
        motion = step.motion if step is not None else None
        return motion is not None and motion.leaves_path

    async def override(self, rate: float) -> None:
        """Play the path that it moves on at another rate; elsewhere, plan the moves that follow for it. Raises
        `Refusal`."""
        step = self._state.motion_step
        if step is not None and step.is_path:
            await step.override(rate)
        elif rate > 1.0:
            text = "a move is planned at the limits that its speed states, and cannot be faster"
            raise Refusal("override", text, "moves can be slowed down, to 10 to 100 %")
        else:
            self._chain.rate = self._state.rate = rate
            if self._chain.is_prepared and not self._chain.is_decided:
                await self._chain.drop("its speed was changed", self._row.actor)
        self._state.publish_progress()

    async def retarget(self, request: RetargetJob) -> JobRetargeted:
        """Send the axes of the move that it executes to other targets. Raises `Refusal`: nothing has changed."""
        if self._row.proposed:
            text = f"the plan of job {self._row.id} was approved with the targets that it has"
            raise Refusal("approved", text, "stop it, and submit a job with other targets")
        if self._steps.locate(self._state.step).scan is not None:
            raise Refusal("not-a-move", "the present move is a point of a scan", "wait for its end, or stop it")
        return await self._step_run.retarget(request)

    async def go(self, at_fleet_ns: int | None) -> int:
        """Start the step that waits armed, at that instant or as soon as all members can; return T0, fleet time. Raises
        `Refusal`."""
        start = None if self._state.motion_step is None else self._state.motion_step.armed_start
        if start is None:
            text = f"job {self._row.id} has no step that waits armed; it is {self._state.state}"
            raise Refusal("not-armed", text, "put `do: wait_armed` before a move of it")
        return await start.go(at_fleet_ns)

    def resume(self, actor: str) -> None:
        """Continue with the step that is interrupted by a feed hold, or the next one, or cancel a requested pause."""
        self._state.pause.resume(actor)
        self._state.publish_progress()
