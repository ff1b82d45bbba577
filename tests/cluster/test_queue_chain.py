"""Parallel jobs on controllers that share one serial line: each has its own, and its evidence contains the truth."""

import asyncio
from itertools import combinations, product
from random import Random

import pytest
from cluster.worlds import EXAMPLES, changed, job, origin_host_ns, outcome, run_fleet

from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

UNITS = ("feeder", "turner", "outlet")
PREPARE = job("[{do: enable, axes: [line, turner, gantry]}, {do: home}]")


@pytest.mark.parametrize("hold_ms", [16, pytest.param(0, marks=pytest.mark.nightly)])
def test_jobs_on_controllers_of_one_chain_do_not_disturb_each_other(hold_ms: int) -> None:
    chain = load_fleet(EXAMPLES / "chain.fleet.yaml")
    plain = changed(chain).to_plain()
    for name in UNITS:
        plain["controllers"][name]["simulate"]["hold_ms"] = hold_ms

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, draw = fleet.make_client(), Random(hold_ms)
        origin_ns = origin_host_ns(fleet)

        spans: dict[str, list[tuple[int, int]]] = {name: [] for name in (*UNITS, "gantry")}

        async def work(controller: str) -> None:
            unit = fleet.controllers[controller]
            for _ in range(3):
                before = len(unit.commanded_motions)
                target, speed = draw.randint(5, 60), draw.choice((0.3, 1.0))
                steps = f"[{{do: move, to: {{{controller}.x: {target}}}, speed: {speed}}}]"
                report = await client.wait_for_job(await client.submit(job(steps)))
                assert report.state == "done", report.reason
                spans[controller] += [
                    (motion.start_ns, motion.end_ns or 0) for motion in unit.commanded_motions[before:]
                ]
                for motion in unit.commanded_motions[before:]:
                    start = report.steps[0].members[controller].evidence["x"].start
                    assert start.earliest_ns <= motion.start_ns - origin_ns <= start.latest_ns
                await asyncio.sleep(draw.random())

        await asyncio.gather(*(work(name) for name in spans))
        for one, other in combinations(UNITS, 2):
            pairs = product(spans[one], spans[other])
            assert any(a[0] < b[1] and b[0] < a[1] for a, b in pairs), f"{one} and {other} never moved together"

    run_fleet(main, type(chain).model_validate(plain))
