"""Several SMC-2000 on one daisy chain: each request gets its own answer, and a fault of one does not affect the
others."""

import asyncio
from collections.abc import Awaitable, Callable
from random import Random
from typing import Any

import pytest
from unit.adapters.test_smc2000_bench import FLEET, ChainWorld, run_chain, trapezoid
from unit.random_rounds import share_with_nightly

from adapters.contract import Driver, JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Fleet, group_by_link
from orchestrator.model.jobs.files import FileError
from orchestrator.model.messages import StartOptions


@pytest.mark.parametrize("first", share_with_nightly(range(0, 40, 4), 1))
def test_replies_are_not_mixed_under_any_overlap(first: int):
    """Each controller stands at a position of its own and stores a number of its own; all are queried at random."""

    async def main(world: ChainWorld) -> None:
        await world.ready(2)
        draw = Random(world.wire.seed)
        for address, driver in world.drivers.items():
            await driver.send_raw(f"DPX={1000 + address}")
            await driver.send_raw(f"XMINE={7000 + address}")

        async def busy(address: int, driver: Driver) -> None:
            for _ in range(40):
                await sleep_ns(world.clock, draw.randrange(40 * NS_PER_MS))
                kind = draw.randrange(6)
                if kind < 3:
                    reading = await driver.poll()
                    assert reading.axes["x"].commanded_counts == 1000 + address
                elif kind == 3:
                    assert float(await driver.send_raw("MG XMINE")) == 7000 + address
                elif kind == 4:
                    await driver.set_output(1, on=draw.random() < 0.5)
                else:
                    await driver.stop_axes(["x"])

        await asyncio.gather(*(busy(*each) for each in world.drivers.items() for _ in range(2)))
        for address, unit in world.units.items():
            assert unit.position("X") == 1000 + address

    for seed in range(first, first + 4):
        run_chain(main, seed=seed, hold_ms=(0, 16)[seed % 2])


def test_an_address_that_is_garbled_on_the_way_is_found_before_the_command_reaches_another_controller():
    async def main(world: ChainWorld) -> None:
        await world.ready(2)
        for address, driver in world.drivers.items():
            await driver.send_raw(f"XMINE={7000 + address}")
        garbled = 0

        def garble(data: bytes) -> bytes:
            nonlocal garbled
            if b"%1\r" not in data or garbled:
                return data
            garbled += 1
            return data.replace(b"%1\r", b"%2\r")

        world.wire.to_far = garble
        assert float(await world.drivers[1].send_raw("MG XMINE")) == 7001 and garbled

    run_chain(main)


@pytest.mark.parametrize(("seed", "hold_ms"), [(0, 0), (4, 0), (4, 16), (5, 16)])
def test_an_error_report_of_a_program_is_not_taken_for_an_answer(seed: int, hold_ms: int):
    """A program that reaches a limit switch at T0 prints its line, and the next controller is polled meanwhile. In
    some of these runs it comes in the middle of the line that the poll waits for."""

    async def main(world: ChainWorld) -> None:
        await world.ready(3)
        draw = Random(world.wire.seed)
        reports = 0

        async def fail() -> None:
            nonlocal reports
            for _ in range(80):
                await sleep_ns(world.clock, draw.randrange(100 * NS_PER_MS))
                unit = world.units[draw.randrange(3)]
                reports += unit.machine.selected is True
                unit.machine.ports.send_message("?005 WT XT0-TIME;BGX;XACT=TIME;JP#DONE\r\n")

        task = asyncio.get_running_loop().create_task(fail())
        while not task.done():
            for driver in world.drivers.values():
                await driver.poll()
        await task
        assert reports > 10

    run_chain(main, seed=seed, hold_ms=hold_ms)


@pytest.mark.parametrize("reading", ["optional", "separate", "required"])
def test_the_revision_of_each_controller_is_read_whatever_ends_the_query(reading: str):
    async def main(world: ChainWorld) -> None:
        found = [await driver.connect() for driver in world.drivers.values()]
        assert {each.firmware for each in found} == {"Rev 2.0g"}
        await world.ready(3)

    run_chain(main, options={"control_end": reading})


@pytest.mark.parametrize("asked", ["poll", "command", "meet"])
def test_a_silent_controller_delays_others_by_no_more_than_its_own_timeout(asked: str):
    async def main(world: ChainWorld) -> None:
        await world.ready(5)
        world.units[2].set_power(on=False)
        driver = world.drivers[2]
        asking: dict[str, Callable[[], Awaitable[object]]] = {
            "poll": driver.poll,
            "command": lambda: driver.send_raw("MG TIME"),
            "meet": driver.connect,
        }

        async def knock() -> None:
            for _ in range(20):
                with pytest.raises((ControllerFault, LinkClosed)):
                    await asking[asked]()
                await sleep_ns(world.clock, 20 * NS_PER_MS)

        task = asyncio.get_running_loop().create_task(knock())
        took_ns: list[int] = []
        while not task.done():
            for address in (0, 1):
                began_ns = world.clock.now_ns()
                await world.drivers[address].poll()
                took_ns.append(world.clock.now_ns() - began_ns)
        await task
        # Silence, twice where the first try may have been disturbed, and the polls of the other two.
        assert max(took_ns) < 450 * NS_PER_MS
        # It counts as missing then, and is tried once.
        assert max(took_ns[3:]) < 300 * NS_PER_MS

    run_chain(main)


