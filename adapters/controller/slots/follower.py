"""A released move is followed to its end, with the controller's own evidence; the next step begins behind it."""

from collections.abc import Sequence
from dataclasses import replace

from adapters.contract import MoveOutcome
from adapters.controller.monitoring.settling import SettlingResult
from adapters.controller.slots.loader import StepLoader
from adapters.controller.slots.lowering import StepLowering
from adapters.controller.slots.parts import StepParts
from adapters.controller.slots.step_end import MotionEnd, MotionStart
from adapters.controller.state.armed_step import ArmedStep, PastStep, StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.next_step import FollowingStep, PreparedMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import ArmedReply, StartedReply

READING_ROOM_NS = 100 * NS_PER_MS  # between two steps, in which the controller is read at rest


class StepFollower:
    """Follows the steps of one controller."""

    def __init__(
        self, context: ControllerContext, parts: StepParts, loader: StepLoader, lowering: StepLowering
    ) -> None:
        self._context = context
        self._lowering = lowering
        self._steps = parts.steps
        self._withdrawal = parts.withdrawal
        self._settling = parts.settling
        self._surveillance = parts.surveillance
        self._events = parts.events
        self._tasks = parts.tasks
        self._loader = loader

    async def release_present(self, released: ArmedStep, start_tolerance_ns: int, advance_ns: int) -> None:
        """Release the loaded move of the present step, and follow it. `released`: the step in that phase. Raises
        `Refusal`, `ControllerFault`: it is unloaded, and was stopped if it may have begun."""
        steps = self._steps
        interruptions = steps.interruptions
        steps.present = released
        try:
            await steps.slots.present.release(start_tolerance_ns, advance_ns)
        except (Refusal, ControllerFault):
            steps.present = None
            # The controller may have released the move all the same: a lost reply must not let it run.
            await self._withdrawal.stop_driver()
            await steps.slots.unload()
            raise
        if interruptions != steps.interruptions or steps.present is not released:
            await steps.slots.unload()
            raise Refusal("stopped", "a stop came before the start", "")
        self._tasks.spawn(self.follow_step(released))

    async def start_loaded(self, move: PreparedMove, armed: ArmedReply, start_tolerance_ns: int) -> StartedReply:
        """Release the move that was just loaded for the present step, for the earliest T0. Raises `Refusal`,
        `ControllerFault`."""
        if not move.armed_step.is_same(self._steps.present):
            raise Refusal("stopped", "a stop came before the start", "")
        earliest_ns = self._context.clock.now_ns() + (move.lowered.release_ns or 0)
        released_step, advance_ns = move.bring_forward(earliest_ns)
        await self.release_present(released_step, start_tolerance_ns, advance_ns)
        return StartedReply(**dict(armed), t0_fleet_ns=released_step.t0_fleet_ns)

    async def follow_step(self, armed_step: ArmedStep) -> None:
        self._steps.followed_steps += 1
        try:
            await self._follow_to_end(armed_step)
        finally:
            self._steps.followed_steps -= 1
            self._steps.followed_ns = self._context.clock.now_ns()

    async def _follow_to_end(self, armed_step: ArmedStep) -> None:
        """Follow the move from its release to its end, with the controller's own evidence."""
        try:
            end = await self._watch_motion(armed_step)
        except (ControllerFault, LinkClosed, Refusal) as error:
            await self._handle_lost_motion(armed_step, error)
            return
        if end is not None:
            self._steps.present = None
            self._surveillance.doubt_positions(end.doubts)
            if end.kind == "done":
                self._surveillance.note_end(end.moving)
            self._events.emit_step(
                end.kind, end.reason or end.outcome.reason or end.kind, end.moving, end.make_evidence()
            )
            if end.kind == "done":
                self.begin_next()

    async def _watch_motion(self, armed_step: ArmedStep) -> MotionEnd | None:
        """Wait for start and end of the move, and withdraw what follows it unless it ends as planned; None if a stop
        has ended it meanwhile."""
        start_spans = await self._steps.slots.present.wait_for_start()
        if self._steps.present is not armed_step:
            if self._steps.present is None and not self._steps.transition_lock.locked():
                await (
                    self._steps.slots.present.wait_for_end()
                )  # stopped at this moment: not over before a poll has shown rest
            return None
        begun_ns = min((span.earliest_ns for span in start_spans.values()), default=0)
        t0_ns = max(armed_step.t0_host_ns, begun_ns)
        moving_step = self._steps.present = replace(armed_step, phase=StepPhase.MOVING, t0_host_ns=t0_ns)
        motion_start = MotionStart(start_spans, armed_step.scale)
        self._events.emit_step("started", motion_start.text, moving_step, motion_start.seen_evidence)
        outcome = await self._steps.slots.present.wait_for_end()
        self._steps.ended_ns = moving_step.ends_host_ns
        self._steps.past_steps.append(
            PastStep(moving_step.job, moving_step.step, moving_step.t0_host_ns, self._context.clock.now_ns())
        )
        settled_end = await self._settle_end(armed_step.axes, outcome)
        if self._steps.present is not moving_step:
            return None
        # A step that follows closely leaves no time for a reading; it is loaded only from where this one ends.
        wrong_ends = {} if self._steps.reading_is_old else self._surveillance.find_wrong_ends(moving_step)
        end = MotionEnd(moving_step, motion_start, outcome, replace(settled_end, wrong_ends=wrong_ends))
        if end.kind != "done":
            await self._withdrawal.withdraw_following(end.reason or outcome.reason)
        elif self._steps.reading_is_old and self._steps.following.armed_step is None:
            # The step that was to follow has been unloaded meanwhile.
            self._steps.reading_is_old = False
            await self._settling.wait_until_settled(armed_step.axes)
        return end if self._steps.present is moving_step else None

    async def _settle_end(self, axes: Sequence[str], outcome: MoveOutcome) -> SettlingResult:
        """Wait until the axes are at rest. The coordinator plans the next step from the state: at the end event it must
        be the state after the move. A following step, which is planned already, leaves room for that only behind a
        dwell."""
        now_ns = self._context.clock.now_ns()
        settles = self._settling.must_settle(axes) or self._steps.following.leaves_room(now_ns, READING_ROOM_NS)
        self._steps.reading_is_old = not settles
        self._loader.show_answer()
        if not settles:
            return SettlingResult()
        return await self._settling.wait_until_settled(axes if outcome.state == "done" else ())

    async def _handle_lost_motion(self, armed_step: ArmedStep, error: ControllerFault | LinkClosed | Refusal) -> None:
        """Handle a move whose start or end is not known. Raises `LinkClosed`, `ControllerFault`."""
        if armed_step.is_same(self._steps.present):
            if isinstance(error, Refusal):
                await self._withdrawal.withdraw_following(str(error))
            self._withdrawal.drop_step(str(error))
            if not isinstance(error, Refusal):
                await self._withdrawal.stop_failed_step()
        if isinstance(error, ControllerFault):
            async with self._steps.transition_lock:  # not while the next step is armed
                if self._steps.present is None:
                    # A move that did not start as planned must not block the next one.
                    await self._steps.slots.unload()

    def begin_next(self) -> None:
        """The present step is done: the following one is the present one."""
        following = self._steps.following.take()
        if following is None:
            return
        self._steps.present = following.armed_step
        if not following.in_controller:
            self._steps.present = replace(following.armed_step, phase=StepPhase.LOADING)
            self._tasks.spawn(self._load_following(following))
        elif following.armed_step.phase is StepPhase.RELEASED:
            self._tasks.spawn(self.follow_step(following.armed_step))

    async def _load_following(self, following: FollowingStep) -> None:
        """Load the step that waited for the end of the one before."""
        async with self._steps.transition_lock:
            if not following.armed_step.is_same(self._steps.present):
                self._steps.following.finish_loading(
                    following, Refusal("stopped", "the step was unloaded meanwhile", "")
                )
                return
            try:
                reply = await self._load_behind(following)
            except (Refusal, ControllerFault, LinkClosed) as error:
                if following.armed_step.is_same(self._steps.present):
                    self._steps.present = None
                self._steps.following.finish_loading(following, error)
                if not isinstance(error, Refusal):
                    raise
            else:
                self._steps.following.finish_loading(following, reply)

    async def _load_behind(self, following: FollowingStep) -> ArmedReply:
        move, request = following.move, following.at_once
        if request is not None:
            move = await self._lowering.prepare_at_once(request, follows=True)  # its T0 counts from now on
            self._steps.present = replace(move.armed_step, phase=StepPhase.LOADING)
        reply = await self._loader.load_at_rest(replace(move, began_ns=self._steps.ended_ns), following)
        return reply if request is None else await self.start_loaded(move, reply, request.start_tolerance_ns)
