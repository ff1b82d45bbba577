"""Probes by the resident program of an SMC-4000: contacts at any instant, and programs that are halted; judged by the
simulator's truth."""

import asyncio
from random import Random

import pytest
from unit.adapters.test_smc4000_bench import World, run

from adapters.contract import ProbedContact, ProbeMove
from adapters.yaskawa.common import program
from adapters.yaskawa.smc4000.driver import SMC4000Driver
from adapters.yaskawa.triggers import program_probe
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import DigitalInput

NUMBER, SPEED, RAMP = 5, 4000.0, 400_000.0  # counts
TOUCH = DigitalInput(number=NUMBER, active="low")


def find_stated(world: World) -> float:
    assert isinstance(world.driver, SMC4000Driver)
    way = world.driver.probe_ability.find_way("x", NUMBER, "active")
    assert way is not None
    return way.find_overtravel(SPEED, RAMP)


def begin_probe(world: World, end: int) -> asyncio.Future[ProbedContact | None]:
    assert isinstance(world.driver, SMC4000Driver)
    return asyncio.ensure_future(world.driver.probe_axis("x", ProbeMove(end, SPEED, RAMP, point=TOUCH, active=True)))


async def touch(world: World, after_ns: int) -> tuple[float, int]:
    """Make the contact after a time; where the axis is then, and when that is."""
    await sleep_ns(world.clock, after_ns)
    world.controller.set_input(NUMBER, level=False)
    return world.controller.physical_position("X"), world.clock.now_ns()


@pytest.mark.parametrize("seed", range(4))
def test_a_contact_at_any_instant_stops_the_axis_within_what_was_stated(seed: int) -> None:
    draw, kinds = Random(seed), set[str]()

    async def main(world: World) -> None:
        await world.ready()
        # Around the begin at first, then anywhere.
        for number in range(24):
            start = world.controller.physical_position("X")
            probe = begin_probe(world, round(world.controller.position("X")) + 2000)
            after_ms = 2.0 * number if number < 16 else draw.uniform(40.0, 450.0)
            touched, touched_ns = await touch(world, round(after_ms * NS_PER_MS))
            try:
                contact = await probe
            except Refusal as refusal:
                assert refusal.code == "line-level"
                assert world.controller.physical_position("X") == start
                kinds.add("refused")
            else:
                assert contact is not None
                shift = world.controller.physical_position("X") - world.controller.position("X")
                assert contact.least + shift <= touched <= contact.most + shift
                assert contact.span.earliest_ns <= touched_ns <= contact.span.latest_ns
                assert contact.span.latest_ns - contact.span.earliest_ns < 60 * NS_PER_MS
                kinds.add("at rest" if touched == start else "moving")
            assert not world.controller.is_moving("X")
            assert 0 <= world.controller.physical_position("X") - touched <= find_stated(world)
            world.controller.set_input(NUMBER, level=True)
            await sleep_ns(world.clock, 10 * NS_PER_MS)

    run(main, seed=seed)
    assert {"refused", "moving"} <= kinds


