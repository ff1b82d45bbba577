"""Time is left for the rest of a start, or all are armed again; leases are renewed once a second."""

import asyncio
from collections import Counter
from typing import Any

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from adapters.controller.slots.participant import StepParticipant
from orchestrator.clock.base import NS_PER_MS, sleep_until_ns
from orchestrator.coordinator.fleet.requests import MemberRequests
from orchestrator.model.messages import ArmRequest, Reply
from orchestrator.runtime.virtual.fleet import VirtualFleet

LEFT_NS = NS_PER_MS  # before T0, beside the time for disarming: less than the decision and the release may take


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Counter[str]:
    """The requests to controllers, by verb and time to live of a lease."""
    counts: Counter[str] = Counter()
    answer = MemberRequests.request_all

    async def count_requests(self: MemberRequests, verb: str, requests: Any, *rest: Any, **more: Any) -> Any:
        for request in requests.values():
            counts[f"{verb} {getattr(request, 'ttl_ms', '')}".strip()] += 1
        return await answer(self, verb, requests, *rest, **more)

    monkeypatch.setattr(MemberRequests, "request_all", count_requests)
    return counts


def test_a_member_that_is_armed_just_before_t0_is_armed_again_before_any_promise(
    monkeypatch: pytest.MonkeyPatch, asked: Counter[str]
) -> None:
    arm = StepParticipant.arm_step
    late = ["not yet"]

    async def arm_late(self: StepParticipant, request: ArmRequest) -> Reply:
        reply = await arm(self, request)
        context = self._context  # pyright: ignore[reportPrivateUsage]
        if not late:
            late.append(context.controller)
            t0_ns = context.require_scale().to_host_ns(request.t0_fleet_ns)
            await sleep_until_ns(context.clock, t0_ns - context.driver.capabilities.costs.disarm_ns - LEFT_NS)
        return reply

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        asked.clear()
        late.clear()
        report = await outcome(fleet, job("[{do: move, to: {gantry.x: 60}, start: agreed}]"))
        assert report.state == "done" and late
        assert (asked["arm"], asked["commit"], asked["go"]) == (2, 1, 1)

    monkeypatch.setattr(StepParticipant, "arm_step", arm_late)
    run_fleet(main)


def test_a_lease_is_renewed_once_a_second_and_only_while_its_holder_may_move(asked: Counter[str]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        asked.clear()
        async with client.manual_control(["gantry"]) as hand:
            await asyncio.sleep(10.0)
            assert 8 <= asked["lease 3000"] <= 11
            ((_, coordinator),) = fleet.coordinators.values()
            leases = coordinator._leases  # pyright: ignore[reportPrivateUsage]
            await leases.suspend_motion(hand.holder, "the permit is lost")
            asked.clear()
            await asyncio.sleep(5.0)
            assert not asked["lease 3000"]
            assert not (await client.status())["gantry"].leases

    run_fleet(main)
