"""Other targets for the present move of one controller, while it moves."""

from adapters.abilities import RetargetDriver
from adapters.controller.slots.fleet_durations import to_host_profiles
from adapters.controller.state.armed_step import StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.leases import MotionLeases
from adapters.controller.state.limits import check_path_limits
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import RetargetReply, RetargetRequest
from orchestrator.model.steps.numbers import name_step


class MoveRetargets:
    """The retargets of the present step."""

    def __init__(
        self,
        context: ControllerContext,
        steps: LoadedSteps,
        fence: EpochFence,
        leases: MotionLeases,
        status: ControllerStatus,
    ) -> None:
        self._context = context
        self._steps = steps
        self._driver = context.driver if isinstance(context.driver, RetargetDriver) else None
        self._fence = fence
        self._leases = leases
        self._status = status

    async def retarget(self, request: RetargetRequest) -> RetargetReply:
        """Continue the present move by other profiles. Raises `Refusal`: it continues as before."""
        self._fence.require_no_estop()
        step, driver = self._steps.present, self._driver
        if driver is None:
            raise Refusal("no-retarget", "the controller cannot continue a move to another target on the way", "")
        if step is None or not step.is_for(request, request.t0_fleet_ns) or step.phase is not StepPhase.MOVING:
            raise Refusal("not-moving", f"job {request.job} {name_step(request.step)} is not being executed", "")
        if set(request.profiles) != set(step.axes):
            raise Refusal("other-axes", "other targets are for the axes of the present move", "")
        self._leases.require_lease(request.job, request.profiles)
        check_path_limits(self._status, request.profiles)
        scale = self._context.require_scale()
        profiles = to_host_profiles(request.profiles, scale)
        durations_s = await driver.retarget(profiles, request.from_s * scale.host_share)
        step.promised_s.update(durations_s)
        return RetargetReply(durations_s={axis: taken_s * (1.0 + scale.rate) for axis, taken_s in durations_s.items()})
