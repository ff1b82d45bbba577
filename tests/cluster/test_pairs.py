"""An axis of two motors that carry one beam: how far these are apart by truth, in moves, jogs and searches, and after
each single fault."""

import asyncio
from collections.abc import AsyncIterator, Callable, Coroutine
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass, field
from random import Random
from typing import Any

import pytest
from cluster.worlds import EXAMPLES, changed, job, outcome, refusal, run_fleet

from adapters.controller.monitoring.pairs import PairWatch
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.yaskawa.machine.controller import YaskawaController

AXIS = "gantry.y"
FIRST, SECOND = "Y", "Z"
READY = job("[{do: enable, axes: [gantry.y]}, {do: home, axes: [gantry.y]}]")
MOVE = job("[{do: move, to: {gantry.y: 100}}]")
SQUARE_COUNTS = 120 + 50  # from the truth of its switches, and `square`
EDGE_COUNTS = 3  # a search ends on either side of an edge, for each motor
BEGIN_S, MOVES_S = 0.9, 2.2  # after a job is submitted, the axis moves at full speed from here, that long
SAMPLE_NS = 4 * NS_PER_MS


@dataclass
class Beam:
    """The truth of the two motors. square: counts between them when the beam is square."""

    virtual: VirtualFleet
    square: float = 0.0
    deviations: list[float] = field(default_factory=list[float])

    @property
    def unit(self) -> YaskawaController:
        controller = self.virtual.controllers["gantry"]
        assert isinstance(controller, YaskawaController)
        return controller

    @property
    def fleet(self) -> Fleet:
        return self.virtual.fleet

    @property
    def largest_mm(self) -> float:
        """How far the motors have been apart since it was watched."""
        return max(abs(deviation) for deviation in self.deviations) / 1000

    @property
    def is_moving(self) -> bool:
        return self.unit.is_moving(FIRST) or self.unit.is_moving(SECOND)

    def measure(self) -> float:
        return self.unit.physical_position(SECOND) - self.unit.physical_position(FIRST) - self.square

    def take_square(self) -> None:
        """The beam is square as it stands."""
        self.square = 0.0
        self.square = self.measure()

    @asynccontextmanager
    async def watched(self) -> AsyncIterator[None]:
        """Measure all the time."""
        self.deviations = [self.measure()]

        async def watch() -> None:
            while True:
                await sleep_ns(self.virtual.clock, SAMPLE_NS)
                self.deviations.append(self.measure())

        watching = asyncio.get_running_loop().create_task(watch())
        try:
            yield
        finally:
            watching.cancel()

    async def send(self, command: str) -> None:
        """Another client sends a command."""
        link = await self.virtual.wires["gantry"].open_link()
        link.write(command.encode() + b"\r")
        await sleep_ns(self.virtual.clock, 5 * NS_PER_MS)
        await link.close()

    async def stall(self, motor: str) -> None:
        self.virtual.act_on_controller("gantry", lambda unit: unit.set_stalled(motor, stalled=True))


def pair_fleet(**axis: Any) -> Fleet:
    return changed(load_fleet(EXAMPLES / "pair.fleet.yaml"), gantry={"axes": {"y": axis}})


def run_beam(main: Callable[[Beam], Coroutine[Any, Any, None]], fleet: Fleet | None = None, seed: int = 1) -> None:
    """Run `main` with a beam that is referenced and square."""

    async def run(virtual: VirtualFleet) -> None:
        beam = Beam(virtual)
        report = await outcome(virtual, READY)
        assert report.state == "done", report.reason
        beam.take_square()
        await main(beam)

    run_fleet(run, fleet or pair_fleet(), seed)


# Without faults


def test_homing_finds_both_references_and_squares_the_beam() -> None:
    """From both sides of the switches; within `max_deviation` on the way."""

    async def main(virtual: VirtualFleet) -> None:
        beam = Beam(virtual)
        async with beam.watched():
            assert (await outcome(virtual, READY)).state == "done"
        assert beam.largest_mm <= 0.5
        assert abs(beam.measure() - SQUARE_COUNTS) <= EDGE_COUNTS
        for target in (100, 0.2):
            await outcome(virtual, job(f"[{{do: move, to: {{gantry.y: {target}}}}}]"))
            assert (await outcome(virtual, READY)).state == "done"
            assert abs(beam.measure() - SQUARE_COUNTS) <= EDGE_COUNTS, "squared anew"
        state = (await virtual.make_client().status())["gantry"].axes["y"]
        assert state.pair is not None and state.referenced
        assert state.pair.deviation == 0
        assert set(state.pair.motors) == {FIRST, SECOND}

    run_fleet(main, pair_fleet())


