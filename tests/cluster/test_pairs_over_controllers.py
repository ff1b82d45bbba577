"""Pairs of axes of an SMC-4000 and a CiA 402 drive, by the truth of the simulators: how far they come apart in moves,
jogs, homing and faults, and what is refused."""

import asyncio
import re
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager, suppress
from random import Random
from typing import Any

import pytest
from cluster.worlds import EXAMPLES, changed, job, outcome, run_fleet

from orchestrator.campaign.faults import FAULTS, FaultInjector
from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.pairs import PairMonitor
from orchestrator.coordinator.motion import targets
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.messages import JogRequest, Reply, raise_first_refusal
from orchestrator.model.names import split_name
from orchestrator.plan.forecast.job import forecast_job
from orchestrator.plan.virtual_moves import find_virtual_targets
from orchestrator.runtime.virtual.fleet import VirtualFleet

SAMPLE_NS = 2_000_000
COUNT_MM = 1 / 2000
FAST_MM = 0.5  # no axis here goes so far between two samples: its counter was set
MAX_DEVIATION, MAY_RACK, SQUARE = 0.2, 1.0, 0.05
PREPARE = "{do: enable, axes: [beam]}, {do: home, axes: [beam.y]}, {do: move, to: {beam.y: 0}}"
MOVE = "{do: move, by: {beam.y: 4}, speed: 0.6 mm/s}"


def far_fleet() -> Fleet:
    """The example: its references are a millimetre away."""
    return load_fleet(EXAMPLES / "beam.fleet.yaml")


def beam_fleet() -> Fleet:
    """The same with nearer references, which take less time to find."""
    near = {"gantry": {"index_every": {"X": 400}}, "lift": {"index_every": 400}}
    return changed(far_fleet(), **{name: {"simulate": options} for name, options in near.items()})


class BeamWatch:
    """How far the true ways of both axes have come apart, mm, from when it was made; a counter that is set is no
    way."""

    def __init__(self, fleet: VirtualFleet) -> None:
        self._fleet = fleet
        self._last = self._read()
        self._apart = 0.0
        self.most = 0.0
        self.way = 0.0

    def _read(self) -> list[float]:
        pair = self._fleet.fleet.virtual_axes.pairs["beam"]
        positions: list[float] = []
        for name in pair.real:
            axis = self._fleet.fleet.axis(name)
            positions.append(axis.to_unit(self._fleet.controllers[split_name(name)[0]].position(axis.motors[0])))
        return positions

    def look(self) -> None:
        now = self._read()
        ways = [way if abs(way := here - there) < FAST_MM else 0.0 for here, there in zip(now, self._last, strict=True)]
        self._last = now
        self._apart += ways[0] - ways[1]
        self.way += ways[0]
        self.most = max(self.most, abs(self._apart))


@asynccontextmanager
async def watched(fleet: VirtualFleet) -> AsyncGenerator[BeamWatch]:
    """Watch the beam every 2 ms meanwhile."""
    watch = BeamWatch(fleet)

    async def look() -> None:
        while True:
            watch.look()
            await sleep_ns(fleet.clock, SAMPLE_NS)

    looking = asyncio.get_running_loop().create_task(look())
    try:
        yield watch
    finally:
        looking.cancel()


async def hold(fleet: VirtualFleet, manual: ManualControl, seconds: float) -> None:
    end_ns = fleet.clock.now_ns() + round(seconds * NS_PER_S)
    while fleet.clock.now_ns() < end_ns:
        await asyncio.sleep(0.05)
        await manual.renew_jog()


def is_at_rest(fleet: VirtualFleet) -> bool:
    return not (fleet.controllers["gantry"].is_moving("X") or fleet.controllers["lift"].is_moving("1"))


# Moves, jogs and homing without a fault


