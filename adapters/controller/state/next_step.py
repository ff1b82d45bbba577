"""The step that follows the present one: loaded while that one moves, or as soon as it has ended.

A controller with room for a second move (`Lowered.gap_ns`) holds it beside the present one, and starts it by itself
only after its release and only if the present move has ended at its target. Any other controller gets it from this
adapter as soon as the present move has ended; the promise is made after that.
"""

import asyncio
from dataclasses import dataclass, field, replace

from adapters.contract import Lowered, MoveSlot, MoveSlots
from adapters.controller.state.armed_step import ArmedStep, StepPhase
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import ArmedReply, ArmRequest, CommitRequest, StartAtOnceRequest


@dataclass(frozen=True, slots=True)
class PreparedMove:
    """A move that is lowered and can be loaded. mapping: the clock estimate that it was lowered with. began_ns: of its
    arming."""

    request: ArmRequest
    armed_step: ArmedStep
    lowered: Lowered
    mapping: TickMapping | None
    began_ns: int

    def bring_forward(self, earliest_ns: int) -> tuple[ArmedStep, int]:
        """The step as it is released for the earliest T0 from `earliest_ns` on, host time, and by how much that is
        sooner than it was loaded for: whole ticks of the controller, if it has any."""
        lowered_step, step = self.lowered, self.armed_step
        spare_ns = max(0, step.t0_host_ns - earliest_ns) if lowered_step.can_advance else 0
        advance_ns = (
            round(spare_ns // lowered_step.tick_ns * lowered_step.tick_ns) if lowered_step.tick_ns else spare_ns
        )
        t0_ns = step.t0_host_ns - advance_ns
        t0_fleet_ns = step.scale.to_fleet_ns(t0_ns) if advance_ns else step.t0_fleet_ns
        return replace(step, phase=StepPhase.RELEASED, t0_host_ns=t0_ns, t0_fleet_ns=t0_fleet_ns), advance_ns


@dataclass(slots=True)
class FollowingStep:
    """The step behind the present one.

    in_controller: the controller holds it beside the present move; otherwise the adapter loads it after that.
    checked: settings were compared while the present move runs. at_once: the request by which it starts as soon
    as it is loaded; None: it starts by an agreement.
    unloading: it is being unloaded, and does not become the present one any more.
    loaded: the result of loading, once there is one.
    """

    move: PreparedMove
    armed_step: ArmedStep
    in_controller: bool
    checked: bool = False
    at_once: StartAtOnceRequest | None = None
    unloading: bool = False
    loaded: "asyncio.Future[ArmedReply]" = field(default_factory=lambda: asyncio.get_running_loop().create_future())


class NextStepSlot:
    """The place for one following step of a controller."""

    def __init__(self, slots: MoveSlots) -> None:
        self._slots = slots
        self._following: FollowingStep | None = None
        self._behind: FollowingStep | None = None
        """The last step that the adapter loaded, or loads, behind another one."""

    @property
    def armed_step(self) -> ArmedStep | None:
        """The following step in its present phase; None if there is none."""
        return None if self._following is None else self._following.armed_step

    @armed_step.setter
    def armed_step(self, armed_step: ArmedStep) -> None:
        if self._following is not None:
            self._following.armed_step = armed_step

    @property
    def in_controller(self) -> bool:
        """Whether the controller holds the following step; without one, it is not."""
        return self._following is not None and self._following.in_controller

    def require_slot(self) -> MoveSlot:
        """Return the slot of the controller for a move beside the present one. Raises `Refusal`."""
        if self._slots.following is None:
            raise Refusal("no-next", "the controller cannot load a move while one runs", "")
        return self._slots.following

    def leaves_room(self, now_ns: int, room_ns: int) -> bool:
        """Whether each controller of the line has `room_ns` before the following step needs it; always without such a
        step."""
        following = self._following
        if following is None:
            return True
        if following.at_once is not None:
            return False
        lowered_step = following.move.lowered
        loading_ns = 0 if following.in_controller else lowered_step.costs.arm_ns
        needs_ns = (loading_ns + room_ns) * lowered_step.line_members
        return following.armed_step.t0_host_ns - now_ns >= needs_ns

    def find_waiting(self, request: CommitRequest) -> FollowingStep | None:
        """The step of the request, for the same T0, if the adapter loads it behind the one before, or has done so."""
        for waiting_move in (self._following, self._behind):
            if (
                waiting_move is not None
                and not waiting_move.in_controller
                and waiting_move.armed_step.is_for(request, request.t0_fleet_ns)
            ):
                return waiting_move
        return None

    def hold_back(
        self, move: PreparedMove, *, checked: bool, at_once: StartAtOnceRequest | None = None
    ) -> FollowingStep:
        """Keep a move until the present one has ended."""
        following = FollowingStep(move, move.armed_step, in_controller=False, checked=checked, at_once=at_once)
        self._following = following
        return following

    def note_loaded(self, move: PreparedMove) -> None:
        """The controller holds the move beside the present one."""
        self._following = FollowingStep(move, move.armed_step, in_controller=True)

    # Ends

    def take(self) -> FollowingStep | None:
        """The present move has ended as planned: the following step, which is the present one from now on. None if
        there is none, or if it is being unloaded."""
        following = self._following
        if following is None or following.unloading:
            return None
        self._following = None
        if following.in_controller:
            self._slots.advance()
        else:
            self._behind = following
        return following

    def finish_loading(self, following: FollowingStep, result: ArmedReply | Exception) -> None:
        """The adapter has loaded the step, or could not."""
        if following.loaded.done():
            return
        if isinstance(result, Exception):
            following.loaded.set_exception(result)
            following.loaded.exception()  # a promise may not be waiting for it
        else:
            following.loaded.set_result(result)

    def drop(self, reason: str) -> ArmedStep | None:
        """Forget the following step; the controller is stopped, unloaded or unreachable."""
        dropped_step = None if self._following is None else self._following.armed_step
        for following in (self._following, self._behind):
            if following is not None:
                self.finish_loading(following, Refusal("stopped", reason, ""))
        self._following = self._behind = None
        return dropped_step

    async def unload(self) -> None:
        """Unload the following step, which the caller drops after that; the present one continues."""
        following = self._following
        if following is not None and following.in_controller:
            following.unloading = True
            await self.require_slot().unload()
