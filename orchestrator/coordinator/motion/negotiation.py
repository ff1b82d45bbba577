"""What members can make of a plan, and how they start together: asked, agreed, and budgeted (design, section 6.2)."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from math import ceil, inf

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.fleet.requests import Members
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.motion.alignment import Grid, closest
from orchestrator.coordinator.motion.budget import Window, make_budget, make_ways, predict_end, predict_path
from orchestrator.coordinator.motion.lead_time import Pace
from orchestrator.coordinator.motion.moving import LineStart, Moving
from orchestrator.coordinator.motion.targets import Refuse, refuse_if_any
from orchestrator.model.duration import format_ns
from orchestrator.model.fleet import Wire
from orchestrator.model.job import Job, Move
from orchestrator.model.messages import Armed, Proposal, Propose, StartWay, Term
from orchestrator.model.report import Predicted
from orchestrator.model.state import Costs

ROUNDS = 3
END_SKEW_NS = 20 * NS_PER_MS  # of lowered durations, where a job says nothing
# A member that ends so much later, the twentieth of a servo tick, is not worth another round. Steps of the ramps in an
# SMC-4000 make moves of a tenth of a second last longer by half of it.
SOON_S = 50e-6
SLIP = 0.02  # of a tick: T0 comes sooner by as many as the members' crystals keep so close together
SPARE_LEAD = 2  # times what is known to be needed
LEAD_ROOM = 1.25  # over what the same members needed last time: a slower step in between is no reason to ask all again
READING_NS = 500 * NS_PER_MS  # the last reading of a controller's clock may be as old when arming begins


class Proposing:
    """Asks the members of a step."""

    def __init__(self, view: FleetView, members: Members) -> None:
        self._view = view
        self._members = members
        self.pace = Pace()
        self._leads_ns: dict[frozenset[str], int] = {}

    async def agree(self, moving: Moving, job: Job, step: Move) -> None:
        """Settle plan, lead, budget, and the line that starts the step, if one does. Raises `Refuse`.

        A line is taken where it makes the predicted start skew smaller, or where the step asks for one.
        """
        moving.early_ns = step.max_end_skew or job.max_end_skew or END_SKEW_NS
        lines = [line for wire in self._view.fleet.wiring if (line := await self._line(wire, moving)) is not None]
        if step.start == "line" and not lines:
            raise Refuse(
                "start-class",
                f"no line is wired to an input that {' or '.join(moving.movers)} can wait for",
                "say `wiring` in the fleet file, or leave `start` to the fleet",
            )
        tries = [replace(moving, line=line) for line in ([] if step.start == "line" else [None]) + lines]
        refused: Refuse | None = None
        agreed: Moving | None = None
        for each in tries if len(moving.plan.profiles) > 1 or step.start == "line" else tries[:1]:
            try:
                await self._rounds(each, job, step)
            except Refuse as refusal:
                refused = refused or refusal
                continue
            if agreed is None or _predicted_ns(each) < _predicted_ns(agreed):
                agreed = each
        if agreed is None:
            assert refused is not None
            raise refused
        moving.plan, moving.line, moving.proposals = agreed.plan, agreed.line, agreed.proposals
        moving.lead_ns, moving.budget = agreed.lead_ns, agreed.budget

    def start(self, moving: Moving, from_ns: int, within_ns: int) -> int:
        """The instant from `from_ns` on, fleet time, at which the members' ticks fall closest together."""
        grids = [
            Grid(each.tick_at_fleet_ns, each.tick_ns)
            for member, each in moving.proposals.items()
            if each.tick_at_fleet_ns is not None and moving.profiles(member)
        ]
        return closest(grids, from_ns, within_ns)[0]

    async def again(self, moving: Moving, step: Move, growth: int | None) -> None:
        """Once more for another lead, that clocks have to hold for. growth: so many times the declared one; None: as
        for the first time."""
        moving.lead_ns = self._lead_ns(moving) if growth is None else growth * self._lead_ns(moving, known=False)
        await self._ask(moving, step)

    def judge(self, moving: Moving, said: Mapping[str, Proposal] | Mapping[str, Armed], job: Job, step: Move) -> None:
        """The budget by what the members say now. Raises `Refuse` if it is not within what the job allows."""
        movers = set(moving.movers)
        windows = {name: _window(moving, name, each.terms) for name, each in said.items() if name in movers}
        moving.budget = budget = make_budget(windows, step.max_start_skew or job.max_start_skew)
        if budget.predicted_ns > budget.allowed_ns and len(moving.plan.profiles) > 1:
            raise Refuse(
                "start-skew",
                f"predicted start skew {format_ns(budget.predicted_ns)} > {format_ns(budget.allowed_ns)}; worst is "
                f"{budget.worst_member}, by its {budget.worst_term}",
                "allow more with `max_start_skew`, or improve that member's link",
                budget.worst_member,
            )
        ways = make_ways(
            moving.proposals, {member: moving.profiles(member) for member in movers}, moving.plan.duration_s
        )
        if step.sync != "none":
            end = predict_end(budget, ways, step.max_end_skew or job.max_end_skew)
            path = predict_path(budget, ways, step.max_path_skew or job.max_path_skew)
            moving.budget = budget.model_copy(update={"end": end, "path": path})
            _require("end", end)
            _require("path", path)

    def settle(self, moving: Moving, job: Job, step: Move, gone_ns: int) -> None:
        """Bring T0 forward by what arming and promises have been given and not taken, as far as the budget allows.
        gone_ns: fleet time by which all should have gone."""
        moving.sooner_ns, moving.slip_ns = self._sooner(moving, gone_ns)
        if moving.slip_ns:
            budget = moving.budget
            try:
                self.judge(moving, moving.armed, job, step)
            except Refuse:
                # As it was armed it is within the budget.
                moving.sooner_ns, moving.slip_ns, moving.budget = 0, 0, budget
        moving.t0_fleet_ns -= moving.sooner_ns

    # Inside

    def _sooner(self, moving: Moving, gone_ns: int) -> tuple[int, int]:
        """How much sooner it can begin, and how far that is at the most from a whole number of anybody's ticks: by
        whole ticks nothing of what is armed changes. Nothing where a member can not, or where a line starts them."""
        proposals = moving.proposals.values()
        if not self._begins_sooner(moving):
            return 0, 0
        spare_ns = max(0, moving.t0_fleet_ns - gone_ns - moving.disarm_ns)
        ticks_ns = [each.tick_ns for each in proposals if each.tick_ns]
        if not ticks_ns:
            return spare_ns, 0
        shortest_ns, longest_ns = min(ticks_ns), max(ticks_ns)
        tick_ns, off_ns = (shortest_ns + longest_ns) / 2, (longest_ns - shortest_ns) / 2
        count = min(spare_ns // tick_ns, SLIP * tick_ns / off_ns if off_ns else inf) // 1
        # Instants are whole nanoseconds.
        return round(count * tick_ns), ceil(count * off_ns) + 1 if count else 0

    async def _line(self, wire: Wire, moving: Moving) -> LineStart | None:
        """The line by `wire`, if it leads to members that can wait for it and its driver is there."""
        # Who drives a line can not wait for it, too.
        movers = set(moving.movers) - {wire.from_.partition(".")[0]}
        try:
            waiters = {
                member: name
                for member, _, name in (end.partition(".") for end in wire.to)
                if member in movers and "line" in (await self._view.info(member)).start_classes
            }
            line = LineStart(wire, waiters)
            there = waiters and (await self._view.fresh(line.driver)).mode != "offline"
        except BusError:
            return None
        return line if there else None

    async def _rounds(self, moving: Moving, job: Job, step: Move) -> None:
        """At most three rounds: T becomes the longest answer, and the lead what arming needs, until all can make it."""
        durations: dict[str, float] = {}
        # What the same members needed last time mostly saves a round; what they promise for longer holds for less.
        members = frozenset(moving.movers)
        moving.lead_ns = moving.lead_ns or round(LEAD_ROOM * self._leads_ns.get(members, 0))
        for _ in range(ROUNDS):
            await self._ask(moving, step)
            durations = {
                f"{member}.{axis}": took_s
                for member, proposal in moving.proposals.items()
                for axis, took_s in proposal.durations_s.items()
            }
            longest_s, lead_ns = max(durations.values()), self._lead_ns(moving)
            in_time = step.sync == "none" or longest_s <= moving.plan.duration_s + SOON_S
            if in_time and lead_ns <= moving.lead_ns:
                moving.lead_ns = lead_ns
                break
            moving.lead_ns = max(lead_ns, moving.lead_ns)
            if not in_time:
                moving.plan = moving.plan.stretched(longest_s)
        if step.sync != "none":
            worst = max(durations, key=lambda axis: abs(durations[axis] - moving.plan.duration_s))
            off_ns = round(abs(durations[worst] - moving.plan.duration_s) * NS_PER_S)
            allowed_ns = moving.early_ns
            if off_ns > allowed_ns:
                raise Refuse(
                    "end-skew",
                    f"axis {worst} would end {format_ns(off_ns)} off the plan; allowed are {format_ns(allowed_ns)}",
                    "move further or faster, or allow more with `max_end_skew`",
                    worst.partition(".")[0],
                )
        self._leads_ns[members] = moving.lead_ns
        self.judge(moving, moving.proposals, job, step)

    def _lead_ns(self, moving: Moving, known: bool = True) -> int:
        """How far ahead of the arming T0 must be, by what the members say, and what is known of them. Of those on one
        line, who takes longer than it says waits for the others. Where T0 is brought forward, what is not taken costs
        nothing, and who is slow for once need not be armed again."""
        if known and self._begins_sooner(moving):
            return min(SPARE_LEAD * self._needed_ns(moving, True), self._needed_ns(moving, False))
        return self._needed_ns(moving, known)

    def _begins_sooner(self, moving: Moving) -> bool:
        """Whether all can be told to begin sooner than they were armed for."""
        return moving.line is None and not moving.aligned and all(each.sooner for each in moving.proposals.values())

    def _needed_ns(self, moving: Moving, known: bool) -> int:
        margin_ns = self.pace.margin_ns(len(moving.proposals), known)
        lines: dict[str, list[tuple[Costs, float]]] = {}
        for member, proposal in moving.proposals.items():
            if proposal.costs is not None:
                place = self._view.fleet.controllers[member].link.place
                lines.setdefault(place, []).append((proposal.costs, self.pace.share(member, known)))

        def line_ns(line: list[tuple[Costs, float]]) -> float:
            arming_ns = [costs.arm_ns * (share if len(line) == 1 else min(1.0, share)) for costs, share in line]
            return max(arming_ns) if all(costs.by_turns for costs, _ in line) else sum(arming_ns)

        return round(max(map(line_ns, lines.values()))) + margin_ns + moving.disarm_ns

    async def _ask(self, moving: Moving, step: Move) -> None:
        """Ask all members; first the driver of a line, because the window of its edge is part of what waiters say."""
        line = moving.line
        proposals: dict[str, Proposal] = {}
        if line is not None:
            proposals = await self._ask_some(moving, step, [line.driver])
            edge = proposals[line.driver].edge
            if not edge:
                raise Refuse("start-class", f"{line.driver} can not drive a line", "wire it from another controller")
            line = moving.line = replace(line, edge=_sums(edge))
        proposals |= await self._ask_some(moving, step, [each for each in moving.members if each not in proposals])
        moving.proposals = {member: proposals[member] for member in moving.members}
        if line is not None:
            middles = [sum(_sums(proposals[member].terms)) // 2 for member in line.waiters]
            moving.line = replace(line, shift_ns=sum(middles) // len(middles))

    async def _ask_some(self, moving: Moving, step: Move, members: Iterable[str]) -> dict[str, Proposal]:
        ways = start_ways(moving, step, members)
        requests = {
            member: Propose(
                **self._members.fields(moving.actor),
                job=moving.job_id,
                step=moving.index,
                digest=self._view.fleet.controllers[member].digest,
                duration_s=moving.plan.duration_s,
                profiles=moving.profiles(member),
                start=way,
            )
            for member, way in ways.items()
        }
        proposals = await self._members.ask_all("propose", requests, Proposal)
        refuse_if_any(proposals)
        return proposals


def start_ways(moving: Moving, step: Move, members: Iterable[str]) -> dict[str, StartWay]:
    """How each of `members` is to start in the step."""
    lead_ns, line = moving.lead_ns + READING_NS, moving.line
    also = {"brake_s": moving.brake_s, "early_ns": moving.early_ns}
    by = "auto" if step.start == "line" else step.start
    ways = {
        member: line.way(member, lead_ns)
        if line is not None and (member == line.driver or member in line.waiters)
        else StartWay(by=by, lead_ns=lead_ns)
        for member in members
    }
    return {member: way.model_copy(update=also) for member, way in ways.items()}


def _require(what: str, said: Predicted | None) -> None:
    if said is not None and said.allowed_ns is not None and said.predicted_ns > said.allowed_ns:
        raise Refuse(
            f"{what}-skew",
            f"predicted {what} skew {format_ns(said.predicted_ns)} > {format_ns(said.allowed_ns)}; worst is "
            f"{said.worst_member}",
            f"allow more with `max_{what}_skew`, or move faster or shorter, so that its crystal has less time to drift",
            said.worst_member,
        )


def _predicted_ns(moving: Moving) -> int:
    assert moving.budget is not None
    return moving.budget.predicted_ns


def _sums(terms: Iterable[Term]) -> tuple[int, int]:
    """From the earliest to the latest instant that the terms leave, about T0."""
    each = list(terms)
    return sum(term.earliest_ns for term in each), sum(term.latest_ns for term in each)


def _window(moving: Moving, member: str, terms: list[Term]) -> Window:
    shift_ns, slip_ns = moving.shift_ns(member), moving.slip_ns
    if slip_ns and moving.proposals[member].tick_ns:
        terms = [*terms, Term(name="slip", earliest_ns=-slip_ns, latest_ns=slip_ns)]
    if shift_ns:
        terms = [Term(name="line", earliest_ns=shift_ns, latest_ns=shift_ns), *terms]
    line = moving.line
    return Window(terms, None if line is None or member not in line.waiters else line.edge)
