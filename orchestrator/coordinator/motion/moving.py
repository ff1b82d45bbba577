"""A motion step under way: what everybody who runs it knows of it."""

import asyncio
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.coordinator.fleet.permits import Guard
from orchestrator.coordinator.motion.targets import Resolved
from orchestrator.model.fleet import Wire
from orchestrator.model.messages import Armed, LineDrive, LineWait, Proposal, StartWay
from orchestrator.model.profile import Profile
from orchestrator.model.report import Budget
from orchestrator.model.state import Event
from orchestrator.plan.step import Plan

SLACK_NS = 50 * NS_PER_MS
"""Who starts later than promised by more than this was not busy, but stopped or suspended."""


@dataclass(frozen=True, slots=True)
class LineStart:
    """A wired line that starts members of a step.

    wire: from the output of `driver`, made active at T0. waiters: by member, the input that it waits for. edge: where
    the output's edge lies about T0, ns, once the driver has said. shift_ns: how much later than T0 the others start,
    so that they meet the waiters, whose lines, inputs and firmware take their time.
    """

    wire: Wire
    waiters: dict[str, str]
    edge: tuple[int, int] = (0, 0)
    shift_ns: int = 0

    @property
    def driver(self) -> str:
        return self.wire.from_.partition(".")[0]

    def way(self, member: str, lead_ns: int) -> StartWay:
        """How the line's driver or a waiter is to start."""
        if member == self.driver:
            return StartWay(lead_ns=lead_ns, drive=LineDrive(output=self.wire.from_.partition(".")[2]))
        least_ns, most_ns = (each * NS_PER_US for each in self.wire.delay_us)
        wait = LineWait(
            input=self.waiters[member], earliest_ns=self.edge[0] + least_ns, latest_ns=self.edge[1] + most_ns
        )
        return StartWay(lead_ns=lead_ns, wait=wait)


@dataclass(slots=True)
class Moving:
    """A motion step. lead_ns: how far ahead of the arming T0 is; what the proposals promise holds for so long.
    sooner_ns: how much sooner than that it begins, to within slip_ns of a whole number of everybody's ticks.

    arming_fleet_ns: when the last arming began; settled_fleet_ns: when T0 was settled. instances: of the adapters that
    it was planned with, by member. early_ns: how much before the plan an axis may end that can not go so slowly.
    held_by: who has it braked inside. aligned: T0 is one at which ticks fall close together, and stays. unloaded: when
    it was disarmed last, nobody had begun. decided: the journal says that it goes.
    """

    job_id: str
    index: int
    actor: str
    resolved: Resolved
    plan: Plan
    instances: dict[str, str] = field(default_factory=dict[str, str])
    line: LineStart | None = None
    proposals: dict[str, Proposal] = field(default_factory=dict[str, Proposal])
    lead_ns: int = 0
    sooner_ns: int = 0
    slip_ns: int = 0
    early_ns: int = 0
    armed: dict[str, Armed] = field(default_factory=dict[str, Armed])
    budget: Budget | None = None
    arming_fleet_ns: int = 0
    settled_fleet_ns: int = 0
    t0_fleet_ns: int = 0
    events: "asyncio.Queue[Event | None]" = field(default_factory=lambda: asyncio.Queue[Event | None]())
    guard: Guard | None = None
    held_by: str | None = None
    unloaded: bool = False
    decided: bool = False
    aligned: bool = False
    _shares: "tuple[Plan, dict[str, dict[str, Profile]]] | None" = None

    @property
    def brake_s(self) -> float:
        """How long the axis that is slowest to brake needs from its peak velocity."""
        return max(
            (
                self.plan.profiles[each.axis].peak_velocity / each.acceleration
                for each in self.resolved.moves
                if each.axis in self.plan.profiles
            ),
            default=0.0,
        )

    @property
    def movers(self) -> list[str]:
        """The members that have axes in the step."""
        return list(dict.fromkeys(axis.partition(".")[0] for axis in self.plan.profiles))

    @property
    def members(self) -> list[str]:
        """The movers, and the controller that drives their line."""
        return self.movers if self.line is None else list(dict.fromkeys([self.line.driver, *self.movers]))

    @property
    def disarm_ns(self) -> int:
        """How long before T0 nobody can be sure any more to take the step back: by what the members declare, because
        where the controllers themselves decide so long before their start, no quick link makes it shorter."""
        return max((each.costs.disarm_ns for each in self.proposals.values() if each.costs is not None), default=0)

    @property
    def slack_ns(self) -> int:
        """How much later than promised a member may be started, so that what the job allows is still kept: a start
        that is a little late is better than none. None where a line starts members: they count on its promise."""
        if self.budget is None or self.line is not None:
            return 0
        # One axis has nobody that it could be too late for.
        return SLACK_NS if len(self.plan.profiles) == 1 else min(self.budget.slack_ns, SLACK_NS)

    def lost_permit(self) -> str | None:
        """What permit of the step has been lost since it was armed, in words."""
        return None if self.guard is None else self.guard.lost()

    def profiles(self, member: str) -> dict[str, Profile]:
        """The member's share of the plan, by its own axis names."""
        if self._shares is None or self._shares[0] is not self.plan:
            shares: dict[str, dict[str, Profile]] = {}
            for axis, profile in self.plan.profiles.items():
                controller, _, name = axis.partition(".")
                shares.setdefault(controller, {})[name] = profile
            self._shares = self.plan, shares
        return self._shares[1].get(member, {})

    def shift_ns(self, member: str) -> int:
        """How much later than T0 the member's own T0 is."""
        line = self.line
        return 0 if line is None or member == line.driver or member in line.waiters else line.shift_ns

    def t0_ns(self, member: str) -> int:
        """The member's own T0, fleet time."""
        return self.t0_fleet_ns + self.shift_ns(member)