def test_both_home_together_and_the_first_move_squares_them() -> None:
    async def main(fleet: VirtualFleet) -> None:
        async with watched(fleet) as watch:
            report = await outcome(fleet, job("[{do: enable, axes: [beam]}, {do: home, axes: [beam.y]}]"))
        assert report.state == "done", report.reason
        assert abs(watch.way + 1) < 0.01 and COUNT_MM < watch.most < MAX_DEVIATION
        client = fleet.make_client()
        assert await client.position("beam.rack") == pytest.approx(-SQUARE, abs=COUNT_MM)
        report = await outcome(fleet, job("[{do: move, to: {beam.y: 1}, speed: 0.7 mm/s}]"))
        assert report.verdict == "green", report.reason
        state = (await client.virtual_states())["beam"]
        assert state.pair is not None and state.pair.known and abs(state.pair.deviation) <= COUNT_MM
        assert await client.position("beam.y") == pytest.approx(1, abs=COUNT_MM)

    run_fleet(main, far_fleet())


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 201))])
def test_moves_and_jogs_keep_the_beam_square(seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        async with watched(fleet) as watch:
            moves = "[{do: move, by: {beam.y: 1}, speed: 0.6 mm/s}, {do: move, to: {beam.y: 0.2}, speed: 0.75 mm/s}]"
            report = await outcome(fleet, job(moves))
        assert report.verdict == "green", report.reason
        assert watch.most <= report.steps[0].virtual["beam.rack"].most + COUNT_MM
        assert MAX_DEVIATION < report.steps[0].pairs["beam"].most < MAY_RACK
        client = fleet.make_client("anna")
        async with watched(fleet) as watch, client.manual_control(["beam.y"]) as manual:
            await manual.jog({"beam.y": 0.7})
            await hold(fleet, manual, 0.6)
            await manual.stop()
            await asyncio.sleep(0.3)
        assert watch.way > 0.4 and watch.most < MAX_DEVIATION / 2 + COUNT_MM

    run_fleet(main, beam_fleet(), seed)


# Faults

# Not among them: firmware that hangs while its motor turns, which only a wired emergency stop ends.
DRIVES = ("power-off", "limit", "link-cut", "link-closed")
HOSTS = ("host-killed", "host-hung", "bus-cut", "coordinator-killed", "coordinator-hung", "estop", "stop")
USUAL = {("power-off", "lift"), ("link-cut", "gantry"), ("host-killed", "lift"), ("estop", "lift")}
CASES = [
    pytest.param(fault, member, seed, marks=() if seed == 1 and (fault, member) in USUAL else pytest.mark.nightly)
    for fault, member in (
        *((fault, member) for fault in DRIVES for member in ("gantry", "lift")),
        *((fault, "lift") for fault in HOSTS),
    )
    for seed in range(1, 15)
]
HOST_OF = {"gantry": "left", "lift": "right"}


def two_hosts() -> Fleet:
    """Each axis with a computer of its own."""
    return changed(beam_fleet(), **{name: {"host": host} for name, host in HOST_OF.items()})


async def break_now(fleet: VirtualFleet, fault: str, member: str, seed: int) -> None:
    await FaultInjector(fleet, fleet.clock, Random(seed)).inject_fault(FAULTS[fault], member)


async def break_move(fleet: VirtualFleet, fault: str, member: str, seed: int) -> tuple[BeamWatch, float]:
    """A fault in a move of the beam: how far it came apart, and what was stated."""
    await outcome(fleet, job(f"[{PREPARE}]"))
    client = fleet.make_client()
    stated = (await client.dry_run(job(f"[{MOVE}]"))).steps[0].pairs["beam"].most
    async with watched(fleet) as watch:
        await client.submit(job(f"[{MOVE}]"))
        await asyncio.sleep(1.5 + Random(seed).random())
        await break_now(fleet, fault, member, seed)
        await asyncio.sleep(2)
    assert watch.way > 0.3
    return watch, stated


@pytest.mark.parametrize(("fault", "member", "seed"), CASES)
def test_a_fault_in_a_move_racks_the_beam_by_less_than_was_stated(fault: str, member: str, seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        watch, stated = await break_move(fleet, fault, member, seed)
        assert watch.most <= stated < MAY_RACK
        assert is_at_rest(fleet)
        assert watch.way < 3

    run_fleet(main, two_hosts(), seed)


async def break_jog(fleet: VirtualFleet, fault: str, member: str, seed: int) -> BeamWatch:
    await outcome(fleet, job(f"[{PREPARE}]"))
    client = fleet.make_client("anna")
    manual = client.manual_control(["beam.y"])
    await manual.acquire()
    async with watched(fleet) as watch:
        with suppress(Refusal):
            await manual.jog({"beam.y": 0.7})
            await hold(fleet, manual, 0.1 + 0.4 * Random(seed).random())
            await break_now(fleet, fault, member, seed)
            await hold(fleet, manual, 1.5)
        await asyncio.sleep(1)
    with suppress(Refusal):
        await manual.release()
    return watch


@pytest.mark.parametrize(("fault", "member", "seed"), CASES)
def test_a_fault_in_a_jog_racks_the_beam_by_no_more_than_it_may_be(fault: str, member: str, seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        watch = await break_jog(fleet, fault, member, seed)
        assert watch.most <= MAY_RACK - MAX_DEVIATION
        assert is_at_rest(fleet)

    run_fleet(main, two_hosts(), seed)


# The watch


def halve(*args: Any) -> Any:
    """A defect sends the lift half of its way."""
    real_targets = find_virtual_targets(*args)
    return real_targets and {**real_targets, "lift.y": real_targets["lift.y"] / 2}


def test_an_axis_that_lags_in_a_move_stops_both_and_fails_the_job(monkeypatch: pytest.MonkeyPatch) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        monkeypatch.setattr(targets, "find_virtual_targets", halve)
        async with watched(fleet) as watch:
            report = await outcome(fleet, job("[{do: move, by: {beam.y: 2}, speed: 0.4 mm/s}]"))
            await asyncio.sleep(0.5)
        monkeypatch.undo()
        assert report.state == "failed"
        assert re.search(r"beam: gantry.y at [\d.]+ mm and lift.y at [\d.]+ mm came 0.2\d* mm apart", report.reason)
        # 0.3 mm/s apart: one reading more, and the stop.
        assert MAX_DEVIATION < watch.most < MAX_DEVIATION + 0.1
        assert is_at_rest(fleet)
        await leave_racked(fleet)

    run_fleet(main, beam_fleet())


async def leave_racked(fleet: VirtualFleet) -> None:
    """A racked beam moves only towards square."""
    client = fleet.make_client("anna")
    state = (await client.virtual_states())["beam"]
    assert (
        state.pair is not None and state.pair.is_racked and "beam is racked: gantry.y and lift.y are" in state.obstacle
    )
    assert [alarm.kind for alarm in await client.list_alarms()] == ["racked"]
    for step, words in (
        ("{do: move, by: {beam.y: 0.1}, speed: 0.5 mm/s}", "tutti axis move beam.rack=0"),
        ("{do: move, to: {beam.rack: 0.5}, speed: 0.5 mm/s}", "moves only towards 0"),
    ):
        assert words in (await outcome(fleet, job(f"[{step}]"))).reason
    async with client.manual_control(["beam"]) as manual:
        with pytest.raises(Refusal, match="racked"):
            await manual.jog({"beam.y": 0.5})
    report = await outcome(fleet, job("[{do: move, to: {beam.rack: 0}, speed: 0.5 mm/s}]"))
    assert report.state == "done", report.reason
    state = (await client.virtual_states())["beam"]
    assert state.obstacle == "" and state.pair is not None and abs(state.pair.deviation) <= COUNT_MM


def test_a_client_that_jogs_one_axis_of_two_is_stopped() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        client = fleet.make_client("anna")
        async with watched(fleet) as watch, client.manual_control(["beam"]) as manual:
            with pytest.raises(Refusal, match=r"axis y is one of the pair beam.*\n?.*"):
                await manual.jog({"gantry.y": 0.5})
            assert watch.way == 0
            with pytest.raises(Refusal):
                for seq in range(100, 140):
                    request = JogRequest(
                        **client.request_fields(),
                        holder=manual.holder,
                        seq=seq,
                        velocities={"y": 0.7},
                        groups=["beam"],
                    )
                    raise_first_refusal(
                        {"gantry": await client.request_controller("gantry", "jog", request, Reply, 1.0)}
                    )
                    await asyncio.sleep(0.05)
            await asyncio.sleep(0.5)
        assert MAX_DEVIATION < watch.most < MAX_DEVIATION + 0.15
        assert is_at_rest(fleet)

    run_fleet(main, beam_fleet())


def test_two_that_search_apart_are_stopped_and_home_again() -> None:
    """The index of the lift is where it stands, that of the gantry a millimetre away."""
    fleet = changed(far_fleet(), lift={"axes": {"y": {"homing": {"method": "37", "speed": 0.5}}}})

    async def main(fleet: VirtualFleet) -> None:
        async with watched(fleet) as watch:
            report = await outcome(fleet, job("[{do: enable, axes: [beam]}, {do: home, axes: [beam.y]}]"))
        assert report.state == "failed" and "since they began to search for their references" in report.reason
        assert "home beam.y again" in report.reason
        assert MAX_DEVIATION < watch.most < MAX_DEVIATION + 0.15
        assert is_at_rest(fleet)

    run_fleet(main, fleet)


# What is refused ahead


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ("{do: move, to: {gantry.y: 1}}", "gantry.y is one of the pair beam, and does not move alone; name beam.y"),
        ("{do: home, axes: [lift]}", "lift.y is one of the pair beam, and is not homed alone; home beam.y"),
        ("{do: set-position, axes: {lift.y: 1}}", "lift.y is one of the pair beam"),
        ("{do: scan, axes: {gantry.y: {from: 0, to: 1, points: 3}}}", "gantry.y is one of the pair beam"),
        (
            "{do: path, axes: [gantry.y, lift.y], start: [0, 0], pieces: [{piece: line, to: [1, 1]}], tolerance: 10 um}",
            "pair beam",
        ),
        ("{do: move, to: {beam.y: 1}, speed: 2 mm/s}", "0.793 mm/s is the highest speed for that"),
        ("{do: move, to: {beam.y: 1, beam.rack: 0.1}, speed: 0.5 mm/s}", "a pair moves square"),
    ],
)
def test_what_would_move_one_axis_alone_or_too_fast_is_refused_by_name(step: str, words: str) -> None:
    prepare = "{do: enable, axes: [beam]}, {do: home}"
    forecast = forecast_job(beam_fleet(), job(f"[{prepare}, {step}]").steps)
    assert words in "; ".join(problem.describe() for problem in forecast.problems)


def test_a_controller_without_a_watchdog_limits_the_way() -> None:
    plain = beam_fleet().to_plain()
    del plain["controllers"]["lift"]["options"]["watchdog_ms"]

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        report = await outcome(fleet, job("[{do: move, by: {beam.y: 2}, speed: 0.1 mm/s}]"))
        assert "watchdog_ms" in report.reason and "by 0.8 mm at most at a time" in report.reason
        assert (await outcome(fleet, job("[{do: move, by: {beam.y: 0.7}, speed: 3 mm/s}]"))).state == "done"

    run_fleet(main, Fleet.model_validate(plain))


# Mutations: without one of its parts the watch is missed by these checks


def test_without_the_watch_an_axis_that_lags_racks_the_beam(monkeypatch: pytest.MonkeyPatch) -> None:
    def ignore_loss(*_: Any) -> None:
        return None

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        monkeypatch.setattr(targets, "find_virtual_targets", halve)
        async with watched(fleet) as watch:
            await outcome(fleet, job("[{do: move, by: {beam.y: 1.5}, speed: 0.4 mm/s}]"))
        assert watch.most > MAX_DEVIATION + 0.1

    monkeypatch.setattr(PairMonitor, "_lose", ignore_loss)
    run_fleet(main, beam_fleet())


def test_without_the_stop_of_the_other_axis_a_fault_racks_the_beam_farther(monkeypatch: pytest.MonkeyPatch) -> None:
    async def stop_none(*_: Any) -> None:
        return None

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job(f"[{PREPARE}]"))
        monkeypatch.setattr(FleetAccess, "stop_members", stop_none)
        async with watched(fleet) as watch:
            await fleet.make_client().submit(job(f"[{MOVE}]"))
            await asyncio.sleep(1.5)
            await break_now(fleet, "power-off", "lift", 1)
            await asyncio.sleep(4)
        assert watch.most > MAY_RACK

    run_fleet(main, two_hosts())


def test_a_scan_of_a_pair_stops_square_at_each_point() -> None:
    async def main(fleet: VirtualFleet) -> None:
        scan = "{do: scan, axes: {beam.y: {from: 0.5, to: 1.5, points: 3}}, speed: 0.6 mm/s}"
        report = await outcome(fleet, job(f"[{PREPARE}, {scan}]"))
        assert report.state == "done", report.reason
        state = (await fleet.make_client().virtual_states())["beam"]
        assert state.axes["y"].position == pytest.approx(1.5, abs=COUNT_MM)
        assert abs(state.axes["rack"].position) <= 2 * COUNT_MM

    run_fleet(main, beam_fleet())
