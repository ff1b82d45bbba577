"""A controller's part in a motion step: armed, committed, released, moving; and every way out of that.

The order is fixed (propose, arm, commit, go). Each transition is checked against job, step and T0, and only a `go`
after a commit starts anything. Interruptions (stop, e-stop, a lost coordinator) do not wait for this order: they
increment `interruptions`, and a transition that finds the counter changed after a wait unloads what it has loaded.
"""

import asyncio
from collections import deque
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

from adapters.abilities import find_differences
from adapters.contract import Driver, LoadPlace, MoveOutcome, MoveSlot, SettingDifference, require_triggers
from adapters.controller.armed_step import ArmedStep, StepPhase
from adapters.controller.clock import PastStep, clock_mapping
from adapters.controller.fleet_durations import state_move, to_host_profiles, to_host_start
from adapters.controller.next_step import FollowingStep, NextStepSlot, PreparedMove
from adapters.controller.settling import SettlingResult
from adapters.controller.step_end import MotionEnd, MotionStart
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_until_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.clock.latency import MAX_STARTS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import (
    ArmedReply,
    ArmRequest,
    CommitRequest,
    CommittedReply,
    DisarmedReply,
    DisarmRequest,
    GoRequest,
    Proposal,
    ProposeRequest,
    Reply,
    StartOptions,
    StepRequest,
)
from orchestrator.model.state import AxisEvidence, EventKind

# A participant is not polled for this long before T0: its commit reads the controller, while other participants are
# still being committed. Polling 16 controllers in this window made `go` miss its deadline.
QUIET_BEFORE_T0_NS = 300 * NS_PER_MS
# A participant is not polled for this long after a request of a step: arming reads the controller as well, and the
# fleet waits for it.
QUIET_AFTER_REQUEST_NS = 250 * NS_PER_MS
# From this long before the end of a step a controller is not polled, if another step follows: a poll would delay that.
QUIET_TURN_NS = 40 * NS_PER_MS
READING_ROOM_NS = 100 * NS_PER_MS  # between two steps, in which the controller is read at rest
STOP_LEAD_NS = 10 * NS_PER_MS  # this long before T0 a stop still takes effect before T0
EARLY_NS = 2 * NS_PER_MS  # this long before T0, and from then on, a released step may have begun


class StepEventEmitter(Protocol):
    """Publishes an event about the step on the bus."""

    def __call__(
        self, kind: EventKind, text: str, armed_step: ArmedStep, evidence: Mapping[str, AxisEvidence] | None = None
    ) -> None: ...


@dataclass(frozen=True, slots=True)
class StepServices:
    """What a participant needs from its supervisor.

    check: raises `Refusal` when the profiles must not be executed now.
    check_following: the same for profiles that begin where the present step ends.
    scale: returns fleet time; raises `Refusal` while it is unknown.
    emit: publishes an event of a step.
    settle: waits until axes are at rest at their targets; a fresh state is on the bus when it returns.
    must_settle: whether one of the axes must come to rest inside a window.
    doubt_positions: drops the reference of axes, by axis with the reason.
    note_differences: keeps the controller from moving while settings differ.
    spawn: runs a coroutine in the background.
    """

    check: Callable[[ProposeRequest | ArmRequest], None]
    check_following: Callable[[ProposeRequest | ArmRequest], None]
    scale: Callable[[], FleetScale]
    emit: StepEventEmitter
    settle: Callable[[Sequence[str]], Awaitable[SettlingResult]]
    must_settle: Callable[[Sequence[str]], bool]
    doubt_positions: Callable[[Mapping[str, str]], None]
    note_differences: Callable[[Sequence[SettingDifference]], None]
    spawn: Callable[[Coroutine[Any, Any, None]], object]


