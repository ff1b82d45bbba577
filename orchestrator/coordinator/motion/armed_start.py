"""The start of a step that waits armed: loaded in all members, and released when the wait ends with an order.

The members are armed for a T0 that lies some seconds ahead, as far as their clock bounds allow, and again before that.
With the order T0 is brought forward as far as all members can be released: promises, decision and release come after
the order, as for any step. Where a member cannot bring T0 forward, all are armed anew with the order.
"""

import asyncio

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.fleet.permits import PermitWatch
from orchestrator.coordinator.motion.armed_wait import ArmedWait, GoOrder
from orchestrator.coordinator.motion.chain import RELEASE_SLACK, RELEASE_SLACK_NS
from orchestrator.coordinator.motion.negotiation import StartAgreement, StartNegotiation
from orchestrator.coordinator.motion.planning import PlannedStep
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import LATE, LEAD_GROWTH, StartSequence, StateCallback
from orchestrator.model.errors import Refusal
from orchestrator.model.numbers import format_ns
from orchestrator.model.report import ArmedReport, ArmedState

HOLDS_NS = tuple(seconds * NS_PER_S // 4 for seconds in (80, 40, 20, 10, 5))
"""How far ahead of the lead time T0 may lie while a step waits; the first that the budget allows."""
EXCHANGE_NS = 20 * NS_PER_MS  # for unloading, and for new proposals, before members are armed anew
SAME_INSTANT_NS = 2 * NS_PER_MS  # by which T0 may be later than the one asked for: ticks of controllers


class ArmedStart(StartSequence):
    """Starts one step that waits armed."""

    def __init__(
        self,
        services: MotionServices,
        planned: PlannedStep,
        negotiation: StartNegotiation,
        agreement: StartAgreement,
        permit_watch: PermitWatch,
    ) -> None:
        super().__init__(services, planned.request, negotiation, agreement, permit_watch)
        self._wait = ArmedWait(services, planned, agreement.members, permit_watch)
        self._holds_ns = list(HOLDS_NS)
        self._is_waiting = False
        self._advances = False
        """T0 can be brought forward to the order; otherwise the members are armed anew."""
        self._order: GoOrder | None = None

    @property
    def armed(self) -> ArmedState | None:
        """On which terms it waits; None while it does not."""
        if not self._is_waiting:
            return None
        terms = self._wait.terms
        return ArmedState(
            input=terms.input,
            since_fleet_ns=self._wait.began_ns,
            until_fleet_ns=self._wait.ends_ns,
            lead_ns=self._lead_ns,
            most_lead_ns=self._most_lead_ns,
        )

    async def go(self, at_fleet_ns: int | None) -> int:
        """Start the step that waits: at once, or at that instant, fleet time; return T0, once it is agreed, or that
        instant before it is. Raises `Refusal`."""
        if self._order is not None or self._wait.order is not None:
            raise Refusal("begun", "the step was started already", "")
        if not self._is_waiting:
            raise Refusal("not-armed", "the step is not armed yet", "ask again when its job is `armed`")
        if at_fleet_ns is not None:
            self._require_possible(at_fleet_ns)
        order = self._wait.give_go(at_fleet_ns)
        return await asyncio.shield(order.settled) if at_fleet_ns is None else at_fleet_ns

    def pause(self, actor: str) -> None:
        """End the wait, unless the order to start has come: the step waits anew when its job is resumed."""
        if self._is_waiting and self._wait.order is None and self.state.paused_by is None:
            self.state.paused_by = actor
            self._wait.note_pause()

    async def run(self, on_state: StateCallback) -> None:
        """Arm the members, wait, and release them. Raises `Refusal`: nothing moves."""
        try:
            self._order = await self._wait_armed(on_state)
            self._is_waiting = False
            await self._start(on_state, self._order)
            t0_ns = self.state.t0_fleet_ns
            self.state.waited = ArmedReport(
                since_fleet_ns=self._wait.began_ns,
                go_fleet_ns=self._order.go_fleet_ns,
                by=self._order.by,
                lead_ns=t0_ns - self._order.go_fleet_ns,
            )
            self._order.settled.set_result(t0_ns)
        except Refusal as refusal:
            if self._order is not None and not self._order.settled.done():
                self._order.settled.set_exception(refusal)
                self._order.settled.exception()  # an input does not wait for it
            raise
        finally:
            self._is_waiting = False
            self._wait.close()

    # The wait

    async def _wait_armed(self, on_state: StateCallback) -> GoOrder:
        """Arm all members, again and again, until the order to start comes. Raises `Refusal`; all are disarmed."""
        wait = self._wait
        await on_state("arming", "")
        await self._load()
        try:
            wait.begin()
            self._is_waiting = True
            await on_state("armed", wait.words)
            while True:
                order = await wait.wait_for_order(self._find_due_ns)
                self.state.require_not_paused()
                if order is not None and self._is_near(order.at_fleet_ns):
                    return order
                wait.note_unloading()
                await self._unload()
                await self._load()
        except Refusal:
            wait.note_unloading()
            await self.disarm()
            raise

    async def _load(self) -> None:
        """Arm all members for a T0 far ahead. Raises `Refusal`; all are disarmed."""
        state, agreement = self.state, self._agreement
        tries = len(LEAD_GROWTH)
        while True:
            await self._extend_lead()
            state.arming_fleet_ns = self._leadership.fleet_now_ns()
            agreement.advance_ns = agreement.tick_residual_ns = 0
            state.t0_fleet_ns = agreement.choose_start(state.arming_fleet_ns + agreement.lead_ns)
            try:
                await self._arm()
                await self._judge_frozen_mappings()
            except Refusal as refusal:
                tries -= 1
                is_late = refusal.code in LATE and state.unloaded
                if tries and refusal.code == "start-skew" and len(self._holds_ns) > 1:
                    del self._holds_ns[0]
                elif not (tries and is_late):
                    raise
            else:
                self._wait.note_armed()
                self._advances = self._allows_advance()
                return

    async def _extend_lead(self) -> None:
        """Get proposals for a T0 as far ahead as the budget allows. Raises `Refusal`."""
        while True:
            await self._negotiation.renegotiate(self._agreement, None, self._holds_ns[0])
            try:
                self._negotiation.judge(self._agreement, self._agreement.proposals)
            except Refusal:
                if len(self._holds_ns) == 1:
                    raise
                del self._holds_ns[0]
            else:
                return

    def _allows_advance(self) -> bool:
        """Whether T0 can be brought forward to this moment, to within a tick, within the budget."""
        agreement = self._agreement
        spare_ns = self.state.t0_fleet_ns - self._leadership.fleet_now_ns()
        self._negotiation.advance(agreement, self.state.armed, spare_ns)
        advanced_ns, agreement.advance_ns, agreement.tick_residual_ns = agreement.advance_ns, 0, 0
        return advanced_ns > 0 and advanced_ns >= spare_ns - max(
            proposal.tick_ns for proposal in agreement.proposals.values()
        )

    async def _unload(self) -> None:
        await self.disarm()
        if not self.state.unloaded:
            raise Refusal("not-unloaded", "a member could not be unloaded to be armed anew", "submit the job again")

    @property
    def _lead_ns(self) -> int:
        """From the order to T0, as long as the members stay armed."""
        agreement = self._agreement
        if not self._advances:
            return self._anew_ns
        margin_ns = RELEASE_SLACK * self._estimator.margin_ns(len(agreement.proposals))
        return round(margin_ns) + agreement.disarm_ns + RELEASE_SLACK_NS

    @property
    def _anew_ns(self) -> int:
        """From the order to T0 where the members are armed anew."""
        return self._negotiation.needed_ns(self._agreement, use_known=True) + 2 * EXCHANGE_NS

    @property
    def _most_lead_ns(self) -> int:
        """From the order to T0 at most: the order comes while the members are being armed anew."""
        arming_ns = self._negotiation.needed_ns(self._agreement, use_known=False) + 2 * EXCHANGE_NS
        return arming_ns + self._lead_ns

    @property
    def _reload_ns(self) -> int:
        """When the members must be armed anew: until then they can still be released."""
        return self.state.t0_fleet_ns - self._lead_ns

    def _find_due_ns(self) -> int:
        """Until when to wait: for the instant that is asked for, or until the members must be armed anew."""
        order = self._wait.order
        if order is None or order.at_fleet_ns is None:
            return self._reload_ns
        return min(self._reload_ns, order.at_fleet_ns - self._lead_ns)

    def _is_near(self, at_fleet_ns: int | None) -> bool:
        """Whether the start must begin for this instant: it is due, or the members cannot be armed once more for the
        wait before it."""
        if at_fleet_ns is None or self._leadership.fleet_now_ns() >= at_fleet_ns - self._lead_ns:
            return True
        is_reloading = self._leadership.fleet_now_ns() >= self._reload_ns
        return is_reloading and at_fleet_ns - self._leadership.fleet_now_ns() <= self._most_lead_ns

    def _require_possible(self, at_fleet_ns: int) -> None:
        """Raise `Refusal` for an instant that is nearer than the lead, or after the end of the wait."""
        now_ns, lead_ns = self._leadership.fleet_now_ns(), self._lead_ns
        ahead_ns = at_fleet_ns - now_ns
        if ahead_ns < lead_ns:
            place_words = f"{format_ns(-ahead_ns)} ago" if ahead_ns < 0 else f"only {format_ns(ahead_ns)} ahead"
            text = f"fleet time {at_fleet_ns} ns is {place_words}; the nearest possible is {now_ns + lead_ns} ns"
            raise Refusal("too-near", text, f"ask for one that is {format_ns(lead_ns)} ahead, or without an instant")
        if at_fleet_ns > self._wait.ends_ns:
            text = f"fleet time {at_fleet_ns} ns is after the end of the wait at {self._wait.ends_ns} ns"
            raise Refusal("too-late", text, "allow a longer wait with `timeout`")

    # The start

    async def _start(self, on_state: StateCallback, order: GoOrder) -> None:
        """Release the members for the earliest T0, or for the one asked for. Raises `Refusal`; all are disarmed."""
        not_before_ns = self._agreement.not_before_ns = order.at_fleet_ns or 0
        # Members that have waited compare what is loaded before they promise, which takes as long as ever.
        self.state.usual_promise_ns = self._estimator.promise_ns
        if self._advances and not_before_ns <= self.state.t0_fleet_ns:
            try:
                await self._release(on_state, 1)
            except Refusal as refusal:
                if refusal.code not in LATE or not self.state.unloaded:
                    raise
                if self.state.decided:
                    await self._withdraw_decision()
            else:
                return
        else:
            await self._unload()
        self.state.require_not_paused()
        await self._negotiation.renegotiate(self._agreement, None)
        await super().run(on_state)

    async def _record_decision(self, on_state: StateCallback) -> None:
        """T0 is settled: for an order with an instant, it must be that one."""
        order = self._order
        if order is not None and order.at_fleet_ns is not None:
            late_ns = self.state.t0_fleet_ns - order.at_fleet_ns
            if late_ns > SAME_INSTANT_NS:
                await self.disarm()
                text = f"the members could be released {format_ns(late_ns)} after the instant asked for at the earliest"
                raise Refusal("missed-instant", text, "submit the job again")
        await super()._record_decision(on_state)
