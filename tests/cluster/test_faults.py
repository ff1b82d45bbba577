"""Findings of the campaign, each by itself: faults that once stopped too little, too late, or too much."""

# pyright: reportPrivateUsage=false

import asyncio
import json
from typing import Any

import pytest
from cluster.test_chain import MOVE as CHAIN_MOVE
from cluster.test_chain import PREPARE as CHAIN_PREPARE
from cluster.test_chain import chain_fleet
from cluster.worlds import (
    MOVE,
    PREPARE,
    changed,
    demo_fleet,
    first_leases_ns,
    job,
    origin_host_ns,
    outcome,
    rested,
    run_fleet,
)

from adapters.contract import ControllerReading
from adapters.controller.slots.withdrawal import StepWithdrawal
from adapters.smc30.driver import Smc30Driver
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Fleet, QueuePolicy
from orchestrator.model.messages import Reply
from orchestrator.model.report import JobState
from orchestrator.runtime import simulated_fleets
from orchestrator.runtime.virtual.fleet import VirtualFleet

CONTINUES = QueuePolicy(on_restart="continue", on_failure="continue")
GANTRY = job("[{do: move, to: {gantry.x: 300}, speed: 0.15}]")  # ten seconds
AGREED = job("[{do: move, to: {gantry.x: 300}, speed: 0.15, start: agreed}]")
STAGE = job("[{do: move, to: {stage.u: 12}, speed: 0.15}]")
BACK = job("[{do: move, to: {gantry.x: 200}, speed: 1}]")
RAMP_S = 0.2


PAIR = {"cia402": {"f1": 1, "f2": 2}, "smc30": {"d1": 1, "d2": 2}}


def pair(make: str) -> Fleet:
    """Two controllers on one bus."""
    drafts: dict[str, Any] = {}
    for name, unit in PAIR[make].items():
        if make == "smc30":
            drafts[name] = simulated_fleets.make_smc30(0, unit)
        else:
            axis = {"motors": ["1"], "unit": "mm", "scale": 1000, "limits": {"velocity": 80, "acceleration": 400}}
            link = {"kind": "can", "interface": "socketcan", "channel": "can0", "address": unit}
            drafts[name] = {"adapter": make, "link": link, "axes": {"x": {**axis, "homing": {"method": "37"}}}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "pair", "controllers": drafts})


async def prepared(fleet: VirtualFleet) -> None:
    names = ", ".join(fleet.controllers)
    report = await outcome(fleet, job(f"[{{do: enable, axes: [{names}]}}, {{do: home}}]"))
    assert report.state == "done", report.reason


async def running(fleet: VirtualFleet, job_id: str) -> None:
    """Wait until all members have received `go`; none has started."""
    await reached(fleet, job_id, "running")


async def reached(fleet: VirtualFleet, job_id: str, state: JobState) -> None:
    runs = fleet.coordinators["first"][1].scheduler.register.running
    while job_id not in runs or runs[job_id].state != state:
        await asyncio.sleep(0.0001)


def two_hosts() -> Fleet:
    return changed(demo_fleet(), stage={"host": "right"})


def now_s(fleet: VirtualFleet) -> float:
    return fleet.clock.now_ns() / NS_PER_S


def gantry_end_s(fleet: VirtualFleet) -> float:
    """When the gantry came to rest last."""
    end_ns = fleet.controllers["gantry"].commanded_motions[-1].end_ns
    assert end_ns is not None
    return end_ns / NS_PER_S


def test_an_unreachable_host_does_not_end_the_leases_on_others() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        job_id = await client.submit(GANTRY)
        async with client.manual_control(["stage.u"], ttl_s=30.0):
            await asyncio.sleep(1.5)
            fleet.net.partition_net(
                {fleet.find_process("host/right").name}, {fleet.find_process("coordinator/first").name}
            )
            report = await client.wait_for_job(job_id)
            assert report.state == "done", report.reason
            fleet.net.heal_partition()

    run_fleet(main, two_hosts())


