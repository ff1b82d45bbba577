"""The start of a step of one controller, as soon as that controller can: decided first, then loaded and started by one
request.

There is nothing to agree on: no other member waits for its promise, and its T0 is the controller's own. The decision is
in the journal before the request is sent. Nothing but this request starts the step, and it is executed once: its
repetitions, for a reply that was lost, get the first answer.
"""

from contextlib import suppress

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.fleet.requests import ANSWER_S
from orchestrator.coordinator.motion.chain import RELEASE_SLACK, RELEASE_SLACK_NS
from orchestrator.coordinator.motion.negotiation import find_arming_ns
from orchestrator.coordinator.motion.start import LATE, StartSequence, StateCallback, ignore_state
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import DisarmedReply, DisarmRequest, StartAtOnceRequest, StartedReply

TRIES = 3
POLL_NS = 80 * NS_PER_MS  # of a member that is polled in motion: not any more, once the next step is there
ARM_FACTOR = 2  # on the declared time of arming


class ImmediateStart(StartSequence):
    """Starts one step of one controller."""

    async def run(self, on_state: StateCallback) -> None:
        """Start the step at rest. A member that is late while nothing has moved is asked again. Raises `Refusal`:
        nothing moves."""
        late = Refusal("late", "")
        for _ in range(TRIES):
            self.state.require_not_paused()
            self.state.arming_fleet_ns = self._leadership.fleet_now_ns()
            try:
                await self._start(on_state)
            except Refusal as refusal:
                if refusal.code not in LATE or not self.state.unloaded:
                    raise
                late = refusal
                self._fleet.log.warning(f"late; starting again ({late.text})", job=self._request.job_id)
            else:
                return
        raise Refusal("late", late.text, "check the log of the adapter, and the load of its computer", late.controller)

    async def arm_following(self) -> None:
        """Nothing is loaded before the decision."""
        self.state.require_not_paused()
        self.state.arming_fleet_ns = self._leadership.fleet_now_ns()

    @property
    def release_due_ns(self) -> int:
        """When the decision must begin, fleet time: as late as possible, for until then a pause takes effect before
        the step."""
        agreement, present = self._agreement, self._agreement.present
        assert present is not None
        needs_ns = RELEASE_SLACK * self._estimator.deciding_ns + RELEASE_SLACK_NS + POLL_NS
        if not agreement.loads_later:
            shares = {name: self._estimator.arming_share(name, "beside") for name in agreement.proposals}
            arming_ns = find_arming_ns(self._fleet.view.fleet, agreement.proposals, shares)
            needs_ns += arming_ns + agreement.disarm_ns + RELEASE_SLACK_NS
        return present.ends_fleet_ns - round(needs_ns)

    async def release_following(self) -> None:
        """Decide and start the step behind the present one. Raises `Refusal`: nothing of it is loaded."""
        self.state.require_not_paused()
        await self._start(ignore_state)

    async def withdraw_waiting(self) -> None:
        """Have the member drop the step if it still waits for the end of the present one."""
        (member,) = self._agreement.proposals
        request = DisarmRequest(**self._reference(), if_waiting=True)
        await self._requests.request(member, "disarm", request, DisarmedReply, ANSWER_S)

    # Inside

    async def _start(self, on_state: StateCallback) -> None:
        """Decide, and have the member start the step; its answer comes once it is released. Raises `Refusal`; the
        member is unloaded, or stopped."""
        state, agreement = self.state, self._agreement
        agreement.advance_ns = agreement.tick_residual_ns = 0
        # The axes move after this instant; it stands for T0 until the member has chosen that.
        state.t0_fleet_ns = state.settled_fleet_ns = self._leadership.fleet_now_ns()
        await on_state("arming", "")
        await self._record_decision(on_state)
        state.decided, decided_ns = True, state.t0_fleet_ns
        self._estimator.record_deciding(self._leadership.fleet_now_ns() - decided_ns)
        try:
            # What came while its decision was written.
            state.require_not_paused()
            self._permit_watch.require_held()
            if self._leadership.over:
                raise Refusal("leadership-lost", "another coordinator has taken over")
            await self._request_start()
        except Refusal:
            await self.disarm()
            if state.unloaded:
                state.t0_fleet_ns = decided_ns
                await self._withdraw_decision()
                state.require_not_paused()
            raise

    async def _request_start(self) -> None:
        agreement, state = self._agreement, self.state
        ((member, proposal),) = agreement.proposals.items()
        costs, present = proposal.costs, agreement.present
        # Generous, because T0 is brought forward.
        lead_ns = 0 if costs is None else ARM_FACTOR * costs.arm_ns + costs.disarm_ns
        options = self._negotiation.start_options(agreement, [member])[member]
        request = StartAtOnceRequest(
            **self._reference(),
            digest=self._fleet.view.fleet.controllers[member].digest,
            decided_fleet_ns=state.t0_fleet_ns,
            after_step=None if present is None else present.step,
            lead_ns=lead_ns,
            not_before_fleet_ns=0 if present is None else present.planned_end_ns + present.between.pause_ns,
            start_tolerance_ns=agreement.start_tolerance_ns,
            profiles=agreement.profiles(member),
            start=options,
        )
        wait_ns = 0 if present is None else max(0, present.ends_fleet_ns - self._leadership.fleet_now_ns())
        timeout_s = ANSWER_S + (wait_ns + 2 * lead_ns) / NS_PER_S
        reply = await self._requests.repeat_request(member, "start-at-once", request, StartedReply, timeout_s)
        if reply.refused is not None:
            raise reply.refused.as_step_error()
        state.armed, state.t0_fleet_ns = {member: reply}, reply.t0_fleet_ns
        with suppress(Refusal):  # a start outside of what is allowed is part of its verdict
            self._negotiation.judge(agreement, state.armed)
