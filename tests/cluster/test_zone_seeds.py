"""Keep-out zones by truth: whatever job is accepted, and whatever fault comes into it, bodies are never nearer than their
rule allows."""

import asyncio
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from random import Random

import pytest
from cluster.test_zone_watch import HOME
from cluster.test_zones import ENABLE, zones_fleet
from cluster.worlds import give_word, outcome, run_fleet

from orchestrator.bus.base import Priority
from orchestrator.campaign.stages.zone_truth import TRUTH, ZoneTruth
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import EstopMessage
from orchestrator.plan.zones.course import Course
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import Violation
from orchestrator.runtime.virtual.fleet import VirtualFleet

JOBS = 4
# Most of the ways lead over the sample, high and low.
TARGETS = {"gantry.x": (100, 300), "gantry.z": (0, 50), "stage.u": (0, 50), "stage.phi": (-90, 90)}


@dataclass
class ZoneRun:
    """What came of a seed. nearest: by rule, as of `ZoneTruth`."""

    nearest: dict[str, float] = field(default_factory=dict[str, float])
    done: int = 0
    refused: int = 0


def cut_link(fleet: VirtualFleet, draw: Random) -> None:
    fleet.wires[draw.choice(["gantry", "stage"])].cut = True


def kill_host(fleet: VirtualFleet, _: Random) -> None:
    fleet.kill("host/local")


def kill_coordinator(fleet: VirtualFleet, _: Random) -> None:
    fleet.kill("coordinator/first")


def send_estop(fleet: VirtualFleet, _: Random) -> None:
    client = fleet.make_client("anna")
    client.bus.put(fleet.keys.estop, EstopMessage(event="seed", actor="anna").to_json(), Priority.ESTOP)


def cut_power(fleet: VirtualFleet, draw: Random) -> None:
    fleet.act_on_controller(draw.choice(["gantry", "stage"]), lambda controller: controller.set_power(on=False))


def block_axis(fleet: VirtualFleet, draw: Random) -> None:
    fleet.act_on_controller("gantry", lambda controller: controller.set_limit(draw.choice("XY"), "forward"))


def do_nothing(fleet: VirtualFleet, _: Random) -> None:
    del fleet


FAULTS: list[Callable[[VirtualFleet, Random], None]] = [
    *(do_nothing, cut_link, kill_host, kill_coordinator),
    *(send_estop, cut_power, block_axis),
]


def draw_job(draw: Random) -> Job:
    axes = draw.sample(list(TARGETS), draw.choice([1, 1, 2, 2, 3]))
    targets = {axis: round(draw.uniform(*TARGETS[axis]), 1) for axis in axes}
    step = {"do": "move", "to": targets, "speed": draw.choice([0.3, 1.0]), "sync": draw.choice(["time", "none"])}
    plain = {"schema": "tutti.job/1", "name": "drawn", "max_start_skew": "50 ms", "steps": [step]}
    return Job.model_validate(plain)


def run_seed(seed: int) -> ZoneRun:
    draw, run = Random(f"zones {seed}"), ZoneRun()
    fault = FAULTS[seed % len(FAULTS)]

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, ENABLE, HOME)
        truth = ZoneTruth(fleet)
        run.nearest, watching = truth.nearest, asyncio.ensure_future(truth.watch())
        client = fleet.make_client()
        for number in range(3 * JOBS):
            is_last = run.done >= JOBS - 1
            job_id = await client.submit(draw_job(draw))
            if is_last:
                await sleep_ns(fleet.clock, draw.randrange(NS_PER_S // 2, 3 * NS_PER_S))
                entry = (await client.show_job(job_id)).entry
                if entry is not None and entry.state == "running":
                    fault(fleet, draw)
                    await sleep_ns(fleet.clock, 8 * NS_PER_S)
                    break
            report = await client.wait_for_job(job_id, on_ready=give_word)
            run.done += report.state == "done"
            run.refused += report.state == "failed"
            if report.state == "failed":
                await client.start_queue()
            assert report.state == "done" or "zone " in report.reason, (number, report.reason)
        watching.cancel()

    run_fleet(main, zones_fleet())
    return run


@pytest.mark.parametrize("seed", [3, 6, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(10, 210))])
def test_no_accepted_job_brings_bodies_nearer_than_they_may_be(seed: int) -> None:
    run = run_seed(seed)
    assert run.done and run.nearest
    assert min(run.nearest.values()) >= -TRUTH, run


def test_the_seeds_find_bodies_that_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the check ahead; the watch stops what has come too near already."""

    def find_none(zones: FleetZones, course: Course) -> Iterator[Violation]:
        del zones, course
        return iter(())

    monkeypatch.setattr(FleetZones, "find_violations", find_none)
    assert min(run_seed(3).nearest.values()) < -TRUTH