async def host_killed_in_a_move(fleet: VirtualFleet) -> tuple[Tutti, str]:
    """A client and its job, which moves both controllers, when the host of one of them has just been killed."""
    assert (await outcome(fleet, PREPARE)).state == "done"
    client = fleet.make_client()
    job_id = await client.submit(MOVE)
    await asyncio.sleep(3.0)
    fleet.kill("host/right")
    return client, job_id


def test_others_stop_when_an_adapter_dies_and_restarts_before_it_is_missed() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client, job_id = await host_killed_in_a_move(fleet)
        killed_s = now_s(fleet)
        report = await client.wait_for_job(job_id)
        assert report.state == "failed" and "stage: its adapter" in report.reason
        await asyncio.sleep(1.0)
        assert gantry_end_s(fleet) < killed_s + 1.0 + RAMP_S

    run_fleet(main, two_hosts())


@pytest.mark.parametrize("closed", [False, True])
def test_a_job_waits_for_the_ramp_of_the_previous_one_which_keeps_its_axes_until_then(closed: bool) -> None:
    """Also if the link of a moving controller is closed: it is stopped as soon as the link is open again."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        leased_ns = await first_leases_ns(fleet, client, "gantry")
        first = await client.submit(GANTRY)
        second = await client.submit(BACK)
        await asyncio.sleep(3.0)
        if closed:
            for link in list(fleet.wires["gantry"].links):
                link.hang_up()
        else:
            await client.cancel_job(first)
        assert (await client.wait_for_job(first)).state == ("failed" if closed else "cancelled")
        report = await client.wait_for_job(second)
        assert report.state == "done", report.reason
        assert rested(fleet, "gantry", leased_ns[second])

    run_fleet(main, demo_fleet().model_copy(update={"queue": CONTINUES}))


def test_a_controller_that_hung_at_its_start_is_stopped_when_it_recovers() -> None:
    """It starts when it wakes, and the stop that it received meanwhile was lost with its link."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        before = len(fleet.controllers["gantry"].commanded_motions)
        job_id = await client.submit(GANTRY)
        await running(fleet, job_id)
        await asyncio.sleep(0.1)  # by then its program waits for nothing but its sample
        fleet.freeze("sim/gantry")
        report = await client.wait_for_job(job_id)
        assert report.state == "failed" and "gantry" in report.reason
        await asyncio.sleep(1.5)
        assert (await client.status())["gantry"].mode == "offline"
        fleet.resume("sim/gantry")
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        made = fleet.controllers["gantry"].commanded_motions[before:]
        assert made and made[-1].end_ns is not None and fleet.controllers["gantry"].at_rest()

    run_fleet(main)


def test_a_seldom_polled_fleet_does_not_count_as_dead() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, CHAIN_PREPARE, CHAIN_MOVE)
        assert report.state == "done", report.reason

    rates = {"state": {"idle_hz": 0.5, "moving_hz": 3.0}}
    run_fleet(main, changed(chain_fleet(), **dict.fromkeys(("feeder", "turner", "outlet", "gantry"), rates)))


@pytest.mark.parametrize("after_s", [0.0, 1.0])
def test_a_stop_that_was_lost_on_a_broken_line_is_sent_again(after_s: float) -> None:
    """A stop just before the start, too, which then occurs."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        job_id = await client.submit(GANTRY)
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        await asyncio.sleep(after_s)
        wire = fleet.wires["gantry"]
        wire.to_far = lambda data: b"" if data.startswith((b"ST", b"HX")) else data
        await client.stop()
        wire.to_far = None
        assert (await client.wait_for_job(job_id)).state == "aborted"
        await asyncio.sleep(4.0)  # of ten
        assert fleet.controllers["gantry"].commanded_motions[-1].end_ns is not None

    run_fleet(main)


def test_a_member_that_received_go_is_stopped_at_its_start_when_its_link_is_closed() -> None:
    """A member that has promised is not read before T0. From T0 on its link is reopened at once, without a pause."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        before = len(fleet.controllers["gantry"].commanded_motions)
        job_id = await client.submit(GANTRY)
        await running(fleet, job_id)
        await asyncio.sleep(0.02)  # of some ninety milliseconds
        for link in list(fleet.wires["gantry"].links):
            link.hang_up()
        assert (await client.wait_for_job(job_id)).state == "failed"
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        begun = fleet.controllers["gantry"].commanded_motions[before:]
        assert all(each.slowing_ns is not None and each.slowing_ns - each.start_ns < 20 * NS_PER_MS for each in begun)

    run_fleet(main)


