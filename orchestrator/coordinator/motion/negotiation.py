"""Negotiation of a start: what the members can make of a plan, how they start together, and the budget of that."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import ceil, inf

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.motion.alignment import TickGrid, find_closest_ticks
from orchestrator.coordinator.motion.budget import (
    StartWindow,
    make_budget,
    make_deviations,
    predict_end,
    predict_path,
)
from orchestrator.coordinator.motion.chain import END_SEEN_NS, PresentMove
from orchestrator.coordinator.motion.path_bound import make_path_bound, require_tolerance
from orchestrator.coordinator.motion.path_chunks import FirstChunk, plan_first_chunk
from orchestrator.coordinator.motion.planning import PlannedStep
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.targets import ResolvedMove
from orchestrator.coordinator.motion.trigger import TriggerStart
from orchestrator.coordinator.switching.outputs import StepTriggers
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet, TriggerWire
from orchestrator.model.messages import (
    ArmedReply,
    BudgetTerm,
    Proposal,
    ProposeRequest,
    StartOptions,
    raise_first_refusal,
    sum_terms,
)
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.numbers import format_ns
from orchestrator.model.profile import Profile
from orchestrator.model.report import PathReport, PredictedSkew, SyncBudget
from orchestrator.model.state import StepCosts
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import StepPlan

ROUNDS = 3
END_SKEW_NS = 20 * NS_PER_MS  # of lowered durations, where the job does not state it
# A member that ends this much later, a twentieth of a servo tick, does not need another round. Quantised ramps of an
# SMC-4000 make moves of a tenth of a second longer by half of it.
SAME_DURATION_S = 50e-6
SPARE_LEAD_FACTOR = 2  # on the known need
LEAD_FACTOR = 1.25  # on the need of the same members in their last step, so that a slower step needs no extra round
READING_NS = 500 * NS_PER_MS  # maximum age of the last clock reading when arming begins
TRIGGER_RATE = "trigger-rate"  # code of triggers that follow faster than the make plays them
MAX_TOLERANCE_NS = 50 * NS_PER_MS
"""A start that is later than promised by more than this was not delayed by load: its host was suspended."""


@dataclass(slots=True)
class StartAgreement:
    """What the members of a step have agreed on.

    line: the trigger line that starts members, if one does. lead_ns: time from arming to T0, for which the proposals
    hold. path: of a path, with its bound. advance_ns: how much earlier than armed the step starts; within
    tick_residual_ns a whole number of the ticks of every member. aligned: T0 is an instant at which ticks coincide, and
    is not advanced. not_before_ns: T0 is not before that, fleet time. first: of a path that members execute in chunks.
    """

    plan: StepPlan
    line: TriggerStart | None = None
    proposals: dict[str, Proposal] = field(default_factory=dict[str, Proposal])
    lead_ns: int = 0
    budget: SyncBudget | None = None
    path: PathReport | None = None
    advance_ns: int = 0
    tick_residual_ns: int = 0
    aligned: bool = False
    not_before_ns: int = 0
    present: PresentMove | None = None
    first: FirstChunk | None = None
    triggers: StepTriggers = field(default_factory=StepTriggers)
    _shares: "tuple[StepPlan, dict[str, dict[str, Profile]]] | None" = None

    @property
    def movers(self) -> list[str]:
        """The members that have axes in the step."""
        return list(dict.fromkeys(controller_of(axis) for axis in self.plan.profiles))

    @property
    def members(self) -> list[str]:
        """The movers, the controller that drives their trigger line, and those that switch outputs on the way."""
        drivers = [] if self.line is None else [self.line.driver]
        return list(dict.fromkeys([*drivers, *self.movers, *self.triggers.owners]))

    @property
    def actors(self) -> list[str]:
        """The members that are stopped with the step: the movers, and those that switch outputs on the way."""
        return list(dict.fromkeys([*self.movers, *self.triggers.owners]))

    @property
    def disarm_ns(self) -> int:
        """How long before T0 the step can last be withdrawn for certain, as the members declare it: their controllers
        decide this long before their start, so a fast link does not shorten it."""
        return max(
            (proposal.costs.disarm_ns for proposal in self.proposals.values() if proposal.costs is not None), default=0
        )

    @property
    def start_tolerance_ns(self) -> int:
        """How much later than promised a member may start within what the job allows: a slightly late start is better
        than none. 0 where a trigger line starts members, which rely on its promise, and on a path of several, whose
        bound is made of what they promise."""
        if self.budget is None or self.line is not None or (self.path is not None and len(self.movers) > 1):
            return 0
        # A single axis cannot be late relative to another.
        return MAX_TOLERANCE_NS if len(self.plan.profiles) == 1 else min(self.budget.margin_ns, MAX_TOLERANCE_NS)

    @property
    def can_advance(self) -> bool:
        """Whether T0 can be brought forward after arming."""
        return (
            self.line is None and not self.aligned and all(proposal.can_advance for proposal in self.proposals.values())
        )

    @property
    def loads_later(self) -> list[str]:
        """Of a step that follows: the members that load it only after the end of the present one."""
        return [name for name, proposal in self.proposals.items() if proposal.gap_ns is None] if self.present else []

    @property
    def follows_ns(self) -> int:
        """The earliest T0 of a step that follows, for the members that hold it beside the present one, fleet time."""
        if self.present is None:
            return self.not_before_ns
        gaps = [proposal.gap_ns for proposal in self.proposals.values() if proposal.gap_ns is not None]
        return max(
            self.present.ends_fleet_ns + self.present.between.pause_ns,
            self.present.planned_end_ns + max(gaps, default=0),
        )

    def longest_ns(self, *, with_start: bool) -> int:
        """From T0 until all its members have ended, ns. with_start: the latest start that they promise included."""
        return max(
            (sum_terms(proposal.terms)[1] if with_start else 0)
            + round(max(proposal.durations_s.values(), default=0.0) * (1 + proposal.clock_ppm * 1e-6) * NS_PER_S)
            for proposal in self.proposals.values()
        )

    def profiles(self, member: str) -> dict[str, Profile]:
        """The member's share of the plan, by its own axis names."""
        if self._shares is None or self._shares[0] is not self.plan:
            shares: dict[str, dict[str, Profile]] = {}
            for axis, profile in self.plan.profiles.items():
                controller, name = split_name(axis)
                shares.setdefault(controller, {})[name] = profile
            self._shares = self.plan, shares
        return self._shares[1].get(member, {})

    def shift_ns(self, member: str) -> int:
        """How much later than T0 the member's own T0 is."""
        return 0 if self.line is None or self.line.covers(member) else self.line.shift_ns

    def choose_start(self, from_ns: int, within_ns: int = 0) -> int:
        """The instant from `from_ns` on, fleet time, at which the members' ticks coincide best."""
        grids = [
            TickGrid(proposal.tick_at_fleet_ns, proposal.tick_ns)
            for member, proposal in self.proposals.items()
            if proposal.tick_at_fleet_ns is not None and self.profiles(member)
        ]
        return find_closest_ticks(grids, max(from_ns, self.not_before_ns), within_ns)[0]

    def start_window(self, member: str, terms: list[BudgetTerm]) -> StartWindow:
        """The window of the member's start around T0, from the terms that it states."""
        shift_ns, residual_ns, line = self.shift_ns(member), self.tick_residual_ns, self.line
        if residual_ns and self.proposals[member].tick_ns:
            terms = [*terms, BudgetTerm(name="tick-residual", earliest_ns=-residual_ns, latest_ns=residual_ns)]
        if shift_ns:
            terms = [BudgetTerm(name="line", earliest_ns=shift_ns, latest_ns=shift_ns), *terms]
        return StartWindow(terms, None if line is None or member not in line.waiters else line.edge)


