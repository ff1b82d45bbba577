"""A step that is prepared behind a moving one: when it may be armed and released, and how it is withdrawn. Its members
are scripted by the test."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion import ahead as module
from orchestrator.coordinator.motion.ahead import StepAhead
from orchestrator.coordinator.motion.chain import (
    END_SEEN_NS,
    RELEASE_SLACK,
    RELEASE_SLACK_NS,
    BetweenSteps,
    PresentMove,
)
from orchestrator.coordinator.motion.lead_time import KNOWN_AFTER, LATE_LOADING_FACTOR, LeadTimeEstimator
from orchestrator.coordinator.motion.negotiation import StartAgreement, StartNegotiation
from orchestrator.coordinator.motion.start import WITHDRAWN, StartSequence, StartState
from orchestrator.coordinator.motion.step import PlannedMotion
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import Proposal
from orchestrator.model.state import StepCosts

DUE_NS = NS_PER_S
ENDS_NS = NS_PER_S
NOTHING = BetweenSteps()


class ScriptedStart:
    """The start of a step. done: its calls. may_arm, may_release: while cleared, the members do not answer."""

    release_due_ns = DUE_NS

    def __init__(self) -> None:
        self.state = StartState({})
        self.done: list[str] = []
        self.may_arm, self.may_release = asyncio.Event(), asyncio.Event()
        self.may_arm.set()
        self.may_release.set()
        self.refuses: Refusal | None = None

    async def arm_following(self) -> None:
        self.done.append("arm")
        await self.may_arm.wait()

    async def release_following(self) -> None:
        if self.state.withdrawn:
            raise Refusal(WITHDRAWN, self.state.withdrawn)
        self.done.append("release")
        await self.may_release.wait()
        if self.refuses is not None:
            raise self.refuses
        self.state.decided = True

    async def disarm(self) -> None:
        self.done.append("disarm")

    def close(self) -> None:
        self.done.append("close")


class AheadWorld:
    """A step ahead. stops: of members, with the mode. released: whether it was reported."""

    def __init__(self, clock: VirtualClock, monkeypatch: pytest.MonkeyPatch, between: BetweenSteps) -> None:
        self.clock = clock
        self.start = ScriptedStart()
        self.stops: list[str] = []
        self.released = False
        self.profiles = {"c.x": "a profile"}
        monkeypatch.setattr(module, "plan_following", self._plan_step)
        monkeypatch.setattr(module, "PlannedMotion", SimpleNamespace(agree=self._agree))
        fleet = SimpleNamespace(clock=clock, stop_members=self._stop_members)
        services = SimpleNamespace(fleet=fleet, leadership=SimpleNamespace(fleet_now_ns=clock.now_ns))
        before = SimpleNamespace(planned=None, make_present=lambda between: between)
        step = SimpleNamespace(request=None)
        self.ahead = StepAhead(cast(Any, services), cast(Any, step), cast(Any, before), between, self._note_release)

    async def _plan_step(self, *_: object) -> object:
        return SimpleNamespace(plan=SimpleNamespace(profiles=self.profiles))

    async def _agree(self, *_: object) -> object:
        agreement = SimpleNamespace(movers=["c"], actors=["c"])
        motion = SimpleNamespace(start=self.start, watch=self.start, agreement=agreement, feed=None)
        motion.feed_hold = partial(PlannedMotion.feed_hold, cast(Any, motion))
        return motion

    async def _stop_members(self, members: list[str], mode: str, *_: object) -> None:
        self.stops += [f"{mode} {member}" for member in members]

    def _note_release(self, *_: object) -> None:
        self.released = True

    async def reach(self, stage: str) -> None:
        """planning: planned, and not armed; arming, armed, releasing, released."""
        (self.start.may_arm if stage == "arming" else self.start.may_release).clear()
        if stage == "released":
            self.start.may_release.set()
        await self.wait_until(NS_PER_MS)
        if stage != "planning":
            self.ahead.allow_arming()
        await self.wait_until(DUE_NS + NS_PER_MS if stage in ("releasing", "released") else 2 * NS_PER_MS)

    async def wait_until(self, at_ns: int) -> None:
        await sleep_until_ns(self.clock, at_ns)


def run_ahead(
    monkeypatch: pytest.MonkeyPatch,
    body: Callable[[AheadWorld], Coroutine[Any, Any, None]],
    between: BetweenSteps = NOTHING,
) -> None:
    async def main(clock: VirtualClock) -> None:
        await body(AheadWorld(clock, monkeypatch, between))

    run_virtual(main)


async def refused(waiting: Awaitable[object]) -> Refusal:
    with pytest.raises(Refusal) as caught:
        await waiting
    return caught.value


def test_a_step_is_armed_once_the_step_before_is_the_present_one_and_released_when_it_is_due(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    async def body(world: AheadWorld) -> None:
        await world.wait_until(NS_PER_MS)
        assert world.start.done == []
        world.ahead.allow_arming()
        await world.wait_until(DUE_NS - NS_PER_MS)
        assert world.start.done == ["arm"] and not world.ahead.is_decided
        await world.ahead.wait_until_released()
        assert world.start.done == ["arm", "release"] and world.clock.now_ns() == DUE_NS
        assert world.released and world.ahead.is_decided

    run_ahead(monkeypatch, body)


def test_a_step_behind_outputs_is_released_only_after_they_are_switched(monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(world: AheadWorld) -> None:
        world.ahead.allow_arming()
        await world.wait_until(2 * DUE_NS)
        assert world.start.done == ["arm"]
        world.ahead.allow_release()
        await world.wait_until(2 * DUE_NS + NS_PER_MS)
        assert world.start.done == ["arm", "release"]

    run_ahead(monkeypatch, body, BetweenSteps(acts=True))


@pytest.mark.parametrize(
    ("stage", "done", "stops"),
    [
        ("planning", ["close"], []),
        ("arming", ["arm", "close", "disarm"], []),
        ("armed", ["arm", "close", "disarm"], []),
        ("released", ["arm", "release", "close"], ["decelerate c"]),
    ],
)
def test_a_step_that_is_withdrawn_is_unloaded_or_stopped(
    monkeypatch: pytest.MonkeyPatch, stage: str, done: list[str], stops: list[str]
) -> None:
    async def body(world: AheadWorld) -> None:
        await world.reach(stage)
        await world.ahead.withdraw("the job is paused", "anna")
        assert world.start.done == done and world.stops == stops
        await world.ahead.withdraw("again", "anna")
        assert world.start.done == done and world.stops == stops
        await world.wait_until(2 * DUE_NS)
        assert world.start.done == done

    run_ahead(monkeypatch, body)


@pytest.mark.parametrize("refuses", [False, True])
def test_an_exchange_that_is_under_way_is_not_cut_off(monkeypatch: pytest.MonkeyPatch, refuses: bool) -> None:
    """Members that were sent `go` start, whatever the coordinator forgets."""

    async def body(world: AheadWorld) -> None:
        await world.reach("releasing")
        world.start.refuses = Refusal("late", "too late") if refuses else None
        withdrawing = asyncio.ensure_future(world.ahead.withdraw("cancelled", "anna"))
        await world.wait_until(DUE_NS + 5 * NS_PER_MS)
        assert not withdrawing.done() and world.start.state.withdrawn == "cancelled"
        world.start.may_release.set()
        await withdrawing
        assert world.stops == ([] if refuses else ["decelerate c"])

    run_ahead(monkeypatch, body)


@pytest.mark.parametrize("stage", ["planning", "armed"])
def test_a_pause_takes_effect_until_the_step_is_due(monkeypatch: pytest.MonkeyPatch, stage: str) -> None:
    async def body(world: AheadWorld) -> None:
        await world.reach(stage)
        world.ahead.prevent_release("the job was paused")
        world.ahead.allow_arming()
        assert (await refused(world.ahead.wait_until_released())).text == "the job was paused"
        assert "release" not in world.start.done and not world.released

    run_ahead(monkeypatch, body)


@pytest.mark.parametrize(
    ("stage", "stops"), [("armed", []), ("releasing", ["feed-hold c"]), ("released", ["feed-hold c"])]
)
def test_a_feed_hold_stops_members_only_of_a_step_that_may_start(
    monkeypatch: pytest.MonkeyPatch, stage: str, stops: list[str]
) -> None:
    async def body(world: AheadWorld) -> None:
        await world.reach(stage)
        await world.ahead.feed_hold("anna")
        await world.ahead.feed_hold("boris")
        assert world.start.state.paused_by == "anna" and world.stops == stops
        world.start.may_release.set()

    run_ahead(monkeypatch, body)


def test_a_step_that_moves_nothing_does_not_follow(monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(world: AheadWorld) -> None:
        world.profiles = {}
        assert (await refused(world.ahead.wait_until_released())).code == "no-motion"
        await world.ahead.withdraw("the job has ended", "anna")
        assert world.start.done == [] and world.stops == []

    run_ahead(monkeypatch, body)


# T0 of a step that follows


def make_proposal(gap_ms: int | None, arm_ms: int = 40, disarm_ms: int = 5) -> Proposal:
    costs = StepCosts(arm_ns=arm_ms * NS_PER_MS, disarm_ns=disarm_ms * NS_PER_MS, stop_ns=0)
    return Proposal(costs=costs, gap_ns=None if gap_ms is None else gap_ms * NS_PER_MS)


def make_negotiation(
    proposals: dict[str, Proposal], between: BetweenSteps, estimator: LeadTimeEstimator, now_ns: int = 0
) -> tuple[StartNegotiation, StartAgreement]:
    present = PresentMove(3, ENDS_NS, ENDS_NS - 2 * NS_PER_MS, between)
    controllers = {name: SimpleNamespace(line=name) for name in proposals}
    view = SimpleNamespace(fleet=SimpleNamespace(controllers=controllers))
    services = SimpleNamespace(
        leadership=SimpleNamespace(fleet_now_ns=lambda: now_ns),
        fleet=SimpleNamespace(view=view, requests=None),
        estimator=estimator,
    )
    planned = SimpleNamespace(request=SimpleNamespace(max_end_skew_ns=None), triggers=())
    agreement = StartAgreement(cast(Any, None), proposals=proposals, present=present)
    return StartNegotiation(cast(Any, services), cast(Any, planned), present), agreement


def known_estimator(took_ms: int = 4) -> LeadTimeEstimator:
    estimator = LeadTimeEstimator()
    for _ in range(KNOWN_AFTER):
        estimator.record_release(2 * took_ms * NS_PER_MS, took_ms * NS_PER_MS)
        for member in ("held", "host"):
            estimator.record_arming("behind", {member: 40 * NS_PER_MS}, {member: 20 * NS_PER_MS})
        estimator.record_following(took_ms * NS_PER_MS)
    return estimator


def test_members_that_hold_the_step_begin_as_soon_as_the_slowest_program_can() -> None:
    proposals = {"held": make_proposal(12), "other": make_proposal(14)}
    negotiation, agreement = make_negotiation(proposals, BetweenSteps(), known_estimator())
    assert agreement.loads_later == []
    # Counted from the planned end: the members know their own start by their own clock.
    assert negotiation.earliest_following_ns(agreement) == ENDS_NS + 12 * NS_PER_MS


def test_a_step_does_not_begin_before_the_last_member_may_have_ended() -> None:
    negotiation, agreement = make_negotiation({"held": make_proposal(1)}, BetweenSteps(), known_estimator())
    assert negotiation.earliest_following_ns(agreement) == ENDS_NS


def test_a_dwell_is_counted_from_the_latest_end() -> None:
    between = BetweenSteps(80 * NS_PER_MS)
    negotiation, agreement = make_negotiation({"held": make_proposal(12)}, between, known_estimator())
    assert negotiation.earliest_following_ns(agreement) == ENDS_NS + 80 * NS_PER_MS


def test_a_step_that_is_found_late_gets_the_time_that_arming_needs() -> None:
    estimator = known_estimator()
    now_ns = ENDS_NS - NS_PER_MS
    negotiation, agreement = make_negotiation({"held": make_proposal(12)}, BetweenSteps(), estimator, now_ns)
    needs_ns = 40 * NS_PER_MS + estimator.margin_ns(1) + 5 * NS_PER_MS
    assert negotiation.earliest_following_ns(agreement) == now_ns + needs_ns


def test_a_member_that_loads_behind_the_end_delays_the_step_by_what_it_is_known_to_need() -> None:
    estimator = known_estimator()
    proposals = {"held": make_proposal(12), "host": make_proposal(None)}
    negotiation, agreement = make_negotiation(proposals, BetweenSteps(), estimator)
    assert agreement.loads_later == ["host"]
    loading_ns = round(estimator.arming_share("host", "behind") * 40 * NS_PER_MS)
    assert loading_ns == 22 * NS_PER_MS
    releasing_ns = 2 * estimator.go_ns(2, follows=True) + 5 * NS_PER_MS
    assert negotiation.earliest_following_ns(agreement) == ENDS_NS + loading_ns + releasing_ns


def test_until_loading_is_known_its_adapter_gets_time_to_notice_the_end() -> None:
    estimator = LeadTimeEstimator()
    negotiation, agreement = make_negotiation({"host": make_proposal(None)}, BetweenSteps(), estimator)
    releasing_ns = 2 * estimator.go_ns(1, follows=True) + 5 * NS_PER_MS
    expected_ns = ENDS_NS + END_SEEN_NS + 40 * NS_PER_MS + releasing_ns
    assert negotiation.earliest_following_ns(agreement) == expected_ns


def test_outputs_between_two_steps_delay_the_decision() -> None:
    estimator = known_estimator()
    between = BetweenSteps(10 * NS_PER_MS, acts=True)
    negotiation, agreement = make_negotiation({"held": make_proposal(12)}, between, estimator)
    acting_ns = 10 * NS_PER_MS + estimator.acting_ns
    expected_ns = ENDS_NS + acting_ns + 2 * estimator.go_ns(1, follows=True) + 5 * NS_PER_MS
    assert negotiation.earliest_following_ns(agreement) == expected_ns


def test_a_member_that_was_late_gets_more_time() -> None:
    estimator = known_estimator()
    before = estimator.arming_share("host", "behind")
    estimator.record_late_loading(["host"])
    assert estimator.arming_share("host", "behind") == pytest.approx(1.1 * LATE_LOADING_FACTOR * before)
    assert estimator.arming_share("held", "behind") == before


@pytest.mark.parametrize("loads_later", [False, True])
def test_the_decision_is_left_as_late_as_is_safe(loads_later: bool) -> None:
    """Where a member loads the step behind the end, its promise is asked for at the end: it takes as long as that."""
    estimator = known_estimator()
    proposals = {"held": make_proposal(12)} | ({"host": make_proposal(None)} if loads_later else {})
    negotiation, agreement = make_negotiation(proposals, BetweenSteps(), estimator)
    fleet = SimpleNamespace(requests=None)
    services = SimpleNamespace(fleet=fleet, leadership=None, estimator=estimator)
    start = StartSequence(cast(Any, services), cast(Any, None), negotiation, agreement, cast(Any, None))
    start.state.t0_fleet_ns = negotiation.earliest_following_ns(agreement)
    margin_ns = round(RELEASE_SLACK * estimator.margin_ns(len(proposals)))
    needs_ns = margin_ns + agreement.disarm_ns + RELEASE_SLACK_NS
    before_t0_ns = start.state.t0_fleet_ns - needs_ns
    assert start.release_due_ns == (min(before_t0_ns, ENDS_NS) if loads_later else before_t0_ns)
    if loads_later:
        assert start.release_due_ns == ENDS_NS
