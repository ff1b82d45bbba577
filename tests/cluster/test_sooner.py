"""What its arming was given and has not taken, a step begins sooner: by whole ticks, and promised as exactly."""

import json
from collections.abc import Mapping
from typing import Any, cast

import pytest
from cluster.worlds import EXAMPLES, job, origin_host_ns, outcome, run_fleet

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.moving import Moving
from orchestrator.coordinator.pace import KNOWN, Pace
from orchestrator.coordinator.proposing import SLIP, Proposing
from orchestrator.lab.sync_fleets import sync_fleet
from orchestrator.lab.virtual import VirtualFleet
from orchestrator.model.files import load_fleet
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import Proposal
from orchestrator.model.report import StepReport


@pytest.fixture
def sooner_ns(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """By how much each step has begun sooner."""
    found: list[int] = []
    settle = Proposing.settle

    def noted(self: Proposing, moving: Moving, *rest: object) -> None:
        settle(self, moving, *rest)  # pyright: ignore[reportArgumentType]
        found.append(moving.sooner_ns)

    monkeypatch.setattr(Proposing, "settle", noted)
    return found


async def prepared(fleet: VirtualFleet, axes: list[str]) -> None:
    steps = [{"do": "enable", "axes": axes}, {"do": "home", "axes": axes}]
    assert (await outcome(fleet, job(json.dumps(steps)))).state == "done"


async def moved(fleet: VirtualFleet, axes: list[str], way: float, **more: object) -> StepReport:
    step = {"do": "move", "by": dict.fromkeys(axes, way), **more}
    report = await outcome(fleet, job(json.dumps([step]), max_start_skew="50 ms"))
    assert report.state == "done", report.reason
    return report.steps[-1]


def begins_as_promised(fleet: VirtualFleet, step: StepReport) -> None:
    """Every member has begun where the budget of the step says, about the T0 that it tells."""
    assert step.budget is not None and step.t0_fleet_ns is not None
    for member, window in step.budget.members.items():
        after_ns = fleet.controllers[member].motions[-1].start_ns - origin_host_ns(fleet) - step.t0_fleet_ns
        assert window.earliest_ns <= after_ns <= window.latest_ns, (member, after_ns, window)


@pytest.mark.parametrize(
    ("name", "axes", "way"),
    [
        ("2 SMC-4000", ["a0.x", "a1.x"], 20.0),
        ("8 SMC-2000, own ports", ["b0.x", "b1.x"], 20.0),
        ("mixed with pp", ["e1.x", "e2.x"], 1000.0),
        ("mixed with pp", ["a1.x", "b1.x", "c1.x"], 10.0),
        ("mixed", ["d1.x", "d2.x"], 20.0),
        ("mixed, lines", ["a1.x", "b1.x", "c1.x"], 10.0),
    ],
)
def test_members_that_are_known_begin_as_soon_as_they_can(
    name: str, axes: list[str], way: float, sooner_ns: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    armed, slower_ns = Pace.armed, 20 * NS_PER_MS

    def armed_slowly(self: Pace, declared_ns: Mapping[str, int], took_ns: Mapping[str, int]) -> None:
        armed(self, declared_ns, {member: took + slower_ns for member, took in took_ns.items()})

    monkeypatch.setattr(Pace, "armed", armed_slowly)

    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet, axes)
        for k in range(KNOWN + 2):
            begins_as_promised(fleet, await moved(fleet, axes, -way if k % 2 else way))
        assert sooner_ns[:KNOWN] == [0] * KNOWN and len(sooner_ns) == KNOWN + 2
        assert min(sooner_ns[KNOWN:]) > slower_ns // 2

    run_fleet(main, sync_fleet(name, 1))


def test_ticks_that_differ_are_brought_forward_as_far_as_they_keep_together() -> None:
    tick_ns, step = 976_562.5, frozenset("ab")
    asking = Proposing(cast(Any, None), cast(Any, None))
    for _ in range(KNOWN):
        asking.pace.released(step, 20 * NS_PER_MS, 10 * NS_PER_MS)
    spare_ns = NS_PER_S - (asking.pace.release_ns(step) or 0)

    def sooner(*ticks_ns: float) -> tuple[int, int]:
        proposals = {name: Proposal(sooner=True, tick_ns=each) for name, each in zip("ab", ticks_ns, strict=True)}
        moving = Moving("j", 0, "a", cast(Any, None), cast(Any, None), proposals=proposals, t0_fleet_ns=2 * NS_PER_S)
        return asking._sooner(moving, NS_PER_S)  # pyright: ignore[reportPrivateUsage]

    assert sooner(0.0, 0.0) == (spare_ns, 0)
    assert sooner(tick_ns, 0.0) == (round(spare_ns // tick_ns * tick_ns), 1)
    for ppm in (5.0, 50.0, 1000.0):
        forward_ns, off_ns = sooner(tick_ns * (1 - ppm * 1e-6), tick_ns * (1 + ppm * 1e-6))
        assert abs(forward_ns / tick_ns - round(forward_ns / tick_ns)) < 1e-5
        assert ppm * 1e-6 * forward_ns <= off_ns <= SLIP * tick_ns + 2
        # As far as there is time, or as the hundredth of a tick allows.
        assert min(spare_ns, SLIP * tick_ns / (ppm * 1e-6)) - forward_ns < 1.01 * tick_ns
    assert sooner(1e6, tick_ns) == (0, 0)


@pytest.mark.parametrize(
    ("whole", "axes", "more"),
    [
        (load_fleet(EXAMPLES / "all.fleet.yaml"), ["gantry.x", "arm.r"], {}),
        (sync_fleet("2 SMC-4000", 1), ["a0.x", "a1.x"], {"align": "1 s"}),
    ],
    ids=["one that can not", "ticks that were looked for"],
)
def test_who_begins_when_it_was_armed_to(
    whole: Fleet, axes: list[str], more: dict[str, str], sooner_ns: list[int]
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet, axes)
        for k in range(KNOWN + 2):
            begins_as_promised(fleet, await moved(fleet, axes, 1.0 if k % 2 else -1.0, **more))
        assert set(sooner_ns) == {0}

    run_fleet(main, whole)