def test_a_switch_too_far_away_is_no_reference() -> None:
    fleet = changed(pair_fleet(), gantry={"simulate": {"home_edge": {"Y": -5000, "Z": -4400}}})

    async def main(virtual: VirtualFleet) -> None:
        beam = Beam(virtual)
        async with beam.watched():
            report = await outcome(virtual, READY)
        assert beam.largest_mm <= 0.5
        assert "the home switch of its second motor has not come, and 0.5 mm are allowed" in report.reason
        assert abs(beam.measure()) <= 1, "back to where it stood"
        assert (await refusal(virtual, MOVE)).code == "not-referenced"

    run_fleet(main, fleet)


def test_moves_and_jogs_keep_the_beam_square() -> None:
    async def main(beam: Beam) -> None:
        client = beam.virtual.make_client()
        async with beam.watched():
            steps = ", ".join(f"{{do: move, to: {{gantry.y: {target}}}}}" for target in (20, 5, 5.001, 12))
            report = await outcome(beam.virtual, job(f"[{steps}]"))
            assert report.state == "done", report.reason
            speed = beam.fleet.axis(AXIS).jog_speed(referenced=True)
            async with client.manual_control([AXIS]) as hand:
                for velocity in (speed, -speed / 2):
                    await hand.jog({AXIS: velocity})
                    for _ in range(10):
                        await hand.renew_jog()
                        await asyncio.sleep(0.06)
                await hand.stop()
                await asyncio.sleep(0.2)
        assert not beam.is_moving
        assert beam.largest_mm <= 0.001
        rack = report.steps[0].racks[AXIS]
        assert (rack.watched, rack.speed) == pytest.approx((0.5, 30))
        assert rack.most == pytest.approx(0.5 + 30 * 0.04 + 30**2 / 2000)

    run_beam(main)


@pytest.mark.parametrize("act", ["stop", "estop", "pause"])
def test_a_stop_brakes_both_motors_together(act: str) -> None:
    async def main(beam: Beam) -> None:
        client = beam.virtual.make_client()
        async with beam.watched():
            job_id = await client.submit(MOVE)
            await asyncio.sleep(BEGIN_S + 0.5)
            assert beam.is_moving
            await (
                client.estop("a test")
                if act == "estop"
                else client.stop()
                if act == "stop"
                else client.pause_job(job_id, now=True)
            )
            await asyncio.sleep(0.5)
            assert not beam.is_moving
        assert beam.largest_mm <= 0.001

    run_beam(main)


def test_a_stop_in_a_search_of_the_pair_begins_no_search_of_another_axis() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, unit = virtual.make_client(), virtual.controllers["gantry"]
        await client.start_queue()
        await client.submit(job("[{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}]"))
        async with asyncio.timeout(5):
            while not unit.is_moving(FIRST):
                await sleep_ns(virtual.clock, SAMPLE_NS)
        await client.stop()
        await asyncio.sleep(1.0)
        assert {motion.axis for motion in unit.commanded_motions} == {FIRST, SECOND}

    run_fleet(main, pair_fleet())


# Faults


async def _cut(beam: Beam) -> None:
    beam.virtual.wires["gantry"].cut = True


async def _kill_host(beam: Beam) -> None:
    beam.virtual.kill("host/local")


async def _freeze_host(beam: Beam) -> None:
    beam.virtual.freeze("host/local")


async def _kill_coordinator(beam: Beam) -> None:
    beam.virtual.kill("coordinator/first")


async def _switch_off_first(beam: Beam) -> None:
    motion = beam.unit.machine.motion
    beam.virtual.act_on_controller(
        "gantry", lambda _: motion.switch_off_on_error(motion.axes[FIRST], beam.unit.machine.current_sample())
    )


