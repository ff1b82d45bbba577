"""The commands of a step that promise and start motion: none while an e-stop is latched; polls follow the motion."""

from adapters.controller.slots.participant import StepParticipant
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.poll_timer import PollTimer
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.messages import (
    CommitRequest,
    CommittedReply,
    GoRequest,
    Reply,
    StartAtOnceRequest,
    StartedReply,
)

NEAR_START_NS = 300 * NS_PER_MS


class StepCommands:
    """Promises and starts the steps of one controller."""

    def __init__(
        self,
        context: ControllerContext,
        fence: EpochFence,
        participant: StepParticipant,
        steps: LoadedSteps,
        timer: PollTimer,
    ) -> None:
        self._clock = context.clock
        self._fence = fence
        self._participant = participant
        self._steps = steps
        self._timer = timer

    async def commit_step(self, request: CommitRequest) -> CommittedReply:
        """Promise a step that is armed."""
        self._fence.require_no_estop()
        return await self._participant.commit_step(request)

    async def start_step(self, request: GoRequest) -> Reply:
        """Start a step that was promised."""
        self._fence.require_no_estop()
        reply = await self._participant.start_step(request)
        self._poll_motion()
        return reply

    async def start_at_once(self, request: StartAtOnceRequest) -> StartedReply:
        """Load a step, and start it as soon as the controller can."""
        self._fence.require_no_estop()
        reply = await self._participant.start_at_once(request)
        self._poll_motion()
        return reply

    def _poll_motion(self) -> None:
        """From here on the controller is polled at the rate of a moving one, so that its start is not noticed a slow
        poll later. If T0 is near, that begins at T0: before, the coordinator still sends `go` to other participants,
        and a poll would delay this host."""
        armed_step = self._steps.present
        if armed_step is not None:
            now_ns = self._clock.now_ns()
            starts_later = armed_step.t0_host_ns - now_ns > NEAR_START_NS
            self._clock.call_at_ns(now_ns if starts_later else armed_step.t0_host_ns, self._timer.wake_up)
