"""The start of a motion step, in two phases: arm all members, have all promise, decide, release.

A failure before the decision moves nothing and disarms all; after it, one member that fails stops all others.
"""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import dataclass
from typing import Any

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.permits import PermitWatch
from orchestrator.coordinator.fleet.requests import ANSWER_S
from orchestrator.coordinator.journal.facts import StepDecision
from orchestrator.coordinator.motion.chain import RELEASE_SLACK, RELEASE_SLACK_NS
from orchestrator.coordinator.motion.lead_time import ArmKind
from orchestrator.coordinator.motion.negotiation import StartAgreement, StartNegotiation
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import (
    ArmedReply,
    ArmRequest,
    CommitRequest,
    CommittedReply,
    DisarmedReply,
    DisarmRequest,
    GoRequest,
    Reply,
)
from orchestrator.model.report import ArmedReport, JobState

ALIGN_EARLY_NS = 20 * NS_PER_MS  # for the last round of proposals before the aligned start
ALIGN_ASK_NS = NS_PER_S  # closer to the start than this, clock readings do not improve any more
FEED_HOLD = "feed-hold"  # code of a step that was paused, inside or before its motion: it can be resumed
WITHDRAWN = "withdrawn"  # code of a step that follows another one, which was paused or has failed
LATE = ("late", "no-answer")  # codes of members that were not quick enough
LEAD_GROWTH = (None, 1, 2, 4)  # factors on the declared lead time for later armings, if the known one was too short

StateCallback = Callable[[JobState, str], Coroutine[Any, Any, None]]


async def ignore_state(state: JobState, reason: str) -> None:
    """Of a step that follows: its job is running already."""
    del state, reason


@dataclass(slots=True)
class StartState:
    """The progress of a start.

    arming_fleet_ns: start of the last arming. promised_fleet_ns: when the promises were asked for that all have made.
    settled_fleet_ns: when T0 was settled. t0_fleet_ns: T0. unloaded: at the
    last disarming, no member had started. decided: the journal has the decision. paused_by: originator of a feed hold.
    waited: how a step that waited armed was started.
    usual_promise_ns: what promises take beyond that tells that the machine is slow.
    withdrawn: why a step that follows another one does not start behind it; "" while it may.
    """

    armed: Mapping[str, ArmedReply]
    arming_fleet_ns: int = 0
    promised_fleet_ns: int = 0
    settled_fleet_ns: int = 0
    t0_fleet_ns: int = 0
    unloaded: bool = False
    decided: bool = False
    paused_by: str | None = None
    waited: ArmedReport | None = None
    usual_promise_ns: int = 0
    withdrawn: str = ""

    def require_not_paused(self) -> None:
        """Raises `Refusal` when the step was paused or withdrawn before its motion."""
        if self.withdrawn:
            raise Refusal(WITHDRAWN, self.withdrawn)
        if self.paused_by is not None:
            raise Refusal(FEED_HOLD, f"paused by {self.paused_by} before it began")


