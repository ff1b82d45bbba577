"""The ways out of a step: unloaded before it starts, stopped, failed, or lost with the link."""

from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.slots.step_events import StepEvents
from adapters.controller.state.armed_step import ArmedStep, StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import QUIET_AFTER_REQUEST_NS, LoadedSteps
from orchestrator.clock.base import NS_PER_MS, sleep_until_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import DisarmedReply, DisarmRequest
from orchestrator.model.state import EventKind

STOP_LEAD_NS = 10 * NS_PER_MS  # this long before T0 a stop still takes effect before T0
EARLY_NS = 2 * NS_PER_MS  # this long before T0, and from then on, a released step may have begun


class StepWithdrawal:
    """Withdraws the steps of one controller. Interruptions do not wait for a transition that is under way."""

    def __init__(
        self, context: ControllerContext, steps: LoadedSteps, settling: SettlingMonitor, events: StepEvents
    ) -> None:
        self._context = context
        self._steps = steps
        self._settling = settling
        self._events = events

    # On request

    async def disarm_step(self, request: DisarmRequest) -> DisarmedReply:
        """Unload the step if it is the one that is loaded. A moving step stays untouched."""
        if request.if_waiting and not self._is_waiting(request):
            return DisarmedReply()
        present, following = self._steps.present, self._steps.following.armed_step
        if following is None and present is not None and present.job == request.job and present.step != request.step:
            async with self._steps.transition_lock:  # it may be being loaded behind the present one
                following = self._steps.following.armed_step
        if following is not None and following.is_for(request):
            return await self._disarm_following(request, following)
        armed_step = self._steps.present
        if armed_step is not None and not armed_step.is_for(request):
            return DisarmedReply()  # another job's step, which is still in use
        has_begun = await self._interrupt_transition(armed_step)
        async with self._steps.transition_lock:
            armed_step = self._steps.present
            if armed_step is None:
                await self.unload_step()
                return DisarmedReply(may_have_started=has_begun)
            if armed_step.phase is StepPhase.MOVING:
                raise Refusal("moving", "the step is already moving", "stop it")
            self._steps.interruptions += 1
            self._steps.present = None
            if armed_step.phase is StepPhase.RELEASED:
                # T0 may be at this very moment: a move that can no longer be unloaded must not run either.
                await self.stop_driver()
            await self.unload_step()
            self._events.emit_step("disarmed", "disarmed on request", armed_step)
            return DisarmedReply(may_have_started=has_begun)

    def _is_waiting(self, request: DisarmRequest) -> bool:
        """Whether the step can be unloaded for certain before it starts."""
        present, following = self._steps.present, self._steps.following.armed_step
        if following is not None and following.is_for(request):
            is_near = self._context.clock.now_ns() + STOP_LEAD_NS >= following.t0_host_ns
            return following.phase is not StepPhase.RELEASED or not is_near
        return present is not None and present.is_for(request) and present.phase is StepPhase.LOADING

    async def _interrupt_transition(self, armed_step: ArmedStep | None) -> bool:
        """Interrupt a `go`, or the loading of a step that starts at once; whether the step may have begun."""
        if armed_step is None or armed_step.phase not in (StepPhase.LOADING, StepPhase.RELEASED):
            return False
        self._steps.interruptions += 1
        if armed_step.phase is StepPhase.LOADING:
            return False
        # This bypasses a `go` that is still under way, because T0 is near.
        has_begun = self._context.clock.now_ns() + STOP_LEAD_NS >= armed_step.t0_host_ns
        await self.stop_driver()
        return has_begun

    async def unload_released(self, released: ArmedStep) -> bool:
        """Unload a released step behind the present one, or stop both if its start is too near for that; return whether
        it may have started."""
        if self._context.clock.now_ns() + STOP_LEAD_NS >= released.t0_host_ns:
            await self.stop("the following step was withdrawn at its start", abort=False)
            return True
        self._steps.interruptions += 1
        await self._steps.following.unload()
        if released.is_same(self._steps.present):
            await self._steps.slots.unload()  # it has become the present one meanwhile
            self._steps.present = None
            self._events.emit_step("disarmed", "withdrawn before its start", released)
        elif (
            self._steps.following.armed_step is not None
            and self._context.clock.now_ns() + EARLY_NS >= released.t0_host_ns
        ):
            await self.stop("the following step was withdrawn at its start", abort=False)  # unloading took too long
            return True
        else:
            self.drop_following("disarmed", "withdrawn before its start")
        return False

    async def _disarm_following(self, request: DisarmRequest, following: ArmedStep) -> DisarmedReply:
        """Unload the following step; the present one continues, unless the start of the following one is so near that
        only a stop prevents it for certain."""
        if following.phase is StepPhase.RELEASED:
            return DisarmedReply(may_have_started=await self.unload_released(following))
        self._steps.interruptions += 1
        await self._steps.following.unload()
        if self._steps.following.armed_step is not following:
            return await self.disarm_step(request)  # it was stopped meanwhile
        self.drop_following("disarmed", "disarmed on request")
        return DisarmedReply()

    # By events

    async def stop(self, reason: str, *, abort: bool, follow: bool = False) -> None:
        """Stop the controller now, whatever it does; nothing that is loaded starts afterwards.

        follow: the end of a moving step is reported once it is at rest, with its evidence."""
        self._steps.interruptions += 1
        self._steps.requested_ns = -QUIET_AFTER_REQUEST_NS
        if follow and self._steps.present is not None and self._steps.present.phase is StepPhase.MOVING:
            self.drop_following("stopped", reason)
            self._steps.present.ways.clear()  # the ramp of a stop may end beyond them
            await self.stop_driver(abort=abort)
            return
        armed_step, self._steps.present = self._steps.present, None
        following = self._steps.following.drop(reason)
        await self.stop_driver(abort=abort)
        for step in (armed_step, following):
            if step is not None:
                self._events.emit_step("stopped", reason, step)

    async def abandon_step(self, reason: str) -> None:
        """Handle the loss of the coordinator: unload what has not started, stop what moves."""
        armed_step = self._steps.present
        if armed_step is None:
            return
        if armed_step.executes:
            await self.stop(abort=False, reason=reason)
            return
        self._steps.interruptions += 1
        self._steps.present = None
        await self.unload_step()
        self._events.emit_step("disarmed", reason, armed_step)

    async def unload_step(self) -> None:
        """Unload the step. If the link is lost meanwhile, the result is unknown: the stop stays pending."""
        self._steps.stop_pending = True
        await self._steps.slots.unload()
        self._steps.stop_pending = False
        if self._steps.reading_is_old:
            self._steps.reading_is_old = False
            await self._settling.wait_until_settled(())  # the next plan begins at what a reading shows

    async def fail_step(self, reason: str) -> None:
        """Handle a failure in motion: stop the remaining axes and report the reason to the coordinator."""
        self._steps.interruptions += 1
        armed_step, self._steps.present = self._steps.present, None
        if armed_step is not None:
            self._events.emit_step("failed", reason, armed_step)
            self.drop_following("stopped", reason)
            await self.stop_failed_step()

    async def stop_failed_step(self) -> None:
        """Stop after a failure. Raises `LinkClosed`, `ControllerFault`: then the stop stays pending."""
        self._steps.stop_pending = True
        await self.stop_driver()
        self._steps.stop_pending = False

    async def stop_driver(self, *, abort: bool = False) -> None:
        """Send a stop; the slots hold nothing any more that could start. Raises `LinkClosed`, `ControllerFault`."""
        self._steps.slots.drop()
        await self._context.driver.stop(abort=abort)

    def drop_step(self, reason: str) -> None:
        """Drop the step: the controller is unreachable, or has lost its memory of the step."""
        self._steps.interruptions += 1
        self._steps.slots.drop()
        self._steps.stop_pending = False
        armed_step, self._steps.present = self._steps.present, None
        if armed_step is not None:
            self._events.emit_step("failed", reason, armed_step)
        self.drop_following("failed", reason)

    def drop_following(self, kind: EventKind, reason: str) -> None:
        """Forget the following step, which the caller unloads or stops, and report that."""
        dropped_step = self._steps.following.drop(reason)
        if dropped_step is not None:
            self._events.emit_step(kind, reason, dropped_step)

    async def withdraw_following(self, reason: str) -> None:
        """The present step has not ended as planned: nothing follows it. Raises `LinkClosed`, `ControllerFault`."""
        following = self._steps.following.armed_step
        if following is None:
            return
        if following.phase is StepPhase.RELEASED:
            await self.stop_failed_step()
        else:
            await self._steps.following.unload()
        self.drop_following("disarmed", f"the step before it has not ended as planned: {reason}")

    async def unload_at_t0(self, armed_step: ArmedStep) -> None:
        """Unload a step whose `go` has not arrived by T0."""
        await sleep_until_ns(self._context.clock, armed_step.t0_host_ns)
        present, following = self._steps.present, self._steps.following.armed_step
        waiting_phases = (StepPhase.ARMED, StepPhase.COMMITTED)
        if present is not None and armed_step.is_same(present) and present.phase in waiting_phases:
            await self.abandon_step("T0 passed without a go")
        elif following is not None and armed_step.is_same(following) and following.phase in waiting_phases:
            await self._steps.following.unload()
            self.drop_following("disarmed", "T0 passed without a go")
