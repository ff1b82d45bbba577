"""The members of a step are asked in the order of its axes, whatever the hash seed of the process is."""

import asyncio
from collections.abc import Mapping
from types import SimpleNamespace
from typing import Any, cast

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion.lead_time import LeadTimeEstimator
from orchestrator.coordinator.motion.negotiation import StartAgreement, StartNegotiation
from orchestrator.coordinator.motion.start import StartSequence
from orchestrator.model.messages import Proposal, Reply, StartOptions
from orchestrator.plan.step import AxisMove, plan_step

# So many that a set has them in this order by chance never.
MEMBERS = [f"c{number * 7 % 12}" for number in range(12)]


def test_members_are_asked_in_the_order_of_the_axes() -> None:
    asked: list[str] = []

    async def request_all(verb: str, requests: Mapping[str, Any], reply: type[Proposal]) -> dict[str, Proposal]:
        asked.extend(requests)
        # The answers come in another order.
        return {name: Proposal(durations_s={"x": 1.0}) for name in sorted(requests)}

    fields = {"request_id": "r", "actor": "anna", "epoch": 1, "coordinator": "one"}
    controllers = {name: SimpleNamespace(line=name, digest="0" * 16) for name in sorted(MEMBERS)}
    services = SimpleNamespace(
        leadership=SimpleNamespace(fleet_now_ns=lambda: 0),
        fleet=SimpleNamespace(
            view=SimpleNamespace(fleet=SimpleNamespace(controllers=controllers)),
            requests=SimpleNamespace(request_all=request_all, request_fields=lambda actor: fields),
        ),
        estimator=LeadTimeEstimator(),
    )
    request = SimpleNamespace(
        max_end_skew_ns=None, start_class="auto", wait=None, job=SimpleNamespace(actor="anna"), job_id="j", index=0
    )
    planned = SimpleNamespace(
        request=request, triggers=(), path=None, resolved=SimpleNamespace(moves=[]), rehearsal=False
    )
    agreement = StartAgreement(plan_step([AxisMove(f"{name}.x", 0, 1000, 500.0, 5000.0) for name in MEMBERS]))
    asyncio.run(StartNegotiation(cast(Any, services), cast(Any, planned)).renegotiate(agreement, 1))
    assert asked == MEMBERS
    # What is armed, promised and released goes by the proposals.
    assert list(agreement.proposals) == agreement.actors == MEMBERS


def test_members_are_armed_promised_and_released_in_that_order() -> None:
    asked: dict[str, list[str]] = {}

    async def request_all(
        verb: str, requests: Mapping[str, Any], reply: type[Reply], *rest: object, **options: object
    ) -> dict[str, Reply]:
        asked[verb] = list(requests)
        return {name: reply() for name in sorted(requests)}

    async def execute(task: object, *arguments: object) -> None:
        del task, arguments

    async def on_state(state: object, reason: str) -> None:
        del state, reason

    async def main(clock: VirtualClock) -> None:
        fields = {"request_id": "r", "actor": "anna", "epoch": 1, "coordinator": "one"}
        controllers = {name: SimpleNamespace(digest="0" * 16) for name in sorted(MEMBERS)}
        services = SimpleNamespace(
            leadership=SimpleNamespace(fleet_now_ns=clock.now_ns, epoch=1, over=False),
            fleet=SimpleNamespace(
                clock=clock,
                view=SimpleNamespace(fleet=SimpleNamespace(controllers=controllers)),
                requests=SimpleNamespace(request_all=request_all, request_fields=lambda actor: fields),
            ),
            estimator=LeadTimeEstimator(),
            journal=SimpleNamespace(record_decision=None),
            execute=execute,
        )
        request = SimpleNamespace(move=SimpleNamespace(align=0), job=SimpleNamespace(actor="anna"), job_id="j", index=0)
        negotiation = SimpleNamespace(
            start_options=lambda agreement, members: {name: StartOptions() for name in members},
            judge=lambda agreement, armed: None,
            advance=lambda agreement, armed, spare_ns: None,
        )
        plan = plan_step([AxisMove(f"{name}.x", 0, 1000, 500.0, 5000.0) for name in MEMBERS])
        proposals = {name: Proposal(durations_s={"x": 1.0}) for name in MEMBERS}
        agreement = StartAgreement(plan, proposals=proposals, lead_ns=10 * NS_PER_S)
        permits = SimpleNamespace(require_held=lambda: None)
        parts = (services, request, negotiation, agreement, permits)
        await StartSequence(*(cast(Any, part) for part in parts)).run(on_state)

    run_virtual(main)
    assert asked == {"arm": MEMBERS, "commit": MEMBERS, "go": MEMBERS}
