"""Other targets for the present move of one controller, while it moves."""

from adapters.abilities import RetargetDriver
from adapters.controller.slots.present_motion import PresentMotion
from adapters.controller.state.armed_step import StepPhase
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import RetargetReply, RetargetRequest


class MoveRetargets:
    """The retargets of the present step."""

    def __init__(self, present: PresentMotion) -> None:
        driver = present.context.driver
        self._present = present
        self._driver = driver if isinstance(driver, RetargetDriver) else None

    async def retarget(self, request: RetargetRequest) -> RetargetReply:
        """Continue the present move by other profiles. Raises `Refusal`: it continues as before."""
        present, driver = self._present, self._driver
        present.fence.require_no_estop()
        if driver is None:
            raise Refusal("no-retarget", "the controller cannot continue a move to another target on the way", "")
        step = present.find_step(request)
        if step is None or step.phase is not StepPhase.MOVING:
            raise present.refuse_absent(request)
        profiles = present.take_profiles(request, step, "other targets are for the axes of the present move")
        scale = present.context.require_scale()
        step.widen_ways(profiles, {})
        durations_s = await driver.retarget(profiles, request.from_s * scale.host_share)
        step.promised_s.update(durations_s)
        step.note_ends(profiles)
        return RetargetReply(durations_s={axis: taken_s * (1.0 + scale.rate) for axis, taken_s in durations_s.items()})