def test_waiting_requests_go_before_those_to_a_missing_controller():
    """Regardless of the number of requests: its member, which would reconnect it, and an operator."""

    async def main(world: ChainWorld) -> None:
        await world.ready(5)
        world.units[2].set_power(on=False)
        for _ in range(2):
            with pytest.raises(ControllerFault):
                await world.drivers[2].send_raw("MG TIME")

        async def knock() -> None:
            for _ in range(8):
                with pytest.raises(ControllerFault):
                    await world.drivers[2].send_raw("MG TIME")

        tasks = [asyncio.get_running_loop().create_task(knock()) for _ in range(3)]
        took_ns: list[int] = []
        while not all(task.done() for task in tasks):
            await sleep_ns(world.clock, 20 * NS_PER_MS)
            began_ns = world.clock.now_ns()
            await world.drivers[0].poll()
            took_ns.append(world.clock.now_ns() - began_ns)
        await asyncio.gather(*tasks)
        assert len(took_ns) > 15 and max(took_ns) < 200 * NS_PER_MS

    run_chain(main)


@pytest.mark.parametrize("hold_ms", [0, 16])
def test_a_power_cycle_of_one_controller_of_three_affects_only_that_one(hold_ms: int):
    async def main(world: ChainWorld) -> None:
        await world.ready(5)
        world.units[1].set_power(on=False)
        await sleep_ns(world.clock, NS_PER_S)
        world.units[1].set_power(on=True)
        for address in (0, 2):
            for _ in range(3):
                assert not (await world.drivers[address].poll()).restarted
        with pytest.raises((ControllerFault, LinkClosed)):
            for _ in range(3):
                await world.drivers[1].poll()
        await world.drivers[1].close()
        meeting = asyncio.get_running_loop().create_task(world.drivers[1].connect())
        longest_ns = 0
        while not meeting.done():
            for address in (0, 2):
                began_ns = world.clock.now_ns()
                assert not (await world.drivers[address].poll()).restarted
                longest_ns = max(longest_ns, world.clock.now_ns() - began_ns)
        await meeting
        assert (await world.drivers[1].poll()).restarted
        # Its program is loaded and read back in parts: a moving controller counts as dead after 700 ms.
        assert longest_ns < 300 * NS_PER_MS

    run_chain(main, hold_ms=hold_ms)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("seed", share_with_nightly(range(10), 4))
def test_a_stop_overtakes_everything_and_reaches_only_its_controller_within_milliseconds(abort: bool, seed: int):
    async def main(world: ChainWorld) -> None:
        await world.ready(5)
        for driver in world.drivers.values():
            await driver.jog_axis("x", JogMove(10_000, 1_000_000, None))
        draw = Random(seed)
        polling = [asyncio.get_running_loop().create_task(_poll_on(driver)) for driver in world.drivers.values()]
        await sleep_ns(world.clock, NS_PER_S + draw.randrange(100 * NS_PER_MS))
        stopped = draw.choice(list(world.drivers))
        at_ns = world.clock.now_ns()
        await world.drivers[stopped].stop(abort=abort)
        assert world.clock.now_ns() == at_ns
        await sleep_ns(world.clock, NS_PER_S)
        for address, unit in world.units.items():
            if address == stopped:
                end_ns = unit.commanded_motions[-1].end_ns
                assert end_ns is not None and end_ns - at_ns < 35 * NS_PER_MS
            else:
                assert unit.velocity("X") == pytest.approx(10_000, rel=0.01)
        assert not any(task.done() for task in polling)
        for task in polling:
            task.cancel()

    run_chain(main, seed=seed, hold_ms=16 * (seed % 2))


async def _poll_on(driver: Driver) -> None:
    while True:
        await driver.poll()


def test_a_controller_is_disarmed_while_the_others_start():
    async def main(world: ChainWorld) -> None:
        await world.ready(20)
        lowered: dict[int, Any] = {}
        mappings = {address: driver.clock_mapping() for address, driver in world.drivers.items()}
        t0_ns = world.clock.now_ns() + 2 * NS_PER_S
        for address, driver in world.drivers.items():
            lowered[address] = driver.lower_profiles(
                {"x": trapezoid(0, 5000, 20_000, 200_000)}, StartOptions(), mappings[address]
            )
        await asyncio.gather(*(world.drivers[a].slots.present.load(lowered[a], t0_ns, mappings[a]) for a in lowered))
        await world.drivers[1].slots.unload()
        with pytest.raises(Refusal):
            await world.drivers[1].slots.present.release()
        await asyncio.gather(*(world.drivers[a].slots.present.release() for a in (0, 2)))
        outcomes = []
        for address in (0, 2):
            started = await world.drivers[address].slots.present.wait_for_start()
            motion = world.units[address].commanded_motions[-1]
            assert started["x"].earliest_ns <= motion.start_ns <= started["x"].latest_ns
            outcomes.append(await world.drivers[address].slots.present.wait_for_end())
        assert [outcome.state for outcome in outcomes] == ["done", "done"]
        assert not world.units[1].commanded_motions

    run_chain(main)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({}, "both have address 0"),
        ({"link": {"address": None}}, "has an address there, and b has none"),
        ({"link": {"address": 1, "baud": 9600}}, "different settings"),
        ({"link": {"address": 1}, "adapter": "shrc203"}, "different `adapter`"),
    ],
)
def test_a_fleet_reports_why_controllers_cannot_share_a_port(changes: dict[str, Any], words: str):
    one = FLEET | {"link": FLEET["link"] | {"address": 0}}
    other = one | changes | {"link": one["link"] | changes.get("link", {})}
    with pytest.raises((ValueError, FileError), match=words):
        Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "f", "controllers": {"a": one, "b": other}})


def test_each_computer_has_ports_of_its_own():
    one = FLEET | {"link": FLEET["link"] | {"address": None}, "host": "left"}
    fleet = Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "f", "controllers": {"a": one, "b": one | {"host": "right"}}}
    )
    assert group_by_link(fleet.controllers) == [["a"], ["b"]]
