"""The light controller keeps the contract, as far as it has what is checked; and costs next to nothing."""

import asyncio

import pytest
from cluster.worlds import job

from adapters.contract import DriverSetup
from adapters.light.make import MAKE, LightOptions
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.conformance.checks import ContractCheck
from orchestrator.conformance.findings import NotApplicable
from orchestrator.conformance.suite import CONTRACT_CHECKS
from orchestrator.conformance.worlds import Case
from orchestrator.link.base import Link
from orchestrator.link.direct import DirectLink
from orchestrator.model.fleet import Controller
from orchestrator.model.plugins import plugin_names
from orchestrator.runtime.simulated_fleets import make_light, make_light_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.oscillator import Oscillator
from sim.light.controller import LightController

AXIS = {"unit": "mm", "scale": 1000, "limits": {"velocity": 80, "acceleration": 400}, "motors": ["1"]}
CONFIG = {
    "adapter": "light",
    "link": {"kind": "process", "device": "one"},
    "axes": {"x": AXIS, "y": {**AXIS, "motors": ["2"]}},
}
CASE = Case(CONFIG, {"axes": 2}, "process")
LACKS = ("this make cannot jog an axis", "this make cannot wait for an input", "this make has no outputs")


@pytest.mark.parametrize(
    "check",
    [pytest.param(each, id=each.name, marks=[pytest.mark.nightly] if each.is_long else []) for each in CONTRACT_CHECKS],
)
def test_contract(check: ContractCheck) -> None:
    try:
        check.run(CASE)
    except NotApplicable as reason:
        assert str(reason).startswith(LACKS), reason
        pytest.skip(str(reason))


def test_it_is_in_no_list_of_makes() -> None:
    assert "light" not in plugin_names("tutti.adapters")
    assert "light" not in plugin_names("tutti.simulators")


def test_clock_bounds_hold_for_every_rate() -> None:
    async def follow(clock: VirtualClock) -> None:
        for ppm in (-90.0, 0.0, 33.0, 90.0):
            crystal = Oscillator(17 * NS_PER_S, ppm)
            device = LightController(clock, ["1", "2", "3", "4"], crystal)

            async def open_link(device: LightController = device) -> Link:
                return DirectLink("one", clock, device)

            config = Controller.model_validate(make_light(0, "local"))
            writer = LoopTimedWriter(clock, lambda: 0)
            driver = MAKE.create_driver(DriverSetup("one", config, LightOptions(), clock, open_link, writer))
            await driver.connect()
            for poll in range(200):
                await asyncio.sleep(0.4)
                await driver.poll()
                mapping = driver.clock_mapping()
                assert mapping is not None
                for ahead_s in (0.0, 0.3, 2.0):
                    at_ns = clock.now_ns() + round(ahead_s * NS_PER_S)
                    true_ns = crystal.true_ns(round(mapping.to_ticks(at_ns) * 1000))
                    assert abs(true_ns - at_ns) <= mapping.bound_at_ns(at_ns), (ppm, poll, ahead_s)
            assert abs(mapping.rate_ppm + ppm) < 0.2

    run_virtual(follow)


def test_a_moving_controller_whose_link_was_cut_is_stopped_and_there_again() -> None:
    """A stop that could not be sent comes before everything else, over a link of its own."""

    async def main(clock: VirtualClock) -> None:
        fleet = VirtualFleet(make_light_fleet(2, 1), clock, 1)
        await fleet.start()
        client = fleet.make_client()
        report = await client.wait_for_job(
            await client.submit(job("[{do: enable, axes: [c0.x]}, {do: home, axes: [c0.x]}]"))
        )
        assert report.state == "done", report.reason
        await client.submit(job("[{do: move, to: {c0.x: 200}, speed: 0.1}]"))
        await fleet.wait_until(lambda states: states["c0"].mode == "moving")
        fleet.wires["c0"].cut = True
        await asyncio.sleep(2.0)
        assert (await client.status())["c0"].mode == "offline" and fleet.controllers["c0"].is_moving("1")
        fleet.wires["c0"].cut = False
        await fleet.wait_until(lambda states: states["c0"].mode == "idle" and not states["c0"].faults, limit_s=5.0)
        motion = fleet.controllers["c0"].commanded_motions[-1]
        assert motion.slowing_ns is not None and motion.end_counts is not None and motion.end_counts < 100_000

    run_virtual(main)