async def _press_limit(beam: Beam) -> None:
    beam.virtual.act_on_controller("gantry", lambda unit: unit.set_limit(SECOND, "forward"))


FAULTS: dict[str, tuple[Callable[[Beam], Coroutine[Any, Any, None]], str]] = {
    "second blocked": (lambda beam: beam.stall(SECOND), "the motors of axis y are"),
    "first blocked": (lambda beam: beam.stall(FIRST), "the motors of axis y are"),
    "second off": (lambda beam: beam.send(f"MO{SECOND}"), "of axis y"),
    "first off": (_switch_off_first, "axis y"),
    "gearing off": (lambda beam: beam.send(f"GR{SECOND}=0"), "the motors of axis y are"),
    "limit of the second": (_press_limit, "forward limit switch"),
    "link lost": (_cut, ""),
    "host killed": (_kill_host, ""),
    "host frozen": (_freeze_host, ""),
    "coordinator killed": (_kill_coordinator, ""),
}
"""By name: what happens, and words of the job's end."""


def find_bound_mm(fleet: Fleet, speed: float) -> float:
    """What is stated ahead for a speed with full ramps, and a count of rounding."""
    axis = fleet.axis(AXIS)
    assert axis.rack is not None
    return axis.rack.at_speed(speed, axis.limits.acceleration) + 0.001


async def _suffer(beam: Beam, fault: str, draw: Random) -> JobReport | None:
    """A move with a fault on its way; its report, where the coordinator is alive."""
    client, act = beam.virtual.make_client(), FAULTS[fault][0]
    async with beam.watched():
        job_id = await client.submit(MOVE)
        await asyncio.sleep(BEGIN_S + draw.random() * MOVES_S)
        await act(beam)
        await asyncio.sleep(3.0)
        assert not beam.is_moving, "both motors are at rest"
    if fault == "coordinator killed":
        return None
    with suppress(Refusal):
        return (await client.show_job(job_id)).report
    return None


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 21))])
def test_after_a_fault_in_a_move_the_motors_are_apart_as_was_stated(fault: str, seed: int) -> None:
    async def main(beam: Beam) -> None:
        report = await _suffer(beam, fault, Random(seed))
        assert beam.largest_mm <= find_bound_mm(beam.fleet, 30.0)
        if report is not None and FAULTS[fault][1]:
            assert FAULTS[fault][1] in report.reason
            assert report.state == "failed"

    run_beam(main, seed=seed)


@pytest.mark.parametrize("fault", ["second blocked", "second off", "gearing off", "limit of the second", "link lost"])
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 21))])
def test_after_a_fault_in_a_jog_the_motors_are_apart_as_was_stated(fault: str, seed: int) -> None:
    async def main(beam: Beam) -> None:
        draw, speed = Random(seed), beam.fleet.axis(AXIS).jog_speed(referenced=True)
        async with beam.watched():
            with suppress(Refusal):
                async with beam.virtual.make_client().manual_control([AXIS]) as hand:
                    await hand.jog({AXIS: speed})
                    await asyncio.sleep(0.1 + 0.05 * draw.random())
                    await FAULTS[fault][0](beam)
                    for _ in range(20):
                        await asyncio.sleep(0.06)
                        await hand.renew_jog()
            await asyncio.sleep(1.0)
            # Without its link a jog goes on to its soft limit, both motors together.
            assert fault == "link lost" or not beam.is_moving
        assert beam.largest_mm <= find_bound_mm(beam.fleet, speed)

    run_beam(main, seed=seed)


@pytest.mark.parametrize("fault", ["second blocked", "first blocked", "gearing off"])
def test_after_a_fault_in_a_search_the_motors_are_apart_as_was_stated(fault: str) -> None:
    """While the axis goes to its switch, and while the second motor goes to its own."""

    async def main(beam: Beam) -> None:
        client = beam.virtual.make_client()
        await outcome(beam.virtual, job("[{do: move, to: {gantry.y: 10}}]"))
        async with beam.watched():
            await client.submit(READY)
            await asyncio.sleep(0.7)
            assert beam.is_moving
            await FAULTS[fault][0](beam)
            await asyncio.sleep(1.5)
            assert not beam.is_moving
        assert beam.largest_mm <= find_bound_mm(beam.fleet, 10.0)

    run_beam(main)