class StartNegotiation:
    """Negotiates the start of one planned step with its members."""

    def __init__(self, services: MotionServices, planned: PlannedStep, present: PresentMove | None = None) -> None:
        """present: the moving step that it follows."""
        self._present = present
        self._now_ns = services.leadership.fleet_now_ns
        self._view = services.fleet.view
        self._requests = services.fleet.requests
        self._estimator = services.estimator
        self._planned = planned
        self._triggers = StepTriggers(planned.triggers)
        self._request = planned.request
        self._early_ns = self._request.max_end_skew_ns or END_SKEW_NS

    async def agree(self) -> StartAgreement:
        """Agree on plan, lead, budget, and the trigger line, if one starts the step. Raises `Refusal`.

        A trigger line is used where it reduces the predicted start skew, or where the step demands one.
        """
        if self._present is not None:
            return await self._agree_following()
        chunk = await self._plan_first_chunk()
        plan, by_line = chunk.plan if chunk else self._planned.plan, self._request.start_class == "line"
        first = StartAgreement(plan, aligned=bool(self._request.move.align), first=chunk, triggers=self._triggers)
        # Instants on the way are counted from a T0 by the clock, and T0 of a line cannot be brought forward.
        wires = self._request.choose_wires([] if self._triggers.owners else self._view.fleet.wiring)
        lines = [line for wire in wires if (line := await self._find_line(wire, first)) is not None]
        if by_line and not lines:
            raise Refusal(
                "start-class",
                "a step with triggers starts by the clock of its controllers"
                if self._triggers.owners
                else f"no trigger line is wired to an input that {' or '.join(first.movers)} can wait for",
                "add `wiring` to the fleet file, or remove `start` from the step",
            )
        candidates = [replace(first, line=line) for line in ([] if by_line else [None]) + lines]
        last_refusal: Refusal | None = None
        best_agreement: StartAgreement | None = None
        for candidate in candidates if len(plan.profiles) > 1 or by_line else candidates[:1]:
            try:
                await self._negotiate_rounds(candidate)
            except Refusal as refusal:
                last_refusal = last_refusal or refusal
                continue
            if best_agreement is None or _predicted_ns(candidate) < _predicted_ns(best_agreement):
                best_agreement = candidate
        if best_agreement is None:
            assert last_refusal is not None
            raise last_refusal
        return best_agreement

    async def _plan_first_chunk(self) -> FirstChunk | None:
        """The first chunk of a path, if members can execute it in chunks, its triggers included. Raises `Refusal`."""
        planned_step = self._planned
        if planned_step.path is None:
            return None
        movers = [controller_of(axis) for axis in planned_step.plan.profiles]
        members = dict.fromkeys([*movers, *self._triggers.owners])
        await self._view.infos.prefetch(members)
        try:
            infos = {member: await self._view.infos.require(member) for member in members}
            return plan_first_chunk(planned_step, infos)
        except PlanError as error:
            raise Refusal("plan", str(error)) from None

    async def _agree_following(self) -> StartAgreement:
        """Agree on a step that follows a moving one: each member starts it by its own clock, or by its host."""
        agreement = StartAgreement(self._planned.plan, present=self._present)
        await self._negotiate_rounds(agreement)
        return agreement

    def earliest_following_ns(self, agreement: StartAgreement) -> int:
        """The earliest T0 of a step that follows, fleet time, with the loading after the end of the present one."""
        present = agreement.present
        earliest_ns = max(agreement.follows_ns, self._now_ns() + self.needed_ns(agreement, use_known=True))
        if present is None or not (agreement.loads_later or present.between.acts):
            return earliest_ns
        proposals_later = {name: proposal for name, proposal in agreement.proposals.items() if proposal.gap_ns is None}
        # Promise and release are an exchange each, with nothing to check in between.
        releasing_ns = 2 * self._estimator.go_ns(len(agreement.proposals), follows=True) + agreement.disarm_ns
        shares = {name: self._estimator.arming_share(name, "behind") for name in proposals_later}
        begun_ns = find_arming_ns(self._view.fleet, proposals_later, shares)
        if not self._estimator.knows_loading(proposals_later):
            begun_ns += END_SEEN_NS
        if present.between.acts:
            begun_ns = max(begun_ns, present.between.pause_ns + self._estimator.acting_ns)
        return max(earliest_ns, present.ends_fleet_ns + round(begun_ns) + releasing_ns)

    async def renegotiate(self, agreement: StartAgreement, growth: int | None, hold_ns: int = 0) -> None:
        """Get new proposals for another lead time, over which clock bounds must hold. Raises `Refusal`.

        growth: factor on the declared lead time; None: the lead time as for the first arming. hold_ns: added to it.
        """
        lead_ns = self._lead_ns(agreement) if growth is None else growth * self.needed_ns(agreement, use_known=False)
        agreement.lead_ns = lead_ns + hold_ns
        await self._propose(agreement)

    def judge(self, agreement: StartAgreement, stated: Mapping[str, Proposal] | Mapping[str, ArmedReply]) -> None:
        """Compute the budget from what the members state now. Raises `Refusal` if the job does not allow it."""
        request, movers = self._request, set(agreement.movers)
        windows = {
            name: agreement.start_window(name, statement.terms) for name, statement in stated.items() if name in movers
        }
        agreement.budget = budget = make_budget(windows, request.max_start_skew_ns)
        if budget.predicted_ns > budget.allowed_ns and len(agreement.plan.profiles) > 1:
            note = _describe_learned(budget)
            raise Refusal(
                "start-skew",
                f"predicted start skew {format_ns(budget.predicted_ns)} > {format_ns(budget.allowed_ns)}; worst is "
                f"{budget.worst_member}, by its {budget.worst_term}{note}",
                "allow more with `max_start_skew`, or improve that member's link"
                if not note
                else "wait some minutes, allow more with `max_start_skew`, or, if the cause is gone, "
                "`tutti clock forget`; `tutti clock ls` shows what was learned",
                budget.worst_member,
            )
        profiles = {member: agreement.profiles(member) for member in movers}
        deviations = make_deviations(agreement.proposals, profiles, agreement.plan.duration_s)
        if request.is_synchronised and agreement.first is None:
            end = predict_end(budget, deviations, request.max_end_skew_ns)
            path = predict_path(budget, deviations, request.max_path_skew_ns)
            agreement.budget = budget.model_copy(update={"end": end, "path": path})
            _require_allowed("end", end)
            _require_allowed("path", path)
        if self._planned.path is not None:
            path, first = self._planned.path, agreement.first
            within_s = {} if first is None else dict.fromkeys(first.members, first.most_s + first.load_s)
            bound = make_path_bound(path, agreement.proposals, windows, within_s)
            require_tolerance(bound, agreement.movers)
            duration_s = agreement.plan.duration_s if first is None else first.course.duration_s
            agreement.path = path.make_report(duration_s, bound)

    def advance(self, agreement: StartAgreement, armed: Mapping[str, ArmedReply], spare_ns: int) -> None:
        """Bring T0 forward by up to `spare_ns`, the lead time that arming and promises have not used, as far as the
        budget allows."""
        agreement.advance_ns, agreement.tick_residual_ns = _find_advance(agreement, spare_ns, self._request.tick_share)
        if agreement.tick_residual_ns:
            budget = agreement.budget
            try:
                self.judge(agreement, armed)
            except Refusal:
                # Without the advance it is within the budget.
                agreement.advance_ns, agreement.tick_residual_ns, agreement.budget = 0, 0, budget

    def start_options(self, agreement: StartAgreement, members: Iterable[str]) -> dict[str, StartOptions]:
        """The start options of each of `members`."""
        lead_ns, line, wish = agreement.lead_ns + READING_NS, agreement.line, self._request.start_class
        common = {
            # On a path no common time keeps braking axes on it: the shortest one leaves it least.
            "brake_s": 0.0 if self._planned.path else _longest_braking_s(self._planned.resolved, agreement.plan),
            "early_ns": self._early_ns,
            "follows": agreement.present is not None,
            "waits_armed": self._request.wait is not None,
        }
        start_class = "auto" if wish == "line" else wish
        first = agreement.first
        outputs = agreement.triggers.find_outputs(agreement.plan) if first is None else first.find_outputs()
        return {
            member: (
                line.start_options(member, lead_ns)
                if line is not None and line.covers(member)
                else StartOptions(start_class=start_class, lead_ns=lead_ns)
            ).model_copy(
                update={
                    **common,
                    "chunk": first.make_options(member, first.chunk)
                    if first is not None and member in first.members
                    else None,
                    "triggers": outputs.get(member, []),
                }
            )
            for member in members
        }

    # Rounds

    async def _find_line(self, wire: TriggerWire, agreement: StartAgreement) -> TriggerStart | None:
        """The trigger line of `wire`, if it leads to members that can wait for it and its driver is online."""
        # A controller that drives a line cannot wait for it as well.
        movers = set(agreement.movers) - {controller_of(wire.from_)}
        try:
            waiters = {
                member: name
                for member, name in map(split_name, wire.to)
                if member in movers and "line" in (await self._view.infos.query(member)).start_classes
            }
            line = TriggerStart(wire, waiters)
            online = waiters and (await self._view.query_state(line.driver)).mode != "offline"
        except BusError:
            return None
        return line if online else None

    async def _negotiate_rounds(self, agreement: StartAgreement) -> None:
        """At most three rounds: the duration becomes the longest answer, and the lead time what arming needs, until
        all members can satisfy both. Raises `Refusal`."""
        durations: dict[str, float] = {}
        # The lead time of the same members' last step usually saves a round; bounds over a longer one would be wider.
        movers = frozenset(agreement.movers)
        agreement.lead_ns = agreement.lead_ns or round(LEAD_FACTOR * self._estimator.last_leads_ns.get(movers, 0))
        is_synchronised = self._request.is_synchronised and agreement.first is None
        for _ in range(ROUNDS):
            await self._propose(agreement)
            durations = {
                f"{member}.{axis}": duration_s
                for member, proposal in agreement.proposals.items()
                for axis, duration_s in proposal.durations_s.items()
            }
            longest_s, lead_ns = max(durations.values()), self._lead_ns(agreement)
            fits = not is_synchronised or longest_s <= agreement.plan.duration_s + SAME_DURATION_S
            if fits and lead_ns <= agreement.lead_ns:
                agreement.lead_ns = lead_ns
                break
            agreement.lead_ns = max(lead_ns, agreement.lead_ns)
            if not fits:
                agreement.plan = agreement.plan.stretch_to(longest_s)
        if is_synchronised:
            self._require_same_duration(durations, agreement.plan.duration_s)
        if not self._planned.rehearsal and agreement.present is None:
            self._estimator.last_leads_ns[movers] = agreement.lead_ns
        self.judge(agreement, agreement.proposals)

    def _require_same_duration(self, durations: Mapping[str, float], planned_s: float) -> None:
        worst = max(durations, key=lambda axis: abs(durations[axis] - planned_s))
        off_ns = round(abs(durations[worst] - planned_s) * NS_PER_S)
        if off_ns > self._early_ns:
            raise Refusal(
                "end-skew",
                f"axis {worst} would end {format_ns(off_ns)} off the plan; {format_ns(self._early_ns)} are allowed",
                "move further or faster, or allow more with `max_end_skew`",
                controller_of(worst),
            )

    async def _propose(self, agreement: StartAgreement) -> None:
        """Get proposals of all members; first of the driver of a trigger line, because the window of its edge is part
        of what the waiters state."""
        line = agreement.line
        proposals: dict[str, Proposal] = {}
        if line is not None:
            proposals = await self._request_proposals(agreement, [line.driver])
            edge = proposals[line.driver].edge
            if not edge:
                raise Refusal(
                    "start-class", f"{line.driver} cannot drive a trigger line", "wire it from another controller"
                )
            line = agreement.line = replace(line, edge=sum_terms(edge))
        other_members = [member for member in agreement.members if member not in proposals]
        proposals |= await self._request_proposals(agreement, other_members)
        agreement.proposals = {member: proposals[member] for member in agreement.members}
        if line is not None:
            middles = [sum(sum_terms(proposals[member].terms)) // 2 for member in line.waiters]
            agreement.line = replace(line, shift_ns=sum(middles) // len(middles))

    async def _request_proposals(self, agreement: StartAgreement, members: Iterable[str]) -> dict[str, Proposal]:
        request = self._request
        requests = {
            member: ProposeRequest(
                **self._requests.request_fields(request.job.actor),
                job=request.job_id,
                step=request.index,
                digest=self._view.fleet.controllers[member].digest,
                duration_s=agreement.plan.duration_s,
                profiles=agreement.profiles(member),
                start=options,
                rehearsal=self._planned.rehearsal,
            )
            for member, options in self.start_options(agreement, members).items()
        }
        proposals = await self._requests.request_all("propose", requests, Proposal)
        raise_first_refusal(proposals)
        return proposals

    # Lead times

    def _lead_ns(self, agreement: StartAgreement) -> int:
        """The lead time to use. Where T0 can be brought forward, an unused lead costs nothing, so a generous one saves
        a second arming of a member that is slow once."""
        known_ns = self.needed_ns(agreement, use_known=True)
        if agreement.present is not None:
            return self.earliest_following_ns(agreement) - self._now_ns()
        if agreement.can_advance:
            return min(SPARE_LEAD_FACTOR * known_ns, self.needed_ns(agreement, use_known=False))
        return known_ns

    def needed_ns(self, agreement: StartAgreement, *, use_known: bool) -> int:
        """The lead time that the members need, as measured if `use_known`, else as declared."""
        margin_ns = self._estimator.margin_ns(len(agreement.proposals), use_known=use_known)
        at_once = {
            name: proposal for name, proposal in agreement.proposals.items() if name not in agreement.loads_later
        }
        kind = "rest" if agreement.present is None else "beside"
        shares = {name: self._estimator.arming_share(name, kind, use_known=use_known) for name in at_once}
        return round(find_arming_ns(self._view.fleet, at_once, shares)) + margin_ns + agreement.disarm_ns


async def agree_on_start(
    services: MotionServices, planned: PlannedStep, present: PresentMove | None = None
) -> tuple[StartNegotiation, StartAgreement]:
    """Negotiate the start of a planned step. Triggers that follow too fast for the chunks of a path may be a little
    closer where it is loaded as a whole. Raises `Refusal`. present: the moving step that it follows."""
    negotiation, path = StartNegotiation(services, planned, present), planned.path
    try:
        return negotiation, await negotiation.agree()
    except Refusal as refusal:
        if path is None or path.course is None or refusal.code != TRIGGER_RATE:
            raise
    negotiation = StartNegotiation(services, replace(planned, path=replace(path, course=None)))
    return negotiation, await negotiation.agree()


def find_arming_ns(fleet: Fleet, proposals: Mapping[str, Proposal], shares: Mapping[str, float]) -> float:
    """The time that arming these members takes. shares: of the time that each declares."""
    lines: dict[str, list[tuple[StepCosts, float]]] = {}
    for member, proposal in proposals.items():
        if proposal.costs is not None:
            lines.setdefault(fleet.controllers[member].line, []).append((proposal.costs, shares[member]))
    return max(map(_line_arming_ns, lines.values()), default=0.0)


def _line_arming_ns(line: list[tuple[StepCosts, float]]) -> float:
    """The arming time of the members on one line. With several, a share above 1 is waiting for the others."""
    arming_ns = [costs.arm_ns * (share if len(line) == 1 else min(1.0, share)) for costs, share in line]
    return max(arming_ns) if all(costs.interleaved for costs, _ in line) else sum(arming_ns)


def _find_advance(agreement: StartAgreement, spare_ns: int, tick_share: float) -> tuple[int, int]:
    """How much T0 can advance, and how far that is at most from a whole number of any member's ticks: an advance by
    whole ticks leaves what is armed unchanged. (0, 0) if a member cannot advance."""
    if not agreement.can_advance:
        return 0, 0
    spare_ns = max(0, spare_ns)
    ticks_ns = [proposal.tick_ns for proposal in agreement.proposals.values() if proposal.tick_ns]
    if not ticks_ns:
        return spare_ns, 0
    shortest_ns, longest_ns = min(ticks_ns), max(ticks_ns)
    tick_ns, off_ns = (shortest_ns + longest_ns) / 2, (longest_ns - shortest_ns) / 2
    count = min(spare_ns // tick_ns, tick_share * tick_ns / off_ns if off_ns else inf) // 1
    # Instants are whole nanoseconds.
    return round(count * tick_ns), ceil(count * off_ns) + 1 if count else 0


def _longest_braking_s(resolved: ResolvedMove, plan: StepPlan) -> float:
    """How long the axis that brakes slowest needs from its peak velocity."""
    braking_s = (
        plan.profiles[move.axis].peak_velocity / move.acceleration
        for move in resolved.moves
        if move.axis in plan.profiles
    )
    return max(braking_s, default=0.0)


def _describe_learned(budget: SyncBudget) -> str:
    """The members whose earlier starts widen the budget, in words; nothing without them."""
    wider = {
        name: term.latest_ns - term.earliest_ns
        for name, member in budget.members.items()
        for term in member.terms
        if term.name == "learned-starts"
    }
    text = ", ".join(f"{name} by {format_ns(width_ns)}" for name, width_ns in wider.items())
    return f"; unusual starts of the last minutes widen it: {text}" if text else ""


def _require_allowed(what: str, skew: PredictedSkew | None) -> None:
    if skew is not None and skew.allowed_ns is not None and skew.predicted_ns > skew.allowed_ns:
        raise Refusal(
            f"{what}-skew",
            f"predicted {what} skew {format_ns(skew.predicted_ns)} > {format_ns(skew.allowed_ns)}; worst is "
            f"{skew.worst_member}",
            f"allow more with `max_{what}_skew`, or use a faster or shorter move, which leaves its crystal less time "
            "to drift",
            skew.worst_member,
        )


def _predicted_ns(agreement: StartAgreement) -> int:
    assert agreement.budget is not None
    return agreement.budget.predicted_ns
