"""Controllers whose clocks cannot be read, as a fleet: their ends approach the plan from step to step; the
simulators provide the ground truth."""

from collections.abc import Mapping
from typing import Any

import pytest
from cluster.worlds import job, origin_host_ns, outcome, run_fleet

from orchestrator.client.clocks import query_clocks
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.simulated_fleets import make_ppsmc, make_shrc203, make_smc30
from orchestrator.runtime.virtual.fleet import VirtualFleet

HOME = job("[{do: enable, axes: [u]}, {do: home}]")
LIVE = make_smc30(1, 1)
LIVE["simulate"]["options"]["live_verify"] = True  # its firmware reports its position in motion
# Half a minute each: a controller, the distance, the fraction of its speed.
UNITS: Mapping[str, tuple[dict[str, Any], float, float]] = {
    "shrc203": (make_shrc203(1), 30, 0.125),
    "smc30": (LIVE, 60, 0.2),
    "ppsmc": (make_ppsmc(1), 300_000, 0.125),
}
FAST_PPM = 40.0


def fleet(name: str, drift_ppm: float = FAST_PPM) -> Fleet:
    config = UNITS[name][0]
    unit = {**config, "simulate": {**config["simulate"], "drift_ppm": drift_ppm, "wander_ppm": 0.05}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "test", "controllers": {"u": unit}})


async def moved(world: VirtualFleet, to: float, speed: float) -> float:
    """Move there; return how much longer than planned it took, in ms. The evidence contains the truth."""
    before = len(world.controllers["u"].commanded_motions)
    report = await outcome(world, job(f"[{{do: move, to: {{u.x: {to}}}, speed: {speed}}}]"))
    assert report.state == "done", report.reason
    step, real = report.steps[0], world.controllers["u"].commanded_motions[before]
    evidence, origin_ns = step.members["u"].evidence["x"], origin_host_ns(world)
    assert evidence.start is not None and evidence.end is not None
    assert real.end_ns is not None and step.planned_s is not None
    assert evidence.start.earliest_ns <= real.start_ns - origin_ns <= evidence.start.latest_ns
    assert evidence.end.earliest_ns <= real.end_ns - origin_ns <= evidence.end.latest_ns
    return ((real.end_ns - real.start_ns) / NS_PER_S - step.planned_s) * 1e3


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.nightly)])
@pytest.mark.parametrize(("name", "least_ms"), [("shrc203", 0.1), ("smc30", 0.15), ("ppsmc", 0.5)])
def test_after_a_minute_of_motion_a_move_ends_within_tenths_of_a_millisecond(
    name: str, least_ms: float, seed: int
) -> None:
    """Before, a crystal that is 40 ppm fast ends a move of 30 s by 1.2 ms too early."""

    async def main(world: VirtualFleet) -> None:
        _, way, speed = UNITS[name]
        await outcome(world, HOME)
        errors_ms = [await moved(world, 0 if number % 2 else way, speed) for number in range(5)]
        assert errors_ms[0] == pytest.approx(-1.2, abs=0.05)
        assert all(abs(each) < least_ms for each in errors_ms[2:])
        crystal = (await query_clocks(world.make_client()))["u"].crystal
        assert crystal is not None and crystal.consistent and crystal.moves == 5
        assert abs(crystal.rate_ppm - FAST_PPM) < min(20, crystal.bound_ppm)

    run_fleet(main, fleet(name), seed)


def test_the_clock_of_a_controller_that_was_off_is_estimated_again() -> None:
    async def main(world: VirtualFleet) -> None:
        _, way, speed = UNITS["shrc203"]
        await outcome(world, HOME)
        await moved(world, way, speed)
        assert abs(await moved(world, 0, speed)) < 0.1
        world.act_on_controller("u", lambda unit: unit.set_power(on=False))
        await sleep_ns(world.clock, 3 * NS_PER_S)
        world.act_on_controller("u", lambda unit: unit.set_power(on=True))
        await sleep_ns(world.clock, 10 * NS_PER_S)
        await outcome(world, HOME)
        assert await moved(world, way, speed) == pytest.approx(-1.2, abs=0.05)
        assert abs(await moved(world, 0, speed)) < 0.1

    run_fleet(main, fleet("shrc203"))


def test_a_reconnected_link_keeps_the_measured_rate() -> None:
    async def main(world: VirtualFleet) -> None:
        _, way, speed = UNITS["ppsmc"]
        await outcome(world, HOME)
        for to in (way, 0, way):
            await moved(world, to, speed)
        for link in list(world.wires["u"].links):
            link.hang_up()
        await sleep_ns(world.clock, 10 * NS_PER_S)
        assert abs(await moved(world, 0, speed)) < 0.5

    run_fleet(main, fleet("ppsmc"))
