"""T0 is settled when all members have promised: a step starts sooner by the lead that arming did not use, by whole
ticks, and as exactly as promised. A member that receives `go` too late is armed again, as long as no member has
started."""

import json
from collections.abc import Callable
from typing import Any, cast

import pytest
from cluster.worlds import EXAMPLES, job, origin_host_ns, outcome, run_fleet

from adapters.controller.slots.participant import StepParticipant
from adapters.controller.slots.withdrawal import STOP_LEAD_NS
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion.negotiation import (
    StartAgreement,
    StartNegotiation,
    _find_advance,
)
from orchestrator.coordinator.motion.planning import MAX_TICK_RESIDUAL
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.messages import GoRequest, Proposal, Reply
from orchestrator.model.report import StepReport
from orchestrator.runtime.simulated_fleets import make_smc2000, make_smc4000, make_sync_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet


async def prepared(fleet: VirtualFleet, axes: list[str]) -> None:
    steps = [{"do": "enable", "axes": axes}, {"do": "home", "axes": axes}]
    assert (await outcome(fleet, job(json.dumps(steps)))).state == "done"


async def moved(fleet: VirtualFleet, axes: list[str], way: float, **more: object) -> StepReport:
    step = {"do": "move", "by": dict.fromkeys(axes, way), **more}
    report = await outcome(fleet, job(json.dumps([step]), max_start_skew="50 ms"))
    assert report.state == "done", report.reason
    return report.steps[-1]