class StartSequence:
    """Runs the start of one step."""

    def __init__(
        self,
        services: MotionServices,
        request: StepRequest,
        negotiation: StartNegotiation,
        agreement: StartAgreement,
        permit_watch: PermitWatch,
    ) -> None:
        self._services = services
        self._fleet = services.fleet
        self._requests = services.fleet.requests
        self._leadership = services.leadership
        self._estimator = services.estimator
        self._request = request
        self._negotiation = negotiation
        self._agreement = agreement
        self._permit_watch = permit_watch
        self.state = StartState({})

    async def run(self, on_state: StateCallback) -> None:
        """Arm and release all members. A member that is late while nothing has moved is armed again, with more lead.

        Raises `Refusal`: nothing moves.
        """
        state, agreement = self.state, self._agreement
        late = Refusal("late", "")
        for growth in LEAD_GROWTH:
            self.state.require_not_paused()
            if growth is not None:
                self._fleet.log.warning(f"late; arming again with more lead ({late.text})", job=self._request.job_id)
                await self._negotiation.renegotiate(agreement, growth)
            elif self._request.move.align:
                await on_state("arming", "")
                await self._await_alignment()
            state.arming_fleet_ns = self._leadership.fleet_now_ns()
            agreement.advance_ns = agreement.tick_residual_ns = 0
            state.t0_fleet_ns = agreement.choose_start(state.arming_fleet_ns + agreement.lead_ns)
            try:
                await on_state("arming", "")
                await self._arm()
                await self._judge_frozen_mappings()
                await self._require_time("arming took longer than its lead time")
                await self._release(on_state, 2 * (growth or 0) or 1)
            except Refusal as refusal:
                # A member that does not answer may be busy.
                if refusal.code not in LATE or not state.unloaded:
                    raise
                late = refusal
                if state.decided:
                    await self._withdraw_decision()
            else:
                return
        text = f"arming takes longer than the members declare, with every lead time: {late.text}"
        raise Refusal("late", text, "check the log of the adapters, and the load of this machine", late.controller)

    # Behind a moving step

    async def arm_following(self) -> None:
        """Arm all members behind the present step. Raises `Refusal`: nothing of the step is loaded any more."""
        state, agreement = self.state, self._agreement
        self.state.require_not_paused()
        state.arming_fleet_ns = self._leadership.fleet_now_ns()
        agreement.advance_ns = agreement.tick_residual_ns = 0
        state.t0_fleet_ns = agreement.choose_start(self._negotiation.earliest_following_ns(agreement))
        await self._arm()
        await self._judge_frozen_mappings()

    @property
    def release_due_ns(self) -> int:
        """When promises and decision must begin, fleet time. They are left as late as possible: until then, a pause
        takes effect before the step."""
        agreement, present = self._agreement, self._agreement.present
        margin_ns = RELEASE_SLACK * self._estimator.margin_ns(len(agreement.proposals))
        needs_ns = round(margin_ns) + agreement.disarm_ns + RELEASE_SLACK_NS
        due_ns = self.state.t0_fleet_ns - needs_ns
        if present is not None and agreement.loads_later:
            due_ns = min(due_ns, present.ends_fleet_ns)  # the promise of these members waits for the end
        return due_ns

    async def release_following(self) -> None:
        """Have all promise, decide and release a step that is armed behind another one.

        Raises `Refusal`: nothing of it is loaded. If it was decided all the same, members may have started, and were
        stopped."""
        if self.state.paused_by is not None or self.state.withdrawn:
            await self.disarm()
            self.state.require_not_paused()
        try:
            await self._release(ignore_state, 1)
        except Refusal as refusal:
            if refusal.code in LATE:
                self._estimator.record_late_loading(self._agreement.loads_later)
                if self.state.decided and self.state.unloaded:
                    await self._withdraw_decision()
            raise

    # Phase 1: arm

    async def _await_alignment(self) -> None:
        """Wait until arming leads to the instant at which the members' ticks coincide best. Proposals are renewed
        meanwhile, because predictions of ticks improve towards that instant."""
        agreement, clock = self._agreement, self._fleet.clock
        ends_ns = self._leadership.fleet_now_ns() + agreement.lead_ns + self._request.move.align
        while True:
            earliest_ns = self._leadership.fleet_now_ns() + agreement.lead_ns
            best_ns = agreement.choose_start(earliest_ns, max(0, ends_ns - earliest_ns))
            wait_ns = best_ns - earliest_ns - ALIGN_EARLY_NS
            await sleep_ns(clock, max(0, wait_ns if wait_ns < ALIGN_ASK_NS else wait_ns // 2))
            await self._negotiation.renegotiate(agreement, None)
            if wait_ns < ALIGN_ASK_NS:
                return

    async def _arm(self) -> None:
        agreement, t0_ns = self._agreement, self.state.t0_fleet_ns
        ends_ns = t0_ns + round(agreement.plan.duration_s * NS_PER_S)
        end_ns = agreement.choose_start(ends_ns) - t0_ns
        requests = {
            member: ArmRequest(
                **self._reference(),
                digest=self._fleet.view.fleet.controllers[member].digest,
                t0_fleet_ns=self._member_t0_ns(member),
                after_step=None if agreement.present is None else agreement.present.step,
                profiles=agreement.profiles(member),
                start=options.model_copy(update={"end_ns": end_ns}),
            )
            for member, options in self._negotiation.start_options(agreement, agreement.proposals).items()
        }
        declared_ns = {
            name: proposal.costs.arm_ns if proposal.costs else 0 for name, proposal in agreement.proposals.items()
        }
        timeout_s = ANSWER_S + 2 * max(declared_ns.values()) / NS_PER_S
        took_ns = dict[str, int]()
        self.state.armed = await self._requests.request_all(
            "arm", requests, ArmedReply, timeout_s, answered=took_ns.__setitem__
        )
        await self._disarm_if_refused(self.state.armed)
        # A member whose present move has ended already loads a following step at rest.
        kinds: dict[str, ArmKind] = {
            name: "rest" if agreement.present is None or agreement.proposals[name].gap_ns is None else "beside"
            for name, reply in self.state.armed.items()
            if not reply.waits
        }
        for name, kind in kinds.items():
            if name in took_ns:
                self._estimator.record_arming(kind, declared_ns, {name: took_ns[name]})

    async def _judge_frozen_mappings(self) -> None:
        """Judge the budget again, with the clock mappings that are frozen into what is armed."""
        try:
            self._negotiation.judge(self._agreement, self.state.armed)
        except Refusal:
            await self.disarm()
            raise

    async def _require_time(self, late: str) -> None:
        """Require time for the rest of the start, and for disarming if that fails. Raises `Refusal`; all are
        disarmed."""
        needs_ns = self._go_ns() + self._agreement.disarm_ns
        if self._leadership.fleet_now_ns() + needs_ns >= self.state.t0_fleet_ns:
            await self.disarm()
            raise Refusal("late", late)

    # Phase 2: promise, decide, release

    async def _release(self, on_state: StateCallback, go_factor: int) -> None:
        """Have all promise, settle T0, record the decision, release. Raises `Refusal`; all are disarmed or stopped.

        go_factor: on the time that `go` gets; beyond it, unused lead time is not waited for.
        """
        state, agreement, clock = self.state, self._agreement, self._fleet.clock
        armed_ns = clock.now_ns()
        await on_state("armed", "")
        await self._commit()
        try:
            state.require_not_paused()
            self._permit_watch.require_held()
        except Refusal:
            await self.disarm()
            raise
        # After the decision a late member fails the step; before it, all are armed again.
        estimator, promised_ns = self._estimator, clock.now_ns()
        # Members that load the step after the end of the present one promise only then.
        has_waited = bool(agreement.loads_later)
        try:
            await self._require_time("promises took longer than their lead time")
        except Refusal:
            if not has_waited:
                estimator.record_late_promise(promised_ns - armed_ns, len(agreement.proposals))
            raise
        state.settled_fleet_ns = self._leadership.fleet_now_ns()
        go_ns = go_factor * self._go_ns(0 if has_waited else max(0, promised_ns - armed_ns - state.usual_promise_ns))
        slack_ns = RELEASE_SLACK_NS if agreement.present is not None and not has_waited else 0
        earliest_ns = max(state.settled_fleet_ns + go_ns + slack_ns + agreement.disarm_ns, agreement.follows_ns)
        spare_ns = state.t0_fleet_ns - earliest_ns
        self._negotiation.advance(agreement, state.armed, spare_ns)
        state.t0_fleet_ns -= agreement.advance_ns
        await self._record_decision(on_state)
        if self._leadership.over:
            await self.disarm()
            raise Refusal("leadership-lost", "another coordinator has taken over")
        state.decided = True
        await self._go()
        released_ns = clock.now_ns()
        if agreement.present is not None:
            estimator.record_following(released_ns - promised_ns)
        if not has_waited:
            estimator.record_release(released_ns - armed_ns, released_ns - promised_ns)

    def _go_ns(self, promise_ns: int = 0) -> int:
        """The time to allow for decision and release. promise_ns: how long the promises have just taken."""
        agreement = self._agreement
        return self._estimator.go_ns(len(agreement.proposals), promise_ns, follows=agreement.present is not None)

    async def _commit(self) -> None:
        agreement = self._agreement
        requests = {
            member: CommitRequest(**self._reference(), t0_fleet_ns=self._member_t0_ns(member))
            for member in agreement.proposals
        }
        asked_ns = self._leadership.fleet_now_ns()
        left_ns = self.state.t0_fleet_ns - asked_ns
        # An answer after that would leave no time for `go`.
        useful_ns = left_ns - self._go_ns() - agreement.disarm_ns
        wait_s = max(0.02, min(ANSWER_S, max(left_ns / 2, useful_ns) / NS_PER_S))
        replies = await self._requests.request_all("commit", requests, CommittedReply, wait_s)
        await self._disarm_if_refused(replies)
        self.state.promised_fleet_ns = asked_ns
        loaded_replies = {member: reply.armed for member, reply in replies.items() if reply.armed is not None}
        if loaded_replies:
            self.state.armed = {**self.state.armed, **loaded_replies}
            await self._judge_frozen_mappings()
            costs = {name: agreement.proposals[name].costs for name in loaded_replies}
            declared_ns = {name: cost.arm_ns for name, cost in costs.items() if cost is not None}
            took_ns = {name: loaded_replies[name].took_ns for name in declared_ns}
            self._estimator.record_arming("behind", declared_ns, took_ns)

    async def _record_decision(self, on_state: StateCallback) -> None:
        await on_state("committed", "")  # in the journal with the decision
        request, services = self._request, self._services
        members, utc = ",".join(self._agreement.proposals), self._fleet.clock.utc()
        decision = StepDecision(request.index, self._leadership.epoch, self.state.t0_fleet_ns, members)
        await services.execute(services.journal.record_decision, request.job_id, decision, utc)

    async def _withdraw_decision(self) -> None:
        """A decision is for one start only. No member has started, and all have confirmed it: the decision is
        withdrawn, and the next arming gets one of its own."""
        job_id, step, journal = self._request.job_id, self._request.index, self._services.journal
        await self._services.execute(journal.withdraw_decision, job_id, step, self.state.t0_fleet_ns)
        self.state.decided = False

    async def _go(self) -> None:
        """After the decision: a member that cannot go stops all others before, or just after, they start."""
        agreement = self._agreement
        requests = {
            member: GoRequest(
                **self._reference(),
                t0_fleet_ns=self._member_t0_ns(member),
                advance_ns=agreement.advance_ns,
                start_tolerance_ns=agreement.start_tolerance_ns,
            )
            for member in agreement.proposals
        }
        # Answers are waited for only while the other members can still be disarmed.
        left_s = (self.state.t0_fleet_ns - self._leadership.fleet_now_ns()) / NS_PER_S
        wait_s = max(0.02, min(ANSWER_S, max(left_s / 2, left_s - agreement.disarm_ns / NS_PER_S)))
        released_replies = await self._requests.request_all("go", requests, Reply, wait_s)
        if any(reply.refused is not None and reply.refused.code in LATE for reply in released_replies.values()):
            self._estimator.record_late_go(len(agreement.proposals))
        await self._disarm_if_refused(released_replies)

    # Withdrawal

    async def _disarm_if_refused(self, replies: Mapping[str, Reply]) -> None:
        refused_reply = next((reply.refused for reply in replies.values() if reply.refused is not None), None)
        if refused_reply is None:
            return
        await self.disarm()
        raise refused_reply.as_step_error()

    async def disarm(self) -> None:
        """Unload all members, each independently of the others' silence; one that reports motion or does not answer is
        stopped as well."""
        movers, state = self._agreement.actors, self.state
        state.unloaded = True

        async def unload_member(member: str) -> None:
            request, actor = DisarmRequest(**self._reference()), self._request.job.actor
            reply = await self._requests.request(member, "disarm", request, DisarmedReply, ANSWER_S)
            state.unloaded = state.unloaded and not reply.may_have_started
            if reply.refused is not None and member in movers:
                state.unloaded = False
                await self._fleet.stop_members([member], "decelerate", actor, "disarm did not succeed")

        await asyncio.gather(*(unload_member(member) for member in self._agreement.proposals))

    async def disarm_line_driver(self) -> None:
        """Unload the driver of the trigger line if it moves no axis in the step; another job may be moving its axes,
        so it is not stopped."""
        line = self._agreement.line
        if line is not None and line.driver not in self._agreement.movers:
            await self._requests.request(line.driver, "disarm", DisarmRequest(**self._reference()), Reply, ANSWER_S)

    def _member_t0_ns(self, member: str) -> int:
        """The member's own T0, fleet time."""
        return self.state.t0_fleet_ns + self._agreement.shift_ns(member)

    def _reference(self) -> dict[str, Any]:
        request = self._request
        return {**self._requests.request_fields(request.job.actor), "job": request.job_id, "step": request.index}
