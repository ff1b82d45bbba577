"""What requests that continue the present motion of one controller have in common."""

from collections.abc import Mapping

from adapters.controller.slots.fleet_durations import to_host_profiles
from adapters.controller.state.armed_step import ArmedStep
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.leases import MotionLeases
from adapters.controller.state.limits import check_path_limits
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import LoadChunkRequest, ReleaseChunkRequest, RetargetRequest
from orchestrator.model.profile import Profile
from orchestrator.model.steps.numbers import name_step


class PresentMotion:
    """The present motion of one controller."""

    def __init__(
        self,
        context: ControllerContext,
        steps: LoadedSteps,
        fence: EpochFence,
        leases: MotionLeases,
        status: ControllerStatus,
    ) -> None:
        self.context = context
        self.fence = fence
        self._steps = steps
        self._leases = leases
        self._status = status

    def find_step(self, request: LoadChunkRequest | ReleaseChunkRequest | RetargetRequest) -> ArmedStep | None:
        """The present step, if it is the one that is asked for."""
        step = self._steps.present
        return step if step is not None and step.is_for(request, request.t0_fleet_ns) else None

    def refuse_absent(self, request: LoadChunkRequest | ReleaseChunkRequest | RetargetRequest) -> Refusal:
        """The refusal where it is another one, or none."""
        return Refusal("not-moving", f"job {request.job} {name_step(request.step)} is not being executed", "")

    def take_profiles(
        self, request: LoadChunkRequest | RetargetRequest, step: ArmedStep, other_axes: str
    ) -> Mapping[str, Profile]:
        """The profiles of a request, by the clock of this computer. Raises `Refusal`: for other axes than those of the
        step, whose text is `other_axes`, without its lease, and beyond the limits."""
        if set(request.profiles) != set(step.axes):
            raise Refusal("other-axes", other_axes, "")
        self._leases.require_lease(request.job, request.profiles)
        check_path_limits(self._status, request.profiles)
        return to_host_profiles(request.profiles, self.context.require_scale())