def test_without_the_watch_a_blocked_motor_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The mutation: what the watch prevents."""
    monkeypatch.setattr(PairWatch, "find_deviations", lambda *_: [])

    async def main(beam: Beam) -> None:
        await _suffer(beam, "second blocked", Random(1))
        assert beam.largest_mm > find_bound_mm(beam.fleet, 30.0)

    run_beam(main)


# Refusals, and the way back


def test_a_speed_that_may_rack_too_far_is_refused_with_one_that_fits() -> None:
    async def main(beam: Beam) -> None:
        refused = await refusal(beam.virtual, job("[{do: move, to: {gantry.y: 100}, speed: 40 mm/s}]"))
        assert refused.code == "may-rack"
        assert (
            "at 40 mm/s the motors of axis gantry.y may be 2.9 mm apart after a fault; its `may_rack` is 2"
            in refused.text
        )
        assert "27.7 mm/s or less" in refused.remedy
        fits = await outcome(beam.virtual, job("[{do: move, to: {gantry.y: 100}, speed: 27.7 mm/s}]"))
        assert fits.state == "done"
        assert fits.steps[0].racks[AXIS].most <= 2
        client = beam.virtual.make_client()
        async with client.manual_control([AXIS]) as hand:
            with pytest.raises(Refusal, match="may jog at"):
                await hand.jog({AXIS: -30})

    run_beam(main, pair_fleet(limits={"velocity": 60, "acceleration": 1000}, may_rack=2, jog={"speed": 60}))


def test_paths_and_probes_with_the_axis_are_refused_by_name() -> None:
    line = "{piece: line, to: [20, 20]}"
    path = f"{{do: path, axes: [gantry.x, gantry.y], start: [0, 0], speed: 5 mm/s, tolerance: 1 mm, pieces: [{line}]}}"

    async def main(beam: Beam) -> None:
        await outcome(beam.virtual, job("[{do: enable, axes: [gantry]}, {do: home, axes: [gantry.x]}]"))
        refused = await refusal(beam.virtual, job(f"[{path}]"))
        assert (refused.code, "axis gantry.y has two motors" in refused.text) == ("two-motors", True)

    run_beam(main)


def test_a_gearing_that_another_client_has_switched_off_is_a_changed_setting() -> None:
    async def main(beam: Beam) -> None:
        await beam.send(f"GR{SECOND}=0")
        client = beam.virtual.make_client()
        states = await beam.virtual.wait_until(lambda states: bool(states["gantry"].faults))
        assert states["gantry"].faults[0].text == "GRZ of axis y is 0, expected 1: another client has changed it"
        await client.reset()
        await beam.virtual.wait_until(lambda states: states["gantry"].mode == "idle")
        async with beam.watched():
            assert (await outcome(beam.virtual, MOVE)).state == "done"
        assert beam.largest_mm <= 0.001

    run_beam(main)


def test_a_beam_that_is_skewed_keeps_its_fault_until_it_is_square_again() -> None:
    async def main(beam: Beam) -> None:
        client: Tutti = beam.virtual.make_client()
        await beam.send(f"MO{SECOND}")
        beam.virtual.act_on_controller("gantry", lambda unit: unit.push_axis(SECOND, 700))
        states = await beam.virtual.wait_until(lambda states: bool(states["gantry"].faults))
        fault = states["gantry"].faults[0]
        assert (fault.code, fault.axis) == ("deviation", "y")
        assert "are 0.7 mm apart, and 0.5 are allowed: motor Y is at 0, Z at 0.7 mm" in fault.text
        pair = states["gantry"].axes["y"].pair
        assert pair is not None and pair.deviation == pytest.approx(0.7)
        beam.virtual.act_on_controller("gantry", lambda unit: unit.push_axis(SECOND, -650))
        await beam.virtual.wait_until(lambda states: not states["gantry"].faults)
        await sleep_ns(beam.virtual.clock, NS_PER_S)
        await client.start_queue()
        assert (await outcome(beam.virtual, READY)).state == "done"
        assert abs(beam.measure()) <= EDGE_COUNTS

    run_beam(main)