def test_a_bound_that_is_too_small_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutation: it is stated that the program stops the axis at the edge."""
    monkeypatch.setattr(program_probe, "find_read_us", lambda *_: 0.0)
    with pytest.raises(AssertionError):
        test_a_contact_at_any_instant_stops_the_axis_within_what_was_stated(0)


async def expect_broken(world: World, probe: asyncio.Future[ProbedContact | None], words: str) -> None:
    with pytest.raises(Refusal, match=words) as raised:
        await probe
    assert raised.value.code == "probe-broken"
    await sleep_ns(world.clock, 100 * NS_PER_MS)
    assert not world.controller.is_moving("X")


@pytest.mark.parametrize(
    ("command", "words"),
    [("HX0", "the program that watches the input of axis x has ended"), ("STX", "came to rest, and the program")],
)
def test_another_client_that_halts_the_program_or_the_axis_ends_the_probe(command: str, words: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        probe = begin_probe(world, 2000)
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        await world.talk(command)
        await expect_broken(world, probe, words)
        assert world.controller.position("X") < 1500

    run(main)


def test_a_program_that_does_not_stop_the_axis_is_noticed() -> None:
    async def main(world: World) -> None:
        await world.ready()
        probe = begin_probe(world, 2000)
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        # The thread of another program in its place.
        await world.talk("HX0;XQ #RPULSE,0")
        world.controller.set_input(NUMBER, level=False)
        await expect_broken(world, probe, "has not stopped axis x")

    run(main)


@pytest.mark.parametrize("after_ms", [5, 20, 200])
def test_a_probe_that_is_cancelled_stops_the_axis(after_ms: int) -> None:
    async def main(world: World) -> None:
        await world.ready()
        probe = begin_probe(world, 4000)
        await sleep_ns(world.clock, after_ms * NS_PER_MS)
        probe.cancel()
        with pytest.raises(asyncio.CancelledError):
            await probe
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert not world.controller.is_moving("X") and world.controller.position("X") < 1500

    run(main)


def test_a_new_connection_stops_a_probe_whose_program_it_halts() -> None:
    async def main(world: World) -> None:
        await world.ready()
        probe = begin_probe(world, 40_000)
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        world.wire.cut = True
        with pytest.raises((LinkClosed, ControllerFault)):
            await probe
        assert world.controller.is_moving("X")
        world.wire.cut = False
        await sleep_ns(world.clock, NS_PER_S)
        await world.other().connect()
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert not world.controller.is_moving("X")

    run(main)


def test_without_the_host_the_program_stops_the_axis() -> None:
    async def main(world: World) -> None:
        await world.ready()
        probe = begin_probe(world, 40_000)
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        world.wire.cut = True
        touched, _ = await touch(world, 300 * NS_PER_MS)
        with pytest.raises((LinkClosed, ControllerFault)):
            await probe
        await sleep_ns(world.clock, 100 * NS_PER_MS)
        assert not world.controller.is_moving("X")
        assert world.controller.physical_position("X") - touched <= find_stated(world)

    run(main)


@pytest.mark.parametrize("by", ["the program", "a new connection"])
def test_a_line_is_stopped_along_it_without_its_host(by: str) -> None:
    async def main(world: World) -> None:
        await world.ready()
        assert isinstance(world.driver, SMC4000Driver)
        unit, ways = world.controller, {"x": 30_000, "y": -40_000}
        starts = {axis: unit.position(axis.upper()) for axis in ways}
        moves = {
            axis: ProbeMove(round(starts[axis]) + way, abs(way) / 10, abs(way), point=TOUCH, active=True)
            for axis, way in ways.items()
        }
        probe = asyncio.ensure_future(world.driver.probe_line(moves))
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        world.wire.cut = True
        if by == "the program":
            await touch(world, 300 * NS_PER_MS)
        with pytest.raises((LinkClosed, ControllerFault)):
            await probe
        world.wire.cut = False
        if by == "a new connection":
            assert unit.is_moving("X") and unit.is_moving("Y")
            await sleep_ns(world.clock, NS_PER_S)
            await world.other().connect()
        await sleep_ns(world.clock, 200 * NS_PER_MS)
        assert not unit.is_moving("X") and not unit.is_moving("Y")
        gone = {axis: unit.position(axis.upper()) - start for axis, start in starts.items()}
        assert 0 < gone["x"] < 15_000 and abs(gone["y"] + gone["x"] * 4 / 3) <= 2

    run(main)


def test_a_line_that_its_program_does_not_stop_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutation: the program does not stop the sequence of the line."""
    probe_lines = program.probe_lines
    monkeypatch.setattr(
        program, "probe_lines", lambda axes: tuple(line.replace("STS;", "") for line in probe_lines(axes))
    )
    with pytest.raises(AssertionError):
        test_a_line_is_stopped_along_it_without_its_host("the program")