@pytest.mark.parametrize("state", ["armed", "running"])
def test_a_controller_that_is_about_to_move_is_not_reset(state: JobState) -> None:
    """Commands that clear faults are executed before the start command, and would delay it."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        job_id = await client.submit(AGREED)
        await reached(fleet, job_id, state)
        refused = (await client.reset())["gantry"]
        assert refused is not None and refused.code == "busy" and f"for job {job_id}" in refused.text
        assert (await client.wait_for_job(job_id)).state == "done"
        assert not any((await client.reset()).values())

    run_fleet(main)


def test_a_controller_that_was_being_armed_when_its_link_was_closed_is_stopped(monkeypatch: pytest.MonkeyPatch) -> None:
    """It waits for its trigger line by then, and its port was kept open by the other controller."""
    poll = Smc30Driver.poll
    broken: list[int] = []

    async def polled(driver: Smc30Driver) -> ControllerReading:
        if driver._address in broken and driver.connection.state.loading.locked():
            broken.clear()
            raise ControllerFault("two-answers", "more answers than questions", "")
        return await poll(driver)

    monkeypatch.setattr(Smc30Driver, "poll", polled)
    units = {
        name: {**simulated_fleets.make_smc30(0, unit), "state": {"idle_hz": 50}} for name, unit in PAIR["smc30"].items()
    }
    lined = simulated_fleets.make_wired({"a1": simulated_fleets.make_smc4000(0), **units})

    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet)
        client = fleet.make_client()
        job_id = await client.submit(job("[{do: move, to: {d1.x: 30, d2.x: 30}, start: line, speed: 0.2}]"))
        await reached(fleet, job_id, "arming")
        broken.append(2)
        assert (await client.wait_for_job(job_id)).state == "failed"
        await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()), limit_s=3.0)
        assert not broken and all(unit.at_rest() for unit in fleet.controllers.values())

    run_fleet(main, Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "lined", **lined}))


def test_drives_that_missed_their_sync_do_not_start_when_they_are_reconnected() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet)
        client = fleet.make_client()
        job_id = await client.submit(job("[{do: move, to: {f1.x: 60, f2.x: 60}, speed: 0.2}]"))
        await running(fleet, job_id)
        fleet.wires["f1"].cut = True
        assert (await client.wait_for_job(job_id)).state == "failed"
        await asyncio.sleep(1.0)
        fleet.wires["f1"].cut = False
        await fleet.wait_until(lambda states: all(state.mode == "idle" for state in states.values()))
        await asyncio.sleep(1.0)
        assert [unit.commanded_motions for unit in fleet.controllers.values()] == [[], []]

    run_fleet(main, pair("cia402"))


@pytest.mark.parametrize("make", list(PAIR))
def test_a_controller_on_its_limit_reports_no_start_and_the_other_one_stops(make: str) -> None:
    stuck, other = PAIR[make]
    move = job(f"[{{do: move, to: {{{stuck}.x: 30, {other}.x: 30}}, speed: 0.5}}]", max_start_skew="100 ms")

    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet)
        client = fleet.make_client()
        before = {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}
        job_id = await client.submit(move)
        await running(fleet, job_id)
        fleet.act_on_controller(stuck, lambda unit: unit.set_limit("1", "both"))
        report = await client.wait_for_job(job_id)
        assert report.state == "failed" and stuck in report.reason
        assert not report.steps[0].members[stuck].evidence
        await asyncio.sleep(2.0)
        assert len(fleet.controllers[stuck].commanded_motions) == before[stuck]
        (made,) = fleet.controllers[other].commanded_motions[before[other] :]
        assert made.end_ns is not None and made.end_ns - made.start_ns < 2 * NS_PER_S

    run_fleet(main, pair(make))


def test_no_member_starts_when_one_does_not_receive_go() -> None:
    """The step is given up while the others can still be disarmed."""

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        before = {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()}
        job_id = await client.submit(MOVE)
        await reached(fleet, job_id, "committed")
        fleet.net.partition_net({fleet.find_process("host/right").name}, {fleet.find_process("coordinator/first").name})
        report = await client.wait_for_job(job_id)
        assert report.state == "failed" and "stage has not answered go" in report.reason
        fleet.net.heal_partition()
        await asyncio.sleep(1.0)
        assert {name: len(unit.commanded_motions) for name, unit in fleet.controllers.items()} == before

    run_fleet(main, two_hosts())


def test_a_member_that_does_not_answer_delays_no_stop_of_another(monkeypatch: pytest.MonkeyPatch) -> None:
    async def begun(*_: object) -> Reply:
        raise Refusal("moving", "the step moves already")

    monkeypatch.setattr(StepWithdrawal, "disarm_step", begun)

    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        job_id = await client.submit(MOVE)
        await reached(fleet, job_id, "committed")
        before = len(fleet.controllers["gantry"].commanded_motions)
        fleet.net.partition_net({fleet.find_process("host/right").name}, {fleet.find_process("coordinator/first").name})
        refused_s = now_s(fleet)
        assert (await client.wait_for_job(job_id)).state == "failed"
        fleet.net.heal_partition()
        for motion in fleet.controllers["gantry"].commanded_motions[before:]:
            assert motion.end_ns is not None and motion.end_ns / NS_PER_S < refused_s + 0.5 + RAMP_S

    run_fleet(main, two_hosts())


def gentle_fleet(**units: dict[str, Any]) -> Fleet:
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "gentle", "controllers": units})


def test_a_gentle_stop_ramp_is_waited_for_to_its_end() -> None:
    """An SMC30 brakes by the ramp of its move, here that of the slow gantry: much longer than at its limits."""
    gantry = simulated_fleets.make_smc4000(0)
    gantry["axes"]["x"]["limits"] = {"velocity": 200, "acceleration": 60}

    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet)
        client = fleet.make_client()
        step = "[{do: move, to: {gantry.x: 300, steps.x: 15}, speed: 0.5}]"
        first = await client.submit(job(step, max_start_skew="50 ms"))
        then = await client.submit(job("[{do: move, to: {steps.x: 1}}]", max_start_skew="50 ms"))
        await fleet.wait_until(lambda states: states["steps"].mode == "moving")
        await sleep_ns(fleet.clock, 2 * NS_PER_S)
        await client.cancel_job(first)
        assert (await client.wait_for_job(then)).state == "done"
        stopped, moved = fleet.controllers["steps"].commanded_motions[-2:]
        assert stopped.slowing_ns is not None and stopped.end_ns is not None
        assert stopped.end_ns - stopped.slowing_ns > NS_PER_S and stopped.end_ns < moved.start_ns
        assert not any("moves although it was stopped" in line for line in fleet.lines)
        begun = [json.loads(line) for line in fleet.lines if then in line and "job is running" in line]
        origin_ns = origin_host_ns(fleet)
        assert begun[0]["fleet_ns"] + origin_ns >= stopped.end_ns

    run_fleet(main, gentle_fleet(gantry=gantry, steps=simulated_fleets.make_smc30(0, 1)))


@pytest.mark.parametrize("restart_s", [0.2, 1.2])
def test_a_job_waits_for_an_unreachable_controller_as_long_as_it_may_brake(
    monkeypatch: pytest.MonkeyPatch, restart_s: float
) -> None:
    """Its host is killed, and its guardian stops it, by a ramp of four seconds. Meanwhile the new adapter has not
    connected to it yet, or does not exist."""
    monkeypatch.setattr("orchestrator.runtime.virtual.fleet.RESTART_NS", round(restart_s * NS_PER_S))
    steps = simulated_fleets.make_smc30(0, 1)
    steps["axes"]["x"]["limits"] = {"velocity": 8, "acceleration": 1}

    async def main(fleet: VirtualFleet) -> None:
        await prepared(fleet)
        client = fleet.make_client()
        leased_ns = await first_leases_ns(fleet, client, "steps")
        first = await client.submit(job("[{do: move, to: {steps.x: 150}}]", max_start_skew="50 ms"))
        await fleet.wait_until(lambda states: states["steps"].mode == "moving")
        await sleep_ns(fleet.clock, 8 * NS_PER_S)
        fleet.kill("host/local")
        assert (await client.wait_for_job(first)).state == "failed"
        await sleep_ns(fleet.clock, 3 * NS_PER_S // 2)
        then = await client.submit(job("[{do: enable, axes: [steps]}, {do: home, axes: [steps]}]"))
        await client.wait_for_job(then)
        moved = [each for each in fleet.controllers["steps"].commanded_motions if each.start_ns < leased_ns[then]]
        stopped = moved[-1]
        assert stopped.slowing_ns is not None and stopped.end_ns is not None
        assert stopped.end_ns - stopped.slowing_ns > 4 * NS_PER_S
        assert rested(fleet, "steps", leased_ns[then])

    run_fleet(main, gentle_fleet(steps=steps).model_copy(update={"queue": CONTINUES}))


def test_a_stop_that_was_lost_with_the_bus_is_requested_again() -> None:
    """The bus is away while a member fails, and back before any adapter stops because it misses its coordinator."""

    async def main(fleet: VirtualFleet) -> None:
        client, job_id = await host_killed_in_a_move(fleet)
        await asyncio.sleep(0.5)
        fleet.net.partition_net({fleet.find_process("host/local").name}, {fleet.find_process("coordinator/first").name})
        await asyncio.sleep(0.3)
        assert not fleet.controllers["gantry"].at_rest()
        fleet.net.heal_partition()
        back_s = now_s(fleet)
        assert (await client.wait_for_job(job_id)).state == "failed"
        await asyncio.sleep(1.0)
        assert gantry_end_s(fleet) < back_s + 0.4 + RAMP_S

    run_fleet(main, two_hosts())


@pytest.mark.parametrize("lost", ["started", "done"])
def test_an_event_that_was_lost_with_the_bus_and_is_followed_by_none_is_requested(lost: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        client = fleet.make_client()
        before = len(fleet.controllers["stage"].commanded_motions)
        job_id = await client.submit(STAGE)
        while len(motions := fleet.controllers["stage"].commanded_motions) == before:
            await asyncio.sleep(0.0001)
        while lost == "done" and motions[-1].end_ns is None:
            await asyncio.sleep(0.0001)
        fleet.net.partition_net({fleet.find_process("host/right").name}, {fleet.find_process("coordinator/first").name})
        await asyncio.sleep(0.2)
        fleet.net.heal_partition()
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        evidence = report.steps[0].members["stage"].evidence["u"]
        took_ns = (motions[-1].end_ns or 0) - motions[-1].start_ns
        assert evidence.end is not None
        assert evidence.end.earliest_ns - evidence.start.latest_ns <= took_ns
        assert took_ns <= evidence.end.latest_ns - evidence.start.earliest_ns

    run_fleet(main, two_hosts())
