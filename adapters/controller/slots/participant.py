"""A controller's part in a motion step: armed, committed, released, moving; and every way out of that.

The order is fixed (propose, arm, commit, go). Each transition is checked against job, step and T0, and only a `go`
after a commit starts anything. Interruptions (stop, e-stop, a lost coordinator) do not wait for this order: they
increment `interruptions`, and a transition that finds the counter changed after a wait unloads what it has loaded.
"""

import asyncio
from dataclasses import replace

from adapters.controller.slots.follower import StepFollower
from adapters.controller.slots.loader import COMPARED_NS, StepLoader
from adapters.controller.slots.lowering import StepLowering
from adapters.controller.slots.parts import StepParts
from adapters.controller.slots.step_checks import StepChecks
from adapters.controller.state.armed_step import ArmedStep, StepPhase
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.next_step import FollowingStep, PreparedMove
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal
from orchestrator.model.messages import (
    ArmedReply,
    ArmRequest,
    CommitRequest,
    CommittedReply,
    GoRequest,
    Proposal,
    ProposeRequest,
    Reply,
    StartAtOnceRequest,
    StartedReply,
    StepRequest,
)
from orchestrator.model.steps.numbers import name_step


class StepParticipant:
    """One controller as a participant in steps."""

    def __init__(self, context: ControllerContext, parts: StepParts, checks: StepChecks) -> None:
        self._context = context
        self._steps = parts.steps
        self._withdrawal = parts.withdrawal
        self._settling = parts.settling
        self._surveillance = parts.surveillance
        self._tasks = parts.tasks
        self._lowering = StepLowering(context, parts.steps, checks)
        self._loader = StepLoader(context, parts)
        self._decision: tuple[str, int, int, int] | None = None
        """Job, step, epoch and instant of the last one that was carried out here."""
        self._follower = StepFollower(context, parts, self._loader, self._lowering)

    async def propose_step(self, request: ProposeRequest) -> Proposal:
        """Lower the profiles without accessing the controller."""
        return await self._lowering.propose_step(request)

    async def arm_step(self, request: ArmRequest) -> ArmedReply:
        """Load the move for T0, with the present clock mapping frozen into it; behind the present move, if it follows
        that."""
        async with self._steps.transition_lock:
            present = self._steps.present
            if present is not None and not self._may_follow(request, present):
                raise Refusal("busy", f"already {present.phase.value} for job {present.job}", "disarm it first")
            interruptions = self._steps.interruptions
            move = await self._lowering.prepare_move(request, follows=present is not None)
            if interruptions != self._steps.interruptions:
                raise Refusal("stopped", "a stop came before arming", "")
            if self._steps.present is None:
                return await self._loader.load_at_rest(move)
            return await self._load_behind(move)

    def _may_follow(self, request: ArmRequest | StartAtOnceRequest, present: ArmedStep) -> bool:
        """Whether the step may be loaded behind the present one."""
        is_behind = (present.job, present.step) == (request.job, request.after_step)
        return is_behind and present.executes and self._steps.following.armed_step is None

    async def _load_behind(self, move: PreparedMove) -> ArmedReply:
        """Load the move beside the present one where the controller can hold it; otherwise keep it until that has
        ended."""
        present = self._steps.present
        must_settle = present is not None and self._settling.must_settle(present.axes)
        if move.lowered.gap_ns is None or must_settle:
            await self._keep_until_end(move)
            self._tasks.spawn(self._withdrawal.unload_at_t0(move.armed_step))
            return self._loader.make_armed_reply(move, {}).model_copy(update={"waits": True})
        stages = await self._loader.load(move, self._steps.following.require_slot(), "beside")
        self._steps.stop_ns = max(self._steps.stop_ns, move.lowered.costs.stop_ns)
        self._steps.following.note_loaded(move)
        self._tasks.spawn(self._withdrawal.unload_at_t0(move.armed_step))
        if self._steps.present is None:
            self._follower.begin_next()  # the present move has ended meanwhile
        return self._loader.make_armed_reply(move, stages)

    async def _keep_until_end(self, move: PreparedMove, at_once: StartAtOnceRequest | None = None) -> FollowingStep:
        """Keep the move until the present one has ended."""
        is_checked = self._context.driver.capabilities.checks_while_moving
        if is_checked:
            await self._surveillance.require_settings(COMPARED_NS)
        following = self._steps.following.hold_back(move, checked=is_checked, at_once=at_once)
        if self._steps.present is None:
            self._follower.begin_next()  # the present move has ended meanwhile
        return following

    async def commit_step(self, request: CommitRequest) -> CommittedReply:
        """Commit to the step after a final check of the controller."""
        waiting_move = self._steps.following.find_waiting(request)
        if waiting_move is not None:
            return await self._commit_following(request, waiting_move)
        return await self._commit_present(request)

    async def _commit_present(self, request: CommitRequest) -> CommittedReply:
        async with self._steps.transition_lock:
            armed_step = self._require_phase(request, request.t0_fleet_ns, StepPhase.ARMED)
            self._surveillance.require_references(armed_step)
            interruptions = self._steps.interruptions
            follows = armed_step is self._steps.following.armed_step
            await (self._steps.following.require_slot() if follows else self._steps.slots.present).verify()
            if interruptions != self._steps.interruptions or not armed_step.is_same(self._steps.find_step(request)):
                raise Refusal("stopped", "a stop came before the commit", "")
            committed_step = replace(armed_step, phase=StepPhase.COMMITTED)
            if armed_step is self._steps.following.armed_step:
                self._steps.following.armed_step = committed_step
            else:  # the step before may have ended meanwhile
                self._steps.present = committed_step
            return CommittedReply()

    async def _commit_following(self, request: CommitRequest, following: FollowingStep) -> CommittedReply:
        """Promise a step that is loaded after the present one, as soon as it is."""
        armed_reply = await asyncio.shield(following.loaded)
        committed_reply = await self._commit_present(request)
        self._loader.show_answer()
        return committed_reply.model_copy(update={"armed": armed_reply})

    async def start_step(self, request: GoRequest) -> Reply:
        """Release the move, for the committed T0 or an earlier one."""
        async with self._steps.transition_lock:
            advance_ns = request.advance_ns
            armed_step = self._require_phase(request, request.t0_fleet_ns + advance_ns, StepPhase.COMMITTED)
            if advance_ns and (advance_ns < 0 or not armed_step.can_advance):
                raise Refusal(
                    "not-sooner", "the step can only begin at the T0 for which it was armed", "arm it for another T0"
                )
            self._surveillance.require_references(armed_step)
            t0_ns = armed_step.scale.to_host_ns(request.t0_fleet_ns) if advance_ns else armed_step.t0_host_ns
            advance_ns = armed_step.t0_host_ns - t0_ns
            if self._context.clock.now_ns() >= t0_ns:
                raise Refusal("late", "T0 has passed", LATE_REMEDY)
            released_step = replace(
                armed_step, phase=StepPhase.RELEASED, t0_fleet_ns=request.t0_fleet_ns, t0_host_ns=t0_ns
            )
            if armed_step is self._steps.following.armed_step:
                return await self._release_following(released_step, advance_ns)
            await self._follower.release_present(released_step, request.start_tolerance_ns, advance_ns)
            return Reply()

    async def start_at_once(self, request: StartAtOnceRequest) -> StartedReply:
        """Load the move, and start it as soon as the controller can: now, or when the present one, which it follows,
        has ended as planned. The answer comes once it is released."""
        async with self._steps.transition_lock:
            present = self._steps.present
            if present is not None and not self._may_follow(request, present):
                raise Refusal("busy", f"already {present.phase.value} for job {present.job}", "disarm it first")
            self._require_new_decision(request)
            interruptions = self._steps.interruptions
            move = await self._lowering.prepare_at_once(request, follows=present is not None)
            if move.lowered.release_ns is None:
                raise Refusal("start-class", "the controller cannot start this move at once", "use `start: agreed`")
            if interruptions != self._steps.interruptions:
                raise Refusal("stopped", "a stop came before arming", "")
            if self._steps.present is None:
                reply = await self._loader.load_at_rest(move)
                await self._steps.slots.present.verify()
                return await self._follower.start_loaded(move, reply, request.start_tolerance_ns)
            if move.lowered.gap_ns is not None and not self._settling.must_settle(move.armed_step.axes):
                return await self._start_beside(move, request)
            following = await self._keep_until_end(move, request)
        reply = await asyncio.shield(following.loaded)
        if not isinstance(reply, StartedReply):
            raise Refusal("stopped", "the step was unloaded meanwhile", "")
        return reply

    def _require_new_decision(self, request: StartAtOnceRequest) -> None:
        """A decision is for one start. Raises `Refusal`."""
        decision = (request.job, request.step, request.epoch, request.decided_fleet_ns)
        if decision == self._decision:
            raise Refusal("already-started", f"{name_step(request.step)} was started for this decision already", "")
        self._decision = decision

    async def _start_beside(self, move: PreparedMove, request: StartAtOnceRequest) -> StartedReply:
        """Load the move beside the present one, and release it for the earliest start behind that."""
        reply = await self._load_behind(move)
        following = self._steps.following.armed_step
        if following is None:  # it has become the present one meanwhile, which is at rest
            return await self._follower.start_loaded(move, reply, request.start_tolerance_ns)
        earliest_ns = self._context.clock.now_ns() + (move.lowered.release_ns or 0)
        # By its evidence the present one may end later than the coordinator knew.
        ends_ns = 0 if self._steps.present is None else self._steps.present.ends_host_ns
        ends_ns = max(ends_ns, move.armed_step.scale.to_host_ns(request.not_before_fleet_ns))
        released_step, advance_ns = move.bring_forward(max(earliest_ns, ends_ns + (move.lowered.gap_ns or 0)))
        await self._release_following(released_step, advance_ns)
        return StartedReply(**dict(reply), t0_fleet_ns=released_step.t0_fleet_ns)

    async def _release_following(self, released: ArmedStep, advance_ns: int) -> Reply:
        """Release the step that the controller holds beside the present one."""
        interruptions = self._steps.interruptions
        self._steps.following.armed_step = released
        try:
            await self._steps.following.require_slot().release(advance_ns=advance_ns)
        except (Refusal, ControllerFault):
            # The controller may have released the move all the same: a lost reply must not let it run.
            await self._withdrawal.unload_released(released)
            raise
        if interruptions != self._steps.interruptions:
            raise Refusal("stopped", "a stop came before the start", "")
        return Reply()

    def _require_phase(self, request: StepRequest, t0_fleet_ns: int, phase: StepPhase) -> ArmedStep:
        armed_step = self._steps.find_step(request)
        if armed_step is None and self._context.clock.now_ns() >= self._context.require_scale().to_host_ns(t0_fleet_ns):
            raise Refusal("late", "T0 has passed, and the step was unloaded", LATE_REMEDY)
        if armed_step is None or armed_step.t0_fleet_ns != t0_fleet_ns:
            raise Refusal(
                "not-armed", f"not armed for job {request.job} {name_step(request.step)} at that T0", "arm it first"
            )
        if armed_step.phase is not phase:
            raise Refusal("wrong-phase", f"the step is {armed_step.phase.value}, not {phase.value}", "")
        return armed_step
