"""Adapter hosts on computers of their own: other clocks, a network in between, and what happens when either fails."""

from collections.abc import Callable, Coroutine
from typing import Any

import numpy as np
import pytest
from cluster.test_contour import two_gantries
from cluster.test_paths import TWO, circle, circle_errors, follow, gantry_and_drive, prepare, require_sound
from cluster.worlds import PREPARE, demo_fleet, job, origin_host_ns, outcome, rested

from orchestrator.bus.memory.network import NetworkPath
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.clock.crystal import ComputerClock
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

LAN = NetworkPath(200 * NS_PER_US, 100 * NS_PER_US)
COORDINATOR_LOST_S = 0.6  # 500 ms, looked at each 100 ms
FORTH = job(
    "[{do: move, to: {gantry.x: 300, gantry.y: 50, stage.u: 12, stage.focus: 2000}, speed: 0.15, max_start_skew: 1 s}]"
)
BACK = job(
    "[{do: move, to: {gantry.x: 10, gantry.y: 5, stage.u: 1, stage.focus: 100}, speed: 0.15, max_start_skew: 1 s}]"
)


def apart(fleet: Fleet) -> Fleet:
    """Each controller on a host of its own."""
    controllers = {name: config.model_copy(update={"host": name}) for name, config in fleet.controllers.items()}
    return fleet.model_copy(update={"controllers": controllers})


def run_apart(
    main: Callable[[VirtualFleet], Coroutine[Any, Any, None]],
    to: NetworkPath = LAN,
    back: NetworkPath | None = None,
    fleet: Fleet | None = None,
) -> None:
    """Run `main` with each controller of a fleet on a computer of its own, whose crystals run 100 ppm apart."""

    async def run(clock: VirtualClock) -> None:
        drawn = apart(fleet or demo_fleet())
        clocks = {
            host: ComputerClock(clock, host, number * 1000 * NS_PER_S, 50.0 * (-1) ** number)
            for number, host in enumerate(drawn.controllers, start=1)
        }
        virtual = VirtualFleet(drawn, clock, 1)
        virtual.computers.update(clocks)
        for host in clocks:
            virtual.net.network.set_path(host, to=to, back=back)
        await virtual.start()
        await main(virtual)

    run_virtual(run)


def true_starts(fleet: VirtualFleet, report: JobReport) -> dict[str, int]:
    """By axis, how long after T0 it really started, ns."""
    step, found = report.steps[0], dict[str, int]()
    assert step.t0_fleet_ns is not None
    for member, each in step.members.items():
        for name in each.evidence:
            motors = fleet.fleet.axis(f"{member}.{name}").motors
            made = [each for each in fleet.controllers[member].commanded_motions if each.axis in motors]
            found[f"{member}.{name}"] = made[-1].start_ns - origin_host_ns(fleet) - step.t0_fleet_ns
    return found


def require_true_evidence(fleet: VirtualFleet, report: JobReport) -> int:
    """Each start lies in its interval and within the budget; return how far the true ones are apart, ns."""
    assert report.state == "done", report.reason
    step, starts = report.steps[0], true_starts(fleet, report)
    assert step.budget is not None and step.t0_fleet_ns is not None and step.verdict == "green", step.deviations
    for member, each in step.members.items():
        window = step.budget.members[member]
        assert "fleet-time" in {term.name for term in window.terms}
        for axis, evidence in each.evidence.items():
            true_ns = starts[f"{member}.{axis}"]
            assert evidence.start.earliest_ns <= step.t0_fleet_ns + true_ns <= evidence.start.latest_ns
            assert window.earliest_ns <= true_ns <= window.latest_ns
    spread_ns = max(starts.values()) - min(starts.values())
    assert spread_ns <= step.budget.predicted_ns
    return spread_ns


def fleet_time_ns(report: JobReport, member: str) -> int:
    """By how much the fleet time of a member's host may be off, ns."""
    budget = report.steps[0].budget
    assert budget is not None
    (term,) = [each for each in budget.members[member].terms if each.name == "fleet-time"]
    return term.latest_ns


@pytest.mark.parametrize("delay_ms", [0.5, 5])
def test_controllers_on_two_computers_start_as_close_as_on_one(delay_ms: float) -> None:
    delay_ns = round(delay_ms * NS_PER_MS)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        for each in (FORTH, BACK):
            report = await outcome(fleet, each)
            # On one computer these two start up to 1.5 ms apart: half a tick, and what a line of text takes.
            assert require_true_evidence(fleet, report) < 1.6 * NS_PER_MS
            for member in report.steps[0].members:
                # Half of the best round trip, and the rate bound over the second since it and the lead time of T0.
                assert delay_ns < fleet_time_ns(report, member) < delay_ns + 0.7 * NS_PER_MS

    run_apart(main, NetworkPath(delay_ns))