class StepParticipant:
    """One controller as a participant in steps. lowering_lock: shared by the participants of a host (see
    `ControllerContext`)."""

    def __init__(
        self,
        controller: str,
        driver: Driver,
        clock: Clock,
        services: StepServices,
        lowering_lock: asyncio.Lock,
    ) -> None:
        self._controller = controller
        self._driver = driver
        self._clock = clock
        self._check = services.check
        self._check_following = services.check_following
        self.require_scale = services.scale
        self._emit = services.emit
        self._settle = services.settle
        self._must_settle = services.must_settle
        self._spawn = services.spawn
        self._note_differences = services.note_differences
        self._doubt_positions = services.doubt_positions
        self._lowering_lock = lowering_lock
        self._transition_lock = asyncio.Lock()
        self._loading_lock = asyncio.Lock()
        self._interruptions = 0
        self._followed_steps = 0
        self._reading_is_old = False
        """The last reading is from before the end of a step that another one follows."""
        self._ended_ns = 0
        """When the present step should have ended, at the latest; host time."""
        self._requested_ns = -QUIET_AFTER_REQUEST_NS
        self.past_steps: deque[PastStep] = deque(maxlen=MAX_STARTS)
        """The last steps: as many as starts are learned from."""
        self.armed_step: ArmedStep | None = None
        self._slots = driver.slots
        self._next = NextStepSlot(driver.slots)
        self.stop_pending = False
        """A released step has failed, and its stop could not be sent yet."""
        self.stop_ns = 0
        """Longest time that a stop of the last step takes: its ramps may be gentler than the steepest ramps of the
        axes."""

    # The phases of a step

    async def propose_step(self, request: ProposeRequest) -> Proposal:
        """Lower the profiles without accessing the controller."""
        async with self._lowering_lock:
            await asyncio.sleep(0)
            check = self._check_following if request.start.follows else self._check
            check(request)
            if not request.rehearsal:
                self._requested_ns = self._clock.now_ns()
            scale, mapping = self.require_scale(), self._driver.clock_mapping()
            start = to_host_start(request.start, scale)
            lowered_step = self._driver.lower_profiles(to_host_profiles(request.profiles, scale), start, mapping)
            require_triggers(lowered_step, start)
        at_ticks = mapping is not None and lowered_step.tick_ns > 0 and lowered_step.start_class == "clock"
        statement = state_move(lowered_step, scale, self._clock.now_ns() + start.lead_ns, _find_last_instants(start))
        return Proposal(
            tick_at_fleet_ns=scale.to_fleet_ns(mapping.host_at_ns) if at_ticks and mapping is not None else None,
            durations_s=statement.durations_s,
            path_error_counts=dict(lowered_step.path_error_counts),
            costs=lowered_step.costs,
            start_class=lowered_step.start_class,
            tick_ns=statement.tick_ns,
            terms=statement.terms,
            edge=statement.edge,
            triggers=statement.triggers,
            clock_ppm=statement.clock_ppm,
            can_advance=lowered_step.can_advance,
            gap_ns=lowered_step.gap_ns if request.start.follows else None,
            commands=list(lowered_step.commands),
        )

    async def arm_step(self, request: ArmRequest) -> ArmedReply:
        """Load the move for T0, with the present clock mapping frozen into it; behind the present move, if it follows
        that."""
        async with self._transition_lock:
            present = self.armed_step
            if present is not None and not self._may_follow(request, present):
                raise Refusal("busy", f"already {present.phase.value} for job {present.job}", "disarm it first")
            interruptions = self._interruptions
            move = await self._prepare_move(request, follows=present is not None)
            if interruptions != self._interruptions:
                raise Refusal("stopped", "a stop came before arming", "")
            if self.armed_step is None:
                return await self._load_at_rest(move)
            return await self._load_behind(move)

    def _may_follow(self, request: ArmRequest, present: ArmedStep) -> bool:
        """Whether the step may be loaded behind the present one."""
        is_behind = (present.job, present.step) == (request.job, request.after_step)
        return is_behind and present.phase in (StepPhase.RELEASED, StepPhase.MOVING) and self._next.armed_step is None

    async def _prepare_move(self, request: ArmRequest, *, follows: bool) -> PreparedMove:
        """Lower the move for T0. Raises `Refusal`."""
        began_ns = self._clock.now_ns()
        async with self._lowering_lock:
            # One turn of the event loop, for everything that arrived during the last lowering.
            await asyncio.sleep(0)
            check = self._check_following if follows else self._check
            check(request)
            self._requested_ns = self._clock.now_ns()
            scale, mapping = self.require_scale(), self._driver.clock_mapping()
            t0_ns = scale.to_host_ns(request.t0_fleet_ns)
            lead_ns = 0 if mapping is None else max(0, t0_ns - mapping.host_at_ns)
            start = to_host_start(request.start, scale).model_copy(update={"lead_ns": lead_ns, "exact": True})
            lowered_step = self._driver.lower_profiles(to_host_profiles(request.profiles, scale), start, mapping)
            require_triggers(lowered_step, start)
        if self._clock.now_ns() + lowered_step.costs.disarm_ns >= t0_ns:
            raise Refusal("late", "T0 is too near to arm; the arm request came late", "increase the lead time")
        armed_step = ArmedStep(
            job=request.job,
            step=request.step,
            t0_fleet_ns=request.t0_fleet_ns,
            t0_host_ns=t0_ns,
            axes=tuple(request.profiles),
            scale=scale,
            can_advance=lowered_step.can_advance,
            promised_s=dict(lowered_step.durations_s),
            clock_ppm=lowered_step.clock_ppm,
        )
        return PreparedMove(request, armed_step, lowered_step, mapping, began_ns)

    async def _load_at_rest(self, move: PreparedMove, following: FollowingStep | None = None) -> ArmedReply:
        """Load the move into the controller, whose axes are at rest. following: the step before has just ended, and it
        waited for that."""
        load_place: LoadPlace = "at rest" if following is None else "behind"
        is_checked = following is not None and following.checked
        stages = await self._load(move, self._slots.present, load_place, checked=is_checked)
        self.armed_step, self.stop_ns = move.armed_step, move.lowered.costs.stop_ns
        self._requested_ns = self._clock.now_ns()  # the commit is next
        self._spawn(self._unload_at_t0(move.armed_step))
        return self._make_armed_reply(move, stages)

    async def _load(
        self, move: PreparedMove, slot: MoveSlot, place: LoadPlace, *, checked: bool = False
    ) -> Mapping[str, int]:
        """Load the move into `slot` after a comparison of settings, unless they are `checked`; return how long its
        stages took. Raises `Refusal`, `ControllerFault`: then it is unloaded."""
        interruptions = self._interruptions
        unload = slot.unload if place == "beside" else self._slots.unload
        try:
            async with self._loading_lock:
                if not checked:
                    await self._require_settings()
                stages = await slot.load(move.lowered, move.armed_step.t0_host_ns, move.mapping, place)
        except (Refusal, ControllerFault):
            await unload()
            raise
        if interruptions != self._interruptions:
            await unload()
            raise Refusal("stopped", "a stop came while arming", "")
        return stages

    def _make_armed_reply(self, move: PreparedMove, stages: Mapping[str, int]) -> ArmedReply:
        mapping, armed_step = move.mapping, move.armed_step
        last_instants = _find_last_instants(move.request.start)
        statement = state_move(move.lowered, armed_step.scale, armed_step.t0_host_ns, last_instants)
        return ArmedReply(
            durations_s=statement.durations_s,
            terms=statement.terms,
            edge=statement.edge,
            triggers=statement.triggers,
            mapping=None if mapping is None else clock_mapping(self._controller, mapping, move.began_ns),
            began_fleet_ns=armed_step.scale.to_fleet_ns(move.began_ns),
            took_ns=self._clock.now_ns() - move.began_ns,
            stages_ns=dict(stages),
        )

    # A step behind the present one

    async def _load_behind(self, move: PreparedMove) -> ArmedReply:
        """Load the move beside the present one where the controller can hold it; otherwise keep it until that has
        ended."""
        present = self.armed_step
        must_settle = present is not None and self._must_settle(present.axes)
        if move.lowered.gap_ns is None or must_settle:
            is_checked = self._driver.capabilities.checks_while_moving
            if is_checked:
                await self._require_settings()
            self._next.hold_back(move, checked=is_checked)
            self._spawn(self._unload_at_t0(move.armed_step))
            if self.armed_step is None:
                self._begin_next()
            return self._make_armed_reply(move, {}).model_copy(update={"waits": True})
        stages = await self._load(move, self._next.require_slot(), "beside")
        self.stop_ns = max(self.stop_ns, move.lowered.costs.stop_ns)
        self._next.note_loaded(move)
        self._spawn(self._unload_at_t0(move.armed_step))
        if self.armed_step is None:
            self._begin_next()  # the present move has ended meanwhile
        return self._make_armed_reply(move, stages)

    def _begin_next(self) -> None:
        """The present step is done: the following one is the present one."""
        following = self._next.take()
        if following is None:
            return
        self.armed_step = following.armed_step
        if not following.in_controller:
            self.armed_step = replace(following.armed_step, phase=StepPhase.LOADING)
            self._spawn(self._load_following(following))
        elif following.armed_step.phase is StepPhase.RELEASED:
            self._spawn(self._follow_step(following.armed_step))

    async def _load_following(self, following: FollowingStep) -> None:
        """Load the step that waited for the end of the one before."""
        async with self._transition_lock:
            if not following.armed_step.is_same(self.armed_step):
                self._next.finish_loading(following, Refusal("stopped", "the step was unloaded meanwhile", ""))
                return
            try:
                reply = await self._load_at_rest(replace(following.move, began_ns=self._ended_ns), following)
            except (Refusal, ControllerFault, LinkClosed) as error:
                if following.armed_step.is_same(self.armed_step):
                    self.armed_step = None
                self._next.finish_loading(following, error)
                if not isinstance(error, Refusal):
                    raise
            else:
                self._next.finish_loading(following, reply)

    async def _commit_following(self, request: CommitRequest, following: FollowingStep) -> CommittedReply:
        """Promise a step that is loaded after the present one, as soon as it is."""
        armed_reply = await asyncio.shield(following.loaded)
        return (await self._commit_present(request)).model_copy(update={"armed": armed_reply})

    def _drop_following(self, kind: EventKind, reason: str) -> None:
        """Forget the following step, which the caller unloads or stops, and report that."""
        dropped_step = self._next.drop(reason)
        if dropped_step is not None:
            self._emit(kind, reason, dropped_step)

    async def _withdraw_following(self, reason: str) -> None:
        """The present step has not ended as planned: nothing follows it. Raises `LinkClosed`, `ControllerFault`."""
        following = self._next.armed_step
        if following is None:
            return
        if following.phase is StepPhase.RELEASED:
            await self._stop_failed_step()
        else:
            await self._next.unload()
        self._drop_following("disarmed", f"the step before it has not ended as planned: {reason}")

    async def _require_settings(self) -> None:
        """Raise `Refusal` when a setting that the move relies on is not as expected."""
        differences = await find_differences(self._driver, everything=True)
        if differences:
            self._note_differences(differences)
            raise differences[0].to_refusal()

    async def commit_step(self, request: CommitRequest) -> CommittedReply:
        """Commit to the step after a final check of the controller."""
        waiting_move = self._next.find_waiting(request)
        if waiting_move is not None:
            return await self._commit_following(request, waiting_move)
        return await self._commit_present(request)

    async def _commit_present(self, request: CommitRequest) -> CommittedReply:
        async with self._transition_lock:
            armed_step = self._require_phase(request, request.t0_fleet_ns, StepPhase.ARMED)
            interruptions = self._interruptions
            follows = armed_step is self._next.armed_step
            await (self._next.require_slot() if follows else self._slots.present).verify()
            if interruptions != self._interruptions or not armed_step.is_same(self._find_step(request)):
                raise Refusal("stopped", "a stop came before the commit", "")
            committed_step = replace(armed_step, phase=StepPhase.COMMITTED)
            if armed_step is self._next.armed_step:
                self._next.armed_step = committed_step
            else:  # the step before may have ended meanwhile
                self.armed_step = committed_step
            return CommittedReply()

    async def start_step(self, request: GoRequest) -> Reply:
        """Release the move, for the committed T0 or an earlier one."""
        async with self._transition_lock:
            advance_ns = request.advance_ns
            armed_step = self._require_phase(request, request.t0_fleet_ns + advance_ns, StepPhase.COMMITTED)
            if advance_ns and (advance_ns < 0 or not armed_step.can_advance):
                raise Refusal(
                    "not-sooner", "the step can only begin at the T0 for which it was armed", "arm it for another T0"
                )
            t0_ns = armed_step.scale.to_host_ns(request.t0_fleet_ns) if advance_ns else armed_step.t0_host_ns
            advance_ns = armed_step.t0_host_ns - t0_ns
            if self._clock.now_ns() >= t0_ns:
                raise Refusal("late", "T0 has passed", "increase the lead time")
            released_step = replace(
                armed_step, phase=StepPhase.RELEASED, t0_fleet_ns=request.t0_fleet_ns, t0_host_ns=t0_ns
            )
            interruptions = self._interruptions
            if armed_step is self._next.armed_step:
                return await self._release_following(released_step, advance_ns)
            self.armed_step = released_step
            try:
                await self._slots.present.release(request.start_tolerance_ns, advance_ns)
            except (Refusal, ControllerFault):
                self.armed_step = None
                # The controller may have released the move all the same: a lost reply must not let it run.
                await self._stop_driver()
                await self._slots.unload()
                raise
            if interruptions != self._interruptions or self.armed_step is not released_step:
                await self._slots.unload()
                raise Refusal("stopped", "a stop came before the start", "")
            self._spawn(self._follow_step(released_step))
            return Reply()

    async def _release_following(self, released: ArmedStep, advance_ns: int) -> Reply:
        """Release the step that the controller holds beside the present one."""
        interruptions = self._interruptions
        self._next.armed_step = released
        try:
            await self._next.require_slot().release(advance_ns=advance_ns)
        except (Refusal, ControllerFault):
            # The controller may have released the move all the same: a lost reply must not let it run.
            await self._unload_released(released)
            raise
        if interruptions != self._interruptions:
            raise Refusal("stopped", "a stop came before the start", "")
        return Reply()

    async def disarm_step(self, request: DisarmRequest) -> DisarmedReply:
        """Unload the step if it is the one that is loaded. A moving step stays untouched."""
        present, following = self.armed_step, self._next.armed_step
        if following is None and present is not None and present.job == request.job and present.step != request.step:
            async with self._transition_lock:  # it may be being loaded behind the present one
                following = self._next.armed_step
        if following is not None and following.is_for(request):
            return await self._disarm_following(request, following)
        armed_step, has_begun = self.armed_step, False
        if armed_step is not None and not armed_step.is_for(request):
            return DisarmedReply()  # another job's step, which is still in use
        if armed_step is not None and armed_step.phase is StepPhase.RELEASED:
            # This bypasses a `go` that is still under way, because T0 is near.
            self._interruptions += 1
            has_begun = self._clock.now_ns() + STOP_LEAD_NS >= armed_step.t0_host_ns
            await self._stop_driver()
        async with self._transition_lock:
            armed_step = self.armed_step
            if armed_step is None:
                await self._unload_step()
                return DisarmedReply(may_have_started=has_begun)
            if armed_step.phase is StepPhase.MOVING:
                raise Refusal("moving", "the step is already moving", "stop it")
            self._interruptions += 1
            self.armed_step = None
            if armed_step.phase is StepPhase.RELEASED:
                # T0 may be at this very moment: a move that can no longer be unloaded must not run either.
                await self._stop_driver()
            await self._unload_step()
            self._emit("disarmed", "disarmed on request", armed_step)
            return DisarmedReply(may_have_started=has_begun)

    async def _unload_released(self, released: ArmedStep) -> bool:
        """Unload a released step behind the present one, or stop both if its start is too near for that; return whether
        it may have started."""
        if self._clock.now_ns() + STOP_LEAD_NS >= released.t0_host_ns:
            await self.stop("the following step was withdrawn at its start", abort=False)
            return True
        self._interruptions += 1
        await self._next.unload()
        if released.is_same(self.armed_step):
            await self._slots.unload()  # it has become the present one meanwhile
            self.armed_step = None
            self._emit("disarmed", "withdrawn before its start", released)
        elif self._next.armed_step is not None and self._clock.now_ns() + EARLY_NS >= released.t0_host_ns:
            await self.stop("the following step was withdrawn at its start", abort=False)  # unloading took too long
            return True
        else:
            self._drop_following("disarmed", "withdrawn before its start")
        return False

    async def _disarm_following(self, request: DisarmRequest, following: ArmedStep) -> DisarmedReply:
        """Unload the following step; the present one continues, unless the start of the following one is so near that
        only a stop prevents it for certain."""
        if following.phase is StepPhase.RELEASED:
            return DisarmedReply(may_have_started=await self._unload_released(following))
        self._interruptions += 1
        await self._next.unload()
        if self._next.armed_step is not following:
            return await self.disarm_step(request)  # it was stopped meanwhile
        self._drop_following("disarmed", "disarmed on request")
        return DisarmedReply()

    # Ways out

    async def stop(self, reason: str, *, abort: bool, follow: bool = False) -> None:
        """Stop the controller now, whatever it does; nothing that is loaded starts afterwards.

        follow: the end of a moving step is reported once it is at rest, with its evidence."""
        self._interruptions += 1
        self._requested_ns = -QUIET_AFTER_REQUEST_NS
        if follow and self.armed_step is not None and self.armed_step.phase is StepPhase.MOVING:
            self._drop_following("stopped", reason)
            await self._stop_driver(abort=abort)
            return
        armed_step, self.armed_step = self.armed_step, None
        following = self._next.drop(reason)
        await self._stop_driver(abort=abort)
        for step in (armed_step, following):
            if step is not None:
                self._emit("stopped", reason, step)

    async def abandon_step(self, reason: str) -> None:
        """Handle the loss of the coordinator: unload what has not started, stop what moves."""
        armed_step = self.armed_step
        if armed_step is None:
            return
        if armed_step.phase in (StepPhase.RELEASED, StepPhase.MOVING):
            await self.stop(abort=False, reason=reason)
            return
        self._interruptions += 1
        self.armed_step = None
        await self._unload_step()
        self._emit("disarmed", reason, armed_step)

    async def _unload_step(self) -> None:
        """Unload the step. If the link is lost meanwhile, the result is unknown: the stop stays pending."""
        self.stop_pending = True
        await self._slots.unload()
        self.stop_pending = False
        if self._reading_is_old:
            self._reading_is_old = False
            await self._settle(())  # the next plan begins at what a reading shows

    async def fail_step(self, reason: str) -> None:
        """Handle a failure in motion: stop the remaining axes and report the reason to the coordinator."""
        self._interruptions += 1
        armed_step, self.armed_step = self.armed_step, None
        if armed_step is not None:
            self._emit("failed", reason, armed_step)
            self._drop_following("stopped", reason)
            await self._stop_failed_step()

    async def _stop_failed_step(self) -> None:
        """Stop after a failure. Raises `LinkClosed`, `ControllerFault`: then the stop stays pending."""
        self.stop_pending = True
        await self._stop_driver()
        self.stop_pending = False

    async def _stop_driver(self, *, abort: bool = False) -> None:
        """Send a stop; the slots hold nothing any more that could start. Raises `LinkClosed`, `ControllerFault`."""
        self._slots.drop()
        await self._driver.stop(abort=abort)

    def drop_step(self, reason: str) -> None:
        """Drop the step: the controller is unreachable, or has lost its memory of the step."""
        self._interruptions += 1
        self._slots.drop()
        self.stop_pending = False
        armed_step, self.armed_step = self.armed_step, None
        if armed_step is not None:
            self._emit("failed", reason, armed_step)
        self._drop_following("failed", reason)

    @property
    def is_loading(self) -> bool:
        """Whether a step is being loaded at this moment, possibly without a link by now."""
        return self._loading_lock.locked()

    async def wait_until_loaded(self) -> None:
        """Wait until no step is being loaded: on a line that is shared with other controllers, loading continues
        without a link."""
        async with self._loading_lock:
            pass

    def quiet_until_ns(self) -> int | None:
        """Return until when the controller must not be polled; None if it may be."""
        armed_step, now_ns = self.armed_step, self._clock.now_ns()
        until_ns = self._requested_ns + QUIET_AFTER_REQUEST_NS
        if armed_step is not None:
            if armed_step.phase is StepPhase.MOVING:
                return self._quiet_turn_until_ns(armed_step, now_ns)
            if armed_step.t0_host_ns - QUIET_BEFORE_T0_NS <= now_ns <= armed_step.t0_host_ns:
                until_ns = armed_step.t0_host_ns
        return until_ns if now_ns <= until_ns else None

    def _quiet_turn_until_ns(self, present: ArmedStep, now_ns: int) -> int | None:
        """Return until when a moving controller is not polled because the following step is near: it begins that by its
        own program, or this adapter loads it."""
        following = self._next.armed_step
        if following is None:
            return None
        ends_ns = present.ends_host_ns
        until_ns = min(ends_ns + QUIET_TURN_NS, following.t0_host_ns)
        return until_ns if ends_ns - QUIET_TURN_NS <= now_ns <= until_ns else None

    # Internals

    def _find_step(self, request: StepRequest) -> ArmedStep | None:
        """The present or the following step, if it is the one of the request."""
        for step in (self.armed_step, self._next.armed_step):
            if step is not None and step.is_for(request):
                return step
        return None

    @property
    def ordered_axes(self) -> tuple[str, ...]:
        """The axes that may move now: those of the moving step, and of a following one that is released."""
        present, following = self.armed_step, self._next.armed_step
        if present is None or present.phase is not StepPhase.MOVING:
            return ()
        is_released = following is not None and following.phase is StepPhase.RELEASED
        return (*present.axes, *following.axes) if following is not None and is_released else present.axes

    def _require_phase(self, request: StepRequest, t0_fleet_ns: int, phase: StepPhase) -> ArmedStep:
        armed_step = self._find_step(request)
        if armed_step is None and self._clock.now_ns() >= self.require_scale().to_host_ns(t0_fleet_ns):
            raise Refusal("late", "T0 has passed, and the step was unloaded", "increase the lead time")
        if armed_step is None or armed_step.t0_fleet_ns != t0_fleet_ns:
            raise Refusal(
                "not-armed", f"not armed for job {request.job} step {request.step} at that T0", "arm it first"
            )
        if armed_step.phase is not phase:
            raise Refusal("wrong-phase", f"the step is {armed_step.phase.value}, not {phase.value}", "")
        return armed_step

    async def _unload_at_t0(self, armed_step: ArmedStep) -> None:
        """Unload a step whose `go` has not arrived by T0."""
        await sleep_until_ns(self._clock, armed_step.t0_host_ns)
        present, following = self.armed_step, self._next.armed_step
        waiting_phases = (StepPhase.ARMED, StepPhase.COMMITTED)
        if present is not None and armed_step.is_same(present) and present.phase in waiting_phases:
            await self.abandon_step("T0 passed without a go")
        elif following is not None and armed_step.is_same(following) and following.phase in waiting_phases:
            await self._next.unload()
            self._drop_following("disarmed", "T0 passed without a go")

    @property
    def is_following(self) -> bool:
        """Whether the driver has not yet reached the end of a step, possibly a stopped one."""
        return self._followed_steps > 0

    async def _follow_step(self, armed_step: ArmedStep) -> None:
        self._followed_steps += 1
        try:
            await self._follow_to_end(armed_step)
        finally:
            self._followed_steps -= 1

    async def _follow_to_end(self, armed_step: ArmedStep) -> None:
        """Follow the move from its release to its end, with the controller's own evidence."""
        try:
            end = await self._watch_motion(armed_step)
        except (ControllerFault, LinkClosed, Refusal) as error:
            await self._handle_lost_motion(armed_step, error)
            return
        if end is not None:
            self.armed_step = None
            self._doubt_positions(end.wrong_durations)
            self._emit(end.kind, end.reason or end.outcome.reason or end.kind, end.moving, end.make_evidence())
            if end.kind == "done":
                self._begin_next()

    async def _watch_motion(self, armed_step: ArmedStep) -> MotionEnd | None:
        """Wait for start and end of the move, and withdraw what follows it unless it ends as planned; None if a stop
        has ended it meanwhile."""
        start_spans = await self._slots.present.wait_for_start()
        if self.armed_step is not armed_step:
            if self.armed_step is None and not self._transition_lock.locked():
                await (
                    self._slots.present.wait_for_end()
                )  # stopped at this moment: not over before a poll has shown rest
            return None
        moving_step = self.armed_step = replace(armed_step, phase=StepPhase.MOVING)
        motion_start = MotionStart(start_spans, armed_step.scale)
        self._emit("started", motion_start.text, moving_step, motion_start.seen_evidence)
        outcome = await self._slots.present.wait_for_end()
        self._ended_ns = moving_step.ends_host_ns
        self.past_steps.append(
            PastStep(moving_step.job, moving_step.step, moving_step.t0_host_ns, self._clock.now_ns())
        )
        settled_end = await self._settle_end(armed_step.axes, outcome)
        if self.armed_step is not moving_step:
            return None
        end = MotionEnd(moving_step, motion_start, outcome, settled_end)
        if end.kind != "done":
            await self._withdraw_following(end.reason or outcome.reason)
        elif self._reading_is_old and self._next.armed_step is None:
            # The step that was to follow has been unloaded meanwhile.
            self._reading_is_old = False
            await self._settle(armed_step.axes)
        return end if self.armed_step is moving_step else None

    async def _settle_end(self, axes: Sequence[str], outcome: MoveOutcome) -> SettlingResult:
        """Wait until the axes are at rest. The coordinator plans the next step from the state: at the end event it must
        be the state after the move. A following step, which is planned already, leaves room for that only behind a
        dwell."""
        settles = self._must_settle(axes) or self._next.spare_ns(self._clock.now_ns()) >= READING_ROOM_NS
        self._reading_is_old = not settles
        if not settles:
            return SettlingResult()
        return await self._settle(axes if outcome.state == "done" else ())

    async def _handle_lost_motion(self, armed_step: ArmedStep, error: ControllerFault | LinkClosed | Refusal) -> None:
        """Handle a move whose start or end is not known. Raises `LinkClosed`, `ControllerFault`."""
        if armed_step.is_same(self.armed_step):
            if isinstance(error, Refusal):
                await self._withdraw_following(str(error))
            self.drop_step(str(error))
            if not isinstance(error, Refusal):
                await self._stop_failed_step()
        if isinstance(error, ControllerFault):
            async with self._transition_lock:  # not while the next step is armed
                if self.armed_step is None:
                    # A move that did not start as planned must not block the next one.
                    await self._slots.unload()


def _find_last_instants(start: StartOptions) -> dict[str, int]:
    """By output with triggers, the last of its instants, ns after T0."""
    return {trigger.output: trigger.instants_ns[-1] for trigger in start.triggers}
