"""A step of many controllers on several hosts, one of which is late with each of its answers."""

import asyncio
from collections import Counter
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from pytest import MonkeyPatch

from adapters.controller.slots.participant import StepParticipant
from orchestrator.bench.scale import DISTANCE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.coordinator.motion import lead_time
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.simulated_fleets import make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

LATE_S = 1.0
PER_HOST = 10

Handler = Callable[[Any, Any], Awaitable[Any]]


@pytest.mark.parametrize(("count", "verb"), [(40, "arm"), (40, "commit"), (200, "arm"), (200, "commit")])
def test_a_late_member_is_named_and_all_are_armed_again(monkeypatch: MonkeyPatch, count: int, verb: str) -> None:
    late, learned, waited_ns, asked = f"c{PER_HOST + 3}", list[bool](), dict[str, int](), Counter[str]()
    monkeypatch.setattr(lead_time, "KNOWN_AFTER", 1)

    answer: Handler = getattr(StepParticipant, f"{verb}_step")

    async def main(clock: VirtualClock) -> None:
        async def answer_late(self: Any, request: Any) -> Any:
            asked_ns, controller = clock.now_ns(), self._context.controller
            asked[controller] += 1
            if controller == late and learned:
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
        move = {"do": "move", "by": {f"{name}.x": DISTANCE for name in names}}
        assert (await run(move)).state == "done"  # its lead is known from now on
        learned.append(True)
        report = await run(move)
        warnings = [line for line in virtual.lines if "arming again" in line]
        assert warnings and all(f"{late}: " in line or f"{late} has" in line for line in warnings), warnings
        # All were disarmed, and armed again with the lead that the slowest needs.
        assert all(asked[name] > 2 for name in names)
        assert report.state == "done", report.reason
        starts_ns = [controller.commanded_motions[-1].start_ns for controller in virtual.controllers.values()]
        assert max(starts_ns) - min(starts_ns) < 10 * NS_PER_US
        # The answers of the others have not waited for it.
        assert waited_ns.pop(late) >= LATE_S * NS_PER_S
        assert len(waited_ns) == count - 1 and max(waited_ns.values()) < 20 * NS_PER_MS

    run_virtual(main)
