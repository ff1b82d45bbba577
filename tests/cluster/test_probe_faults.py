"""Probes with faults at random instants: behind the contact nothing moves farther than was stated (invariant 20)."""

from random import Random

import pytest
from cluster.test_probe import (
    LIFT_PROBE,
    LIFT_READY,
    PROBE,
    READY,
    STAGE_PROBE,
    STAGE_READY,
    Bench,
    run_bench,
    with_stage_touch,
    with_touch,
)
from cluster.worlds import drive_fleet, job

from adapters.yaskawa.triggers import probe as latch_probe
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of

FAULTS = ("none", "stop", "estop", "cut", "kill-host", "freeze-host", "kill-coordinator", "freeze-coordinator")
SEEDS = 2  # of each fault and make; further ones nightly
NIGHTLY_SEEDS = 20
DETECTION_S = 1.5  # until a guardian has found a dead or frozen host and stopped its controllers, with the ramp
AHEAD_MM, END_MM, SPEED_MM_S = 1.0, 5.0, 1.0

MAKES = {
    "smc4000": (with_touch(), "gantry.x", READY, PROBE),
    "smc4000 program": (with_touch("low", 5), "gantry.x", READY, PROBE),
    "cia402": (drive_fleet("touch"), "lift.z", LIFT_READY, LIFT_PROBE),
    "shrc203": (with_stage_touch(), "stage.u", STAGE_READY, STAGE_PROBE.replace("speed", "by: host, speed")),
}


def find_stated_mm(fleet: Fleet, axis: str, make: str, fault: str) -> float:
    """What the make states at 1 mm/s, mm; where a host stops the axis, and may be dead, what its guardian adds."""
    acceleration = fleet.axis(axis).limits.acceleration
    reaction_s, counts = {
        "smc4000": (0.005, 4),
        "smc4000 program": (0.013, 4),
        "cia402": (0.08, 4),
        "shrc203": (0.3, 3),
    }[make]
    stated = SPEED_MM_S * reaction_s + SPEED_MM_S**2 / acceleration + counts / float(fleet.axis(axis).scale)
    if make.startswith("smc4000") or fault not in ("cut", "kill-host", "freeze-host"):
        return stated
    # What its computer stops cannot be stopped without a link: then it goes to the end of the probe.
    return END_MM - AHEAD_MM if fault == "cut" else stated + SPEED_MM_S * DETECTION_S


async def inject(bench: Bench, fault: str) -> None:
    virtual, controller = bench.virtual, controller_of(bench.axis)
    host = virtual.fleet.controllers[controller].host
    if fault == "stop":
        await bench.client.stop()
    elif fault == "estop":
        await bench.client.estop("a test")
    elif fault == "cut":
        virtual.wires[controller].cut = True
        await sleep_ns(virtual.clock, NS_PER_S)
        virtual.wires[controller].cut = False
    elif fault != "none":
        act, _, part = fault.partition("-")
        getattr(virtual, act)(f"host/{host}" if part == "host" else "coordinator/first")


async def run_seed(bench: Bench, step: str, make: str, fault: str, seed: int) -> float:
    """Probe with a fault; how far the axis has gone behind the contact by truth, mm."""
    draw, scale = Random(f"{make} {fault} {seed}"), float(bench.virtual.fleet.axis(bench.axis).scale)
    shortest_ms = 3 if make == "smc4000 program" else 1
    bench.put_contact(
        AHEAD_MM * scale, [draw.randrange(shortest_ms, 9) * NS_PER_MS for _ in range(2 * draw.randrange(3))]
    )
    await bench.client.submit(job(f"[{step}]"))
    await sleep_ns(bench.virtual.clock, round(draw.uniform(0.0, 1.6) * NS_PER_S))
    await inject(bench, fault)
    await sleep_ns(bench.virtual.clock, 8 * NS_PER_S)
    assert not bench.virtual.controllers[controller_of(bench.axis)].is_moving(bench.motor)
    assert bench.contact is not None
    made = bench.contact.made
    return (bench.find_rest() - made[0].counts) / scale if made else 0.0


def check_seed(make: str, fault: str, seed: int) -> float:
    fleet, axis, ready, step = MAKES[make]
    ways: list[float] = []

    async def main(bench: Bench) -> None:
        ways.append(await run_seed(bench, step, make, fault, seed))

    run_bench(main, fleet, axis, ready)
    assert ways[0] <= find_stated_mm(fleet, axis, make, fault), (make, fault, seed, ways)
    return ways[0]


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("make", MAKES)
def test_nothing_moves_behind_a_contact_beyond_what_was_stated(make: str, fault: str) -> None:
    for seed in range(SEEDS):
        check_seed(make, fault, seed)


@pytest.mark.nightly
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("make", MAKES)
def test_nothing_moves_behind_a_contact_in_more_seeds(make: str, fault: str) -> None:
    for seed in range(SEEDS, NIGHTLY_SEEDS):
        check_seed(make, fault, seed)


def test_a_latch_target_that_is_too_far_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutation: the controller is given another distance than the one that was stated."""
    monkeypatch.setattr(latch_probe, "REACTION_S", 0.05)
    monkeypatch.setattr(latch_probe, "find_ability", lambda *_: None)
    with pytest.raises(AssertionError, match="smc4000"):
        check_seed("smc4000", "none", 0)
