"""Loading of lowered moves into the slots of a controller."""

from collections.abc import Mapping

from adapters.contract import LoadPlace, MoveSlot
from adapters.controller.publishing.clock import clock_mapping
from adapters.controller.slots.fleet_durations import find_last_instants, state_move
from adapters.controller.slots.parts import StepParts
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.next_step import FollowingStep, PreparedMove
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import ArmedReply

COMPARED_NS = 2 * NS_PER_S
"""How long a comparison of settings counts for steps behind one another: what another client changes meanwhile is found
that much later."""


class StepLoader:
    """Loads the moves of one controller, after a comparison of the settings that they rely on."""

    def __init__(self, context: ControllerContext, parts: StepParts) -> None:
        self._context = context
        self._steps = parts.steps
        self._withdrawal = parts.withdrawal
        self._surveillance = parts.surveillance
        self._events = parts.events
        self._tasks = parts.tasks

    async def load_at_rest(self, move: PreparedMove, following: FollowingStep | None = None) -> ArmedReply:
        """Load the move into the controller, whose axes are at rest. following: the step before has just ended, and it
        waited for that."""
        load_place: LoadPlace = "at rest"
        if following is not None:
            load_place = "behind" if following.at_once is None else "at once"
        is_checked = following is not None and following.checked
        stages = await self.load(move, self._steps.slots.present, load_place, checked=is_checked)
        self._steps.present, self._steps.stop_ns = move.armed_step, move.lowered.costs.stop_ns
        self._steps.requested_ns = self._context.clock.now_ns()  # the commit is next
        self._tasks.spawn(self._withdrawal.unload_at_t0(move.armed_step))
        if following is not None:
            self.show_answer()
        return self.make_armed_reply(move, stages)

    def show_answer(self) -> None:
        """Publish the state of a controller that has just answered: it is not polled while steps follow each other
        closely, and would seem to be silent."""
        self._steps.polled_ns = self._context.clock.now_ns()
        self._events.publish_state()

    async def load(
        self, move: PreparedMove, slot: MoveSlot, place: LoadPlace, *, checked: bool = False
    ) -> Mapping[str, int]:
        """Load the move into `slot` after a comparison of settings, unless they are `checked`; return how long its
        stages took. Raises `Refusal`, `ControllerFault`: then it is unloaded."""
        interruptions = self._steps.interruptions
        unload = slot.unload if place == "beside" else self._steps.slots.unload
        try:
            async with self._steps.loading_lock:
                if not (checked or (place == "at once" and self._context.driver.capabilities.compares_when_loading)):
                    await self._surveillance.require_settings(0 if place == "at rest" else COMPARED_NS)
                stages = await slot.load(move.lowered, move.armed_step.t0_host_ns, move.mapping, place)
        except (Refusal, ControllerFault):
            await unload()
            raise
        if interruptions != self._steps.interruptions:
            await unload()
            raise Refusal("stopped", "a stop came while arming", "")
        return stages

    def make_armed_reply(self, move: PreparedMove, stages: Mapping[str, int]) -> ArmedReply:
        mapping, armed_step = move.mapping, move.armed_step
        last_instants = find_last_instants(move.request.start)
        statement = state_move(move.lowered, armed_step.scale, armed_step.t0_host_ns, last_instants)
        return ArmedReply(
            durations_s=statement.durations_s,
            terms=statement.terms,
            edge=statement.edge,
            triggers=statement.triggers,
            mapping=None if mapping is None else clock_mapping(self._context.controller, mapping, move.began_ns),
            began_fleet_ns=armed_step.scale.to_fleet_ns(move.began_ns),
            took_ns=self._context.clock.now_ns() - move.began_ns,
            stages_ns=dict(stages),
        )