def test_a_delay_of_one_direction_is_inside_every_interval() -> None:
    """No exchange can reveal it: the starts are 10 ms apart, and the evidence says that they may be."""

    async def main(fleet: VirtualFleet) -> None:
        # The answers to `stage` take as much longer as the requests of `gantry` do.
        fleet.net.network.set_path("gantry", to=NetworkPath(10 * NS_PER_MS), back=NetworkPath())
        fleet.net.network.set_path("stage", to=NetworkPath(), back=NetworkPath(10 * NS_PER_MS))
        await sleep_ns(fleet.clock, 10 * NS_PER_S)
        for host in ("gantry", "stage"):
            fleet.kill(f"host/{host}")  # its successor asks for the time anew
        await fleet.wait_until(lambda states: all(each.epoch and each.mode == "idle" for each in states.values()))
        await outcome(fleet, PREPARE)
        report = await outcome(fleet, FORTH)
        assert require_true_evidence(fleet, report) > 5 * NS_PER_MS

    run_apart(main, NetworkPath())


def test_a_path_over_two_computers_stays_within_its_bound() -> None:
    """Their crystals run 100 ppm apart: without the rate between them the axes would be 2 ms and 0.2 mm apart."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, prepare(fleet.fleet, TWO))
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        report, seen = await follow(fleet, TWO, circle(TWO, 5, "2 mm"))
        bound, errors = require_sound(report.steps[0].path), circle_errors(seen)
        assert len(seen) > 900 and errors.max() < bound
        assert np.percentile(errors, 99) < 0.06

    run_apart(main, fleet=two_gantries())


@pytest.mark.nightly
def test_a_stream_on_another_computer_keeps_to_fleet_time() -> None:
    async def main(fleet: VirtualFleet) -> None:
        axes = ("gantry.x", "drive.y")
        await outcome(fleet, prepare(fleet.fleet, axes))
        await sleep_ns(fleet.clock, 30 * NS_PER_S)
        report, seen = await follow(fleet, axes, circle(axes, 7, "2 mm"))
        errors = circle_errors(seen)
        assert len(seen) > 1200 and errors.max() < require_sound(report.steps[0].path)
        assert np.percentile(errors, 99) < 0.06

    run_apart(main, fleet=gantry_and_drive())


# Failures


async def begin(fleet: VirtualFleet, move: Job) -> str:
    """Submit a move, and wait until it has moved for a second."""
    client = fleet.make_client()
    await client.start_queue()
    job_id = await client.submit(move)
    await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
    await sleep_ns(fleet.clock, NS_PER_S)
    return job_id


async def require_next_job(fleet: VirtualFleet) -> None:
    """The fleet does a job again."""
    await fleet.wait_until(lambda states: all(each.epoch and each.mode == "idle" for each in states.values()))
    prepared = await outcome(fleet, PREPARE)
    assert prepared.state == "done", prepared.reason
    require_true_evidence(fleet, await outcome(fleet, BACK))


@pytest.mark.parametrize(("computer", "seconds"), [("gantry", 3), ("stage", -3)])
def test_a_clock_that_jumps_stops_what_was_timed_by_it(computer: str, seconds: int) -> None:
    """A suspended computer's clock stands; one of a virtual machine that is moved may go on elsewhere."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        job_id = await begin(fleet, FORTH)
        fleet.computers[computer].step_clock(seconds * NS_PER_S)
        report = await fleet.make_client().wait_for_job(job_id)
        assert report.state in ("failed", "aborted") and report.reason
        await sleep_ns(fleet.clock, 2 * NS_PER_S)  # fleet time is asked for each second
        assert any("has jumped" in line for line in fleet.lines)
        assert all(rested(fleet, name, fleet.clock.now_ns()) for name in fleet.controllers)
        await require_next_job(fleet)

    run_apart(main)


@pytest.mark.parametrize(
    ("computer", "receives", "sends"),
    [("stage", False, False), ("stage", True, False), ("stage", False, True), ("gantry", False, False)],
)
def test_a_computer_that_is_cut_off_comes_to_rest_and_so_do_the_others(
    computer: str, *, receives: bool, sends: bool
) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        job_id = await begin(fleet, FORTH)
        fleet.net.cut_computer(computer, receives=receives, sends=sends)
        cut_ns = fleet.clock.now_ns()
        # At the declared acceleration each axis brakes in less than 0.5 s from this speed.
        await sleep_ns(fleet.clock, round((COORDINATOR_LOST_S + 0.5 + 0.6) * NS_PER_S))
        assert all(rested(fleet, name, fleet.clock.now_ns()) for name in fleet.controllers), cut_ns
        fleet.net.mend_computer(computer)
        report = await fleet.make_client().wait_for_job(job_id)
        assert report.state in ("failed", "aborted") and report.reason
        await require_next_job(fleet)

    run_apart(main)


def test_fleet_time_goes_on_without_a_jump_over_a_cut() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        fleet.net.cut_computer("stage")
        await sleep_ns(fleet.clock, 60 * NS_PER_S)
        fleet.net.mend_computer("stage")
        await require_next_job(fleet)
        assert not any("has jumped" in line for line in fleet.lines)

    run_apart(main)


def test_fleet_time_goes_on_with_the_next_coordinator() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        fleet.kill("coordinator/first")
        fleet.start_coordinator("second")
        await sleep_ns(fleet.clock, 5 * NS_PER_S)
        await fleet.wait_until(lambda states: all(each.epoch == 2 and each.mode == "idle" for each in states.values()))
        await sleep_ns(fleet.clock, 120 * NS_PER_S)  # without further exchanges the bound would be 12 ms by now
        report = await outcome(fleet, FORTH)
        require_true_evidence(fleet, report)
        assert fleet_time_ns(report, "gantry") < NS_PER_MS

    run_apart(main)
