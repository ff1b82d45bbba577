"""Three SMC-2000 on one daisy chain and an SMC-4000: one fleet, judged by the simulators' truth."""

import asyncio
import json
from typing import Any

import pytest
from cluster.worlds import EXAMPLES, job, outcome
from cluster.worlds import run_fleet as run_any

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.runtime.simulated_fleets import make_sync_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

UNITS = ("feeder", "turner", "outlet")
PREPARE = job("[{do: enable, axes: [line, turner, gantry]}, {do: home}]")
MOVE = job(
    "[{do: move, to: {feeder.x: 60, turner.x: 90, turner.y: 20, outlet.x: 120, gantry.x: 150}, speed: 0.5}]",
    max_start_skew="25 ms",
)


def chain_fleet() -> Fleet:
    return load_fleet(EXAMPLES / "chain.fleet.yaml")


def run_fleet(main: Any, fleet: Fleet | None = None) -> None:
    run_any(main, fleet or chain_fleet())


def held(hold_ms: float) -> Fleet:
    """The fleet with a serial adapter that keeps received bytes for this time."""
    plain = chain_fleet().to_plain()
    for name in UNITS:
        plain["controllers"][name]["simulate"]["hold_ms"] = hold_ms
    return Fleet.model_validate(plain)


@pytest.mark.parametrize("hold_ms", [0, 16])
def test_a_chain_and_another_make_move_together_with_a_verdict_that_contains_the_truth(hold_ms: int):
    async def main(virtual: VirtualFleet) -> None:
        prepared = await outcome(virtual, PREPARE)
        assert prepared.state == "done", prepared.reason
        before = {name: len(each.commanded_motions) for name, each in virtual.controllers.items()}
        report = await outcome(virtual, MOVE)
        assert report.state == "done", report.reason
        step = report.steps[0]
        starts = [each.commanded_motions[before[name]].start_ns for name, each in virtual.controllers.items()]
        skew_ns = max(starts) - min(starts)
        assert step.start_skew is not None
        assert step.start_skew.at_least_ns <= skew_ns <= step.start_skew.at_most_ns
        for name, motors in {"feeder": "X", "turner": "XY", "outlet": "X", "gantry": "X"}.items():
            moved = {motion.axis for motion in virtual.controllers[name].commanded_motions[before[name] :]}
            assert moved == set(motors)

    run_fleet(main, held(hold_ms))


def test_one_controller_is_stopped_alone():
    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        client = virtual.make_client()
        units = virtual.controllers
        async with client.manual_control(["feeder.x"]) as one, client.manual_control(["turner.x"]) as other:
            await one.jog({"feeder.x": 20.0})
            begins = asyncio.ensure_future(other.jog({"turner.x": 20.0}))
            while not begins.done():  # which may wait for its turn on the line
                await one.renew_jog()
                await asyncio.sleep(0.05)
            await begins
            for _ in range(20):
                await asyncio.sleep(0.05)
                await one.renew_jog()
                await other.renew_jog()
            for name in ("feeder", "turner"):
                assert units[name].velocity("X") == pytest.approx(20_000, rel=0.01)
            let_go_ns = virtual.clock.now_ns()
            await one.stop()
            for _ in range(20):
                await asyncio.sleep(0.05)
                await other.renew_jog()
            assert not units["feeder"].is_moving("X")
            assert units["turner"].velocity("X") == pytest.approx(20_000, rel=0.01)
            end_ns = units["feeder"].commanded_motions[-1].end_ns
            assert end_ns is not None and end_ns - let_go_ns < 150 * NS_PER_MS
        assert all(not each.faults for each in (await client.status()).values())

    run_fleet(main)


@pytest.mark.parametrize("fault", ["kill", "freeze"])
def test_a_host_that_dies_in_motion_leaves_the_whole_chain_at_rest_in_the_declared_time(fault: str):
    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        client = virtual.make_client()
        longest_ns = max([(await client.controller_info(name)).costs.stop_ns for name in UNITS])
        await client.submit(MOVE)
        while not all(virtual.controllers[name].is_moving("X") for name in UNITS):
            await sleep_ns(virtual.clock, 10 * NS_PER_MS)
        await sleep_ns(virtual.clock, NS_PER_S // 2)
        assert all(virtual.controllers[name].is_moving("X") for name in UNITS)
        at_ns = virtual.clock.now_ns()
        getattr(virtual, fault)("host/local")
        await sleep_ns(virtual.clock, 5 * NS_PER_S)
        for name in UNITS:
            ends = [motion.end_ns for motion in virtual.controllers[name].commanded_motions]
            assert None not in ends
            # Its guardian's patience, and looking every 50 ms.
            assert max(end for end in ends if end is not None) - at_ns < longest_ns + 400 * NS_PER_MS
        await virtual.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))

    run_fleet(main)


def test_controllers_of_a_chain_come_and_go_independently():
    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        virtual.act_on_controller("outlet", lambda unit: unit.set_power(on=False))
        states = await virtual.wait_until(lambda states: states["outlet"].mode == "offline")
        assert all(states[name].mode == "idle" for name in ("feeder", "turner", "gantry"))
        await sleep_ns(virtual.clock, 20 * NS_PER_S)
        report = await outcome(virtual, job("[{do: move, to: {feeder.x: 30, turner.x: 30}, sync: time}]"))
        assert report.state == "done", report.reason
        virtual.act_on_controller("outlet", lambda unit: unit.set_power(on=True))
        states = await virtual.wait_until(
            lambda states: states["outlet"].mode == "idle" and bool(states["outlet"].epoch)
        )
        assert not states["outlet"].axes["x"].referenced
        assert states["feeder"].axes["x"].referenced and states["turner"].axes["x"].referenced

    run_fleet(main)


def test_a_chain_whose_first_controller_is_off_is_reported_offline_as_a_whole():
    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        virtual.act_on_controller("feeder", lambda unit: unit.set_power(on=False))
        states = await virtual.wait_until(lambda states: all(states[name].mode == "offline" for name in UNITS))
        assert states["gantry"].mode == "idle"
        await sleep_ns(virtual.clock, 10 * NS_PER_S)
        states = await virtual.make_client().status()
        assert all("first" in states[name].faults[0].text + states[name].faults[0].remedy for name in UNITS)
        virtual.act_on_controller("feeder", lambda unit: unit.set_power(on=True))
        states = await virtual.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
        # The others had power all the time.
        assert not states["feeder"].axes["x"].referenced
        assert states["turner"].axes["x"].referenced and states["outlet"].axes["x"].referenced

    run_fleet(main)


@pytest.mark.nightly
def test_eight_controllers_that_start_together_do_not_count_as_silent_while_each_is_polled_in_turn():
    fleet = make_sync_fleet("8 SMC-2000, one chain", 1)
    axes = [f"{name}.x" for name in fleet.controllers]

    async def main(virtual: VirtualFleet) -> None:
        move = {"do": "move", "by": dict.fromkeys(axes, 100.0), "speed": 0.3}
        steps = [{"do": "enable", "axes": axes}, {"do": "home", "axes": axes}, move]
        report = await outcome(virtual, job(json.dumps(steps), max_start_skew="50 ms"))
        assert report.state == "done", report.reason
        moved = report.steps[-1]
        assert moved.t0_fleet_ns is not None and moved.arming_fleet_ns is not None
        # Loading and checking them takes six seconds of their line, in turn: once, and not once for each.
        assert 5 * NS_PER_S < moved.t0_fleet_ns - moved.arming_fleet_ns < 8 * NS_PER_S
        assert not any("arming again" in line for line in virtual.lines)

    run_fleet(main, fleet)