@pytest.fixture
def sooner_ns(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How much sooner each step has started than it was armed for."""
    found: list[int] = []
    advance = StartNegotiation.advance

    def noted(self: StartNegotiation, agreement: StartAgreement, *rest: Any) -> None:
        advance(self, agreement, *rest)
        found.append(agreement.advance_ns)

    monkeypatch.setattr(StartNegotiation, "advance", noted)
    return found


def begins_as_promised(fleet: VirtualFleet, step: StepReport) -> None:
    """Every member has started within the budget of the step about the T0 that the step reports."""
    assert step.budget is not None and step.t0_fleet_ns is not None
    for member, window in step.budget.members.items():
        after_ns = fleet.controllers[member].commanded_motions[-1].start_ns - origin_host_ns(fleet) - step.t0_fleet_ns
        assert window.earliest_ns <= after_ns <= window.latest_ns, (member, after_ns, window)


@pytest.mark.parametrize(
    ("name", "axes", "way"),
    [
        ("2 SMC-4000", ["a0.x", "a1.x"], 20.0),
        pytest.param("mixed with pp", ["e1.x", "e2.x"], 1000.0, marks=pytest.mark.nightly),
        ("mixed", ["a1.x", "c1.x"], 10.0),
        pytest.param("mixed", ["c1.x", "c2.x"], 10.0, marks=pytest.mark.nightly),
    ],
)
def test_a_step_starts_as_soon_as_all_members_can(name: str, axes: list[str], way: float, sooner_ns: list[int]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet, axes)
        for k in range(4):
            begins_as_promised(fleet, await moved(fleet, axes, -way if k % 2 else way))
        # A step that had to be armed again starts at the T0 of the second arming.
        assert sooner_ns and max(sooner_ns) > 20 * NS_PER_MS

    run_fleet(main, make_sync_fleet(name, 1))


@pytest.mark.parametrize(
    ("whole", "axes", "more"),
    [
        (load_fleet(EXAMPLES / "all.fleet.yaml"), ["gantry.x", "arm.r"], {}),
        (make_sync_fleet("8 SMC-2000, own ports", 1), ["b0.x", "b1.x"], {}),
        (make_sync_fleet("mixed, lines", 1), ["a1.x", "c1.x", "d1.x"], {"start": "line"}),
        (make_sync_fleet("2 SMC-4000", 1), ["a0.x", "a1.x"], {"align": "1 s"}),
    ],
    ids=["a drive that SYNC starts", "a slow line", "a wired line", "ticks that were looked for"],
)
def test_a_member_that_starts_at_its_original_t0(
    whole: Fleet, axes: list[str], more: dict[str, str], sooner_ns: list[int]
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet, axes)
        for k in range(2):
            begins_as_promised(fleet, await moved(fleet, axes, -10.0 if k % 2 else 10.0, **more))
        assert not any(sooner_ns)

    run_fleet(main, whole)


def test_different_ticks_are_advanced_as_far_as_they_stay_aligned() -> None:
    tick_ns, spare_ns = 976_562.5, 900 * NS_PER_MS

    def sooner(*ticks_ns: float, sooner: bool = True) -> tuple[int, int]:
        proposals = {
            name: Proposal(can_advance=sooner, tick_ns=each) for name, each in zip("ab", ticks_ns, strict=True)
        }
        return _find_advance(StartAgreement(cast(Any, None), proposals=proposals), spare_ns, MAX_TICK_RESIDUAL)

    assert sooner(0.0, 0.0) == (spare_ns, 0)
    assert sooner(0.0, 0.0, sooner=False) == (0, 0)
    assert sooner(tick_ns, 0.0) == (round(spare_ns // tick_ns * tick_ns), 1)
    for ppm in (5.0, 50.0, 1000.0):
        forward_ns, off_ns = sooner(tick_ns * (1 - ppm * 1e-6), tick_ns * (1 + ppm * 1e-6))
        assert abs(forward_ns / tick_ns - round(forward_ns / tick_ns)) < 1e-5
        assert ppm * 1e-6 * forward_ns <= off_ns <= MAX_TICK_RESIDUAL * tick_ns + 2
        # As far as there is time, or within a few hundredths of a tick.
        assert min(spare_ns, MAX_TICK_RESIDUAL * tick_ns / (ppm * 1e-6)) - forward_ns < 1.01 * tick_ns
    assert sooner(1.1 * tick_ns, tick_ns) == (0, 0)


@pytest.mark.parametrize("late_by_ms", [-50, 5])
def test_a_member_that_gets_go_too_late_is_rearmed_if_no_member_has_started(
    monkeypatch: pytest.MonkeyPatch, late_by_ms: int
) -> None:
    """The decision is withdrawn, and the next one is the step's only one. A member that may have started is not
    moved again."""
    go, slow = StepParticipant.start_step, ["stage"]

    async def slowly(member: StepParticipant, request: GoRequest) -> Reply:
        reply = await go(member, request)
        ticket = member._steps.present
        if member._context.controller in slow and ticket is not None:
            slow.clear()
            # It has been released, and only its answer is late.
            await sleep_ns(member._context.clock, ticket.t0_host_ns - STOP_LEAD_NS - member._context.clock.now_ns())
            await sleep_ns(member._context.clock, max(0, late_by_ms * NS_PER_MS + STOP_LEAD_NS))
        return reply

    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet, ["gantry", "stage"])
        monkeypatch.setattr(StepParticipant, "start_step", slowly)
        starts = {name: len(each.commanded_motions) for name, each in fleet.controllers.items()}
        report = await outcome(fleet, job("[{do: move, to: {gantry.x: 10, stage.u: 1}}]", max_start_skew="20 ms"))
        assert not slow
        made = {name: len(each.commanded_motions) - starts[name] for name, each in fleet.controllers.items()}
        decided = fleet.journal.list_decisions(report.job_id)
        assert report.state == "done" and made == {"gantry": 1, "stage": 1}, (report.reason, made)
        assert decided == [(0, report.steps[0].t0_fleet_ns)]
        assert any("arming again with more lead" in line for line in fleet.lines)
        assert report.steps[0].t0_fleet_ns is not None and report.steps[0].settled_fleet_ns is not None

    run_fleet(main)


@pytest.mark.parametrize("make", [make_smc4000, make_smc2000])
@pytest.mark.parametrize("period_us", [250, *(pytest.param(each, marks=pytest.mark.nightly) for each in (2000, 5000))])
def test_a_step_starts_as_promised_with_another_servo_period(
    period_us: int, make: Callable[[int], dict[str, Any]]
) -> None:
    """TM: the commands before the start take their time, regardless of the number of samples."""
    plain = {f"a{k}": {**make(k), "options": {"servo_period_us": period_us}} for k in range(2)}

    async def main(clock: VirtualClock) -> None:
        whole = Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "period", "controllers": plain})
        fleet = VirtualFleet(whole, clock, 1)
        for unit in fleet.controllers.values():
            cast(Any, unit).machine.memory.burn_period(period_us)
        await fleet.start()
        axes = ["a0.x", "a1.x"]
        await prepared(fleet, axes)
        for k in range(4):
            begins_as_promised(fleet, await moved(fleet, axes, -20.0 if k % 2 else 20.0))
        assert not any("arming again" in line for line in fleet.lines)

    run_virtual(main)
