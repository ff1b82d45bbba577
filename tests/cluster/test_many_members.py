"""A step of many controllers on several hosts, one of which is late with each of its answers."""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pytest import MonkeyPatch

from adapters.controller.slots.participant import StepParticipant
from orchestrator.bench.scale import DISTANCE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

LATE_S = 1.0
PER_HOST = 10

Handler = Callable[[Any, Any], Awaitable[Any]]


@pytest.mark.parametrize(("count", "verb"), [(40, "arm"), (40, "commit"), (200, "arm"), (200, "commit")])
def test_a_member_that_is_late_is_named_and_the_others_are_disarmed(
    monkeypatch: MonkeyPatch, count: int, verb: str
) -> None:
    late, waited_ns = f"c{PER_HOST + 3}", dict[str, int]()

    answer: Handler = getattr(StepParticipant, f"{verb}_step")

    async def main(clock: VirtualClock) -> None:
        async def answer_late(self: Any, request: Any) -> Any:
            asked_ns, controller = clock.now_ns(), self._context.controller
            if controller == late:
                await asyncio.sleep(LATE_S)
            try:
                return await answer(self, request)
            finally:
                waited_ns[controller] = max(waited_ns.get(controller, 0), clock.now_ns() - asked_ns)

        monkeypatch.setattr(StepParticipant, f"{verb}_step", answer_late)
        virtual = VirtualFleet(make_light_fleet(count, count // PER_HOST), clock, 1, guardian=False)
        await virtual.start()
        names, client = list(virtual.fleet.controllers), virtual.make_client()

        async def run(*steps: dict[str, Any]) -> Any:
            plain = {"schema": "tutti.job/1", "name": "late", "max_start_skew": "5 ms", "steps": steps}
            return await client.wait_for_job(await client.submit(Job.model_validate(plain)))

        report = await run({"do": "enable", "axes": names}, {"do": "home", "axes": names})
        assert report.state == "done", report.reason
        report = await run({"do": "move", "by": {f"{name}.x": DISTANCE for name in names}})
        await asyncio.sleep(2 * LATE_S)  # its last answer
        moved_axes = sum(len(controller.commanded_motions) for controller in virtual.controllers.values())
        assert {state.mode for state in (await client.status()).values()} == {"idle"}
        if verb == "arm":  # with the lead that it needs, once that is known
            assert any("arming again" in line and f"{late} took longest, 1.0" in line for line in virtual.lines)
            assert (report.state, moved_axes) == ("done", count)
        else:
            assert report.state == "failed" and f"{late} has not answered commit" in report.reason, report.reason
            assert moved_axes == 0
        assert waited_ns.pop(late) >= LATE_S * NS_PER_S
        assert len(waited_ns) == count - 1 and max(waited_ns.values()) < 20 * NS_PER_MS

    run_virtual(main)
