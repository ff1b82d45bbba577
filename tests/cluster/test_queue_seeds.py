"""Users who change the queue at random, and coordinators that die: no job is forgotten, and none runs twice or at
the same time as another one on its controllers."""

import asyncio
from contextlib import suppress
from itertools import pairwise
from random import Random

import pytest
from cluster.worlds import PREPARE, job, outcome, run_fleet

from orchestrator.model.errors import Refusal
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import FINISHED_STATES, JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

# By name: axes, and the counts that one run moves them by.
KINDS = {
    "g": ("[{do: move, by: {gantry.y: 0.5}, speed: 0.2}]", {"gantry": 500}),
    "s": ("[{do: move, by: {stage.u: 0.1}, speed: 0.2}]", {"stage": 1000}),
    "b": (
        "[{do: move, by: {gantry.y: 0.5, stage.u: 0.1}}, {do: dwell, duration: 500 ms}]",
        {"gantry": 500, "stage": 1000},
    ),
}
MOTORS = {"gantry": "Y", "stage": "1"}


@pytest.mark.parametrize("seed", [0, *(pytest.param(n, marks=pytest.mark.nightly) for n in range(1, 12))])
def test_no_seed_forgets_a_job_or_runs_it_twice(seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        draw, client = Random(seed), fleet.make_client("anna")
        assert (await outcome(fleet, PREPARE)).state == "done"
        before = {name: fleet.controllers[name].position(motor) for name, motor in MOTORS.items()}
        accepted: dict[str, str] = {}
        reigns = 0
        for number in range(60):
            known = list(accepted)
            some = draw.choice(known) if known else ""
            act = draw.random() if known else 0.0
            with suppress(Refusal):
                if act < 0.5:
                    kind = draw.choice("ggssb")
                    terms = QueueTerms(
                        priority=draw.choice((0, 0, 0, 3)),
                        held=draw.random() < 0.1,
                        after=some if some and draw.random() < 0.1 else None,
                    )
                    accepted[await client.submit(job(KINDS[kind][0]), f"k{number}", terms)] = kind
                elif act < 0.58:
                    await client.cancel_job(some)
                elif act < 0.64:
                    await client.hold_jobs(some)
                elif act < 0.72:
                    await client.release_jobs()
                elif act < 0.78:
                    await client.reorder_job(some, before=draw.choice(known))
                elif act < 0.86:
                    await client.pause_job(some)
                elif act < 0.94:
                    await client.resume_job(some)
                elif reigns < 2:
                    reigns += 1
                    fleet.kill("coordinator/first")
                    await asyncio.sleep(1.5)
                    fleet.start_coordinator("first")
                    await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
                    await asyncio.sleep(2.0)
            await asyncio.sleep(draw.choice((0.0, 0.1, 0.7)))
        reports = await finish(fleet, list(accepted))
        judge(fleet, accepted, reports, before)

    run_fleet(main, seed=seed)


async def finish(fleet: VirtualFleet, job_ids: list[str]) -> dict[str, JobReport]:
    """Let everything run to its end."""
    client = fleet.make_client("ben")
    for _ in range(600):
        with suppress(Refusal):  # what moves first has changed since it was shown
            await client.start_queue()
        await client.release_jobs()
        for each in (await client.list_jobs(10_000)).jobs:
            if each.state not in FINISHED_STATES:
                with suppress(Refusal):
                    await client.resume_job(each.id)
        if not (await fleet.make_client().list_jobs(1, state="queued")).jobs and all(
            (each.state in FINISHED_STATES) for each in (await client.list_jobs(10_000)).jobs
        ):
            break
        await asyncio.sleep(0.5)
    return {each: await client.wait_for_job(each) for each in job_ids}


def judge(
    fleet: VirtualFleet, accepted: dict[str, str], reports: dict[str, JobReport], before: dict[str, float]
) -> None:
    assert {report.state for report in reports.values()} <= {"done", "cancelled", "interrupted", "failed"}
    assert sum(report.state == "done" for report in reports.values()) > 5
    spans: dict[str, list[tuple[str, str]]] = {name: [] for name in MOTORS}
    moved = dict.fromkeys(MOTORS, 0)
    broken = set[str]()
    for job_id, report in reports.items():
        states = [change.state for change in report.transitions]
        assert sum(state in FINISHED_STATES for state in states) == 1, states
        assert states.count("committed") <= 1, states
        for name, counts in KINDS[accepted[job_id]][1].items():
            if report.started_utc is not None:
                spans[name].append((report.started_utc, report.ended_utc or ""))
            if report.state == "done":
                moved[name] += counts
            elif "committed" in states:
                broken.add(name)
    for name, each in spans.items():
        # RFC 3339 texts of one form are in the order of their instants.
        ordered = sorted(each)
        for (_, ended), (started, _) in pairwise(ordered):
            assert ended <= started, f"two jobs had {name} at the same time"
    for name, motor in MOTORS.items():
        if name not in broken:
            assert fleet.controllers[name].position(motor) == before[name] + moved[name]
