"""What must hold before profiles are executed."""

from adapters.controller.state.fencing import EpochFence
from adapters.controller.state.leases import MotionLeases
from adapters.controller.state.limits import check_path_limits, check_profiles
from adapters.controller.state.status import ControllerStatus
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import ArmRequest, ProposeRequest


class StepChecks:
    """Checks the steps of one controller."""

    def __init__(self, config: Controller, fence: EpochFence, status: ControllerStatus, leases: MotionLeases) -> None:
        self._config = config
        self._fence = fence
        self._status = status
        self._leases = leases

    def check_step(self, request: ProposeRequest | ArmRequest) -> None:
        """Check everything that must hold before profiles are executed. Raises `Refusal`."""
        if isinstance(request, ProposeRequest) and request.rehearsal:
            self._status.require_online()
            self._require_same_digest(request)
            check_path_limits(self._status, request.profiles)
            return
        self._require_may_move(request)
        drives = request.start.drive is not None or bool(request.start.triggers)
        check_profiles(self._status, request.profiles, drives=drives)

    def check_following_step(self, request: ProposeRequest | ArmRequest) -> None:
        """Check the same for profiles that begin where the present step ends. Raises `Refusal`."""
        self._require_may_move(request)
        check_path_limits(self._status, request.profiles)

    def _require_may_move(self, request: ProposeRequest | ArmRequest) -> None:
        self._fence.require_no_estop()
        status = self._status
        status.require_online()
        self._require_same_digest(request)
        if isinstance(request, ArmRequest):
            self._leases.require_lease(request.job, request.profiles)
        if status.moved_singly:
            activity = "homing" if status.homing else "jogging" if status.jogging else "probing"
            raise Refusal(activity, f"{min(status.moved_singly)} is {activity}", "wait for its end")
        status.require_no_fault()

    def _require_same_digest(self, request: ProposeRequest | ArmRequest) -> None:
        if request.digest != self._config.digest:
            raise Refusal(
                "other-configuration",
                f"the coordinator uses configuration {request.digest}, the adapter {self._config.digest}",
                "use the same fleet file on all hosts and restart",
            )
