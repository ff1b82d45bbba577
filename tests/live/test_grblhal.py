"""The adapter against grblHAL itself, run on a PC: a firmware that is no part of Tutti.

TUTTI_GRBLHAL_PORT=host:port is where its simulator listens (https://github.com/grblHAL/Simulator: `grblHAL_sim -p PORT`,
with $10=3, $22=0); without it these tests are skipped. The doubles of the suite, `sim/ascii/grbl_family.py` and
`tests/contract/vectors/grblhal.vectors.jsonl`, are of transcripts of the same firmware. That simulator sets and clears
flags of its two threads without a lock, and so loses a status, hold or start now and then: a status is asked again.
"""

import asyncio
import os
from collections.abc import Awaitable, Callable

import pytest
from children import LIMIT_S

from adapters.abilities import ManualDriver
from adapters.contract import Driver, DriverSetup, JogMove
from adapters.host.makes import find_make
from adapters.link.open import make_link_opener
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.live import LiveClock
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.plan.step import AxisMove, plan_step

PORT = os.environ.get("TUTTI_GRBLHAL_PORT", "")
pytestmark = [pytest.mark.live, pytest.mark.skipif(not PORT, reason="TUTTI_GRBLHAL_PORT names no grblHAL")]
LATE_NS = 50 * NS_PER_MS  # the loop writes the start, not a process with real-time priority


class Bench:
    """A driver of the axis x of that grblHAL."""

    def __init__(self, description: str) -> None:
        host, _, port = PORT.partition(":")
        axis = {
            "motors": ["X"],
            "unit": "mm",
            "scale": 250,
            "soft_limits": {"min": -180, "max": 0},
            "limits": {"velocity": 8, "acceleration": 10},
            "homing": {"direction": "positive"},
        }
        self.config = Controller.model_validate(
            {
                "adapter": "ascii",
                "link": {"kind": "tcp", "host": host, "port": int(port)},
                "options": {"description": description},
                "axes": {"x": axis},
            }
        )
        self.clock, make = LiveClock(), find_make("ascii")
        setup = DriverSetup(
            controller="c",
            config=self.config,
            options=make.options_model.model_validate(self.config.options),
            clock=self.clock,
            open_link=make_link_opener(self.config.link, self.clock),
            timed_writer=LoopTimedWriter(self.clock),
        )
        self.driver: Driver = make.create_driver(setup)

    async def read_counts(self) -> int:
        return (await self.driver.poll()).axes["x"].commanded_counts

    async def load(self, distance: int) -> None:
        """Load a move by `distance` counts, two seconds ahead."""
        start = await self.read_counts()
        move = AxisMove("x", start, start + distance, 2000.0, 2500.0, order=2)
        lowered = self.driver.lower_profiles(plan_step([move]).profiles, StartOptions(), None)
        t0_ns = self.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + 2 * NS_PER_S
        await self.driver.slots.present.load(lowered, t0_ns, None)

    async def start(self) -> None:
        await self.driver.slots.present.verify()
        await self.driver.slots.present.release(LATE_NS)
        await self.driver.slots.present.wait_for_start()


def run(test: Callable[[Bench], Awaitable[None]], description: str = "grblhal") -> None:
    async def limited() -> None:
        async with asyncio.timeout(LIMIT_S):
            bench = Bench(description)
            try:
                await test(bench)
            finally:
                await bench.driver.close()

    asyncio.run(limited())


async def make_ready(bench: Bench) -> None:
    await bench.driver.connect()
    await bench.driver.set_enabled(["x"], on=True)
    assert not (await bench.driver.poll()).restarted


def test_a_move_ends_at_its_target_and_is_no_restart() -> None:
    async def test(bench: Bench) -> None:
        await make_ready(bench)
        origin = await bench.read_counts()
        for sign in (-1, 1):
            await bench.load(sign * 500)
            await bench.start()
            assert (await bench.driver.slots.present.wait_for_end()).state == "done"
            reading = await bench.driver.poll()
            assert not reading.restarted
        assert await bench.read_counts() == origin

    run(test)


def test_a_stop_brakes_by_the_ramp_and_keeps_the_position() -> None:
    async def test(bench: Bench) -> None:
        await make_ready(bench)
        origin = await bench.read_counts()
        await bench.load(-5000)
        await bench.start()
        await asyncio.sleep(0.5)
        await bench.driver.stop(abort=False)
        assert (await bench.driver.slots.present.wait_for_end()).state == "stopped"
        reading = await bench.driver.poll()
        assert origin - 5000 < reading.axes["x"].commanded_counts < origin
        assert not reading.restarted
        assert not reading.axes["x"].position_lost

    run(test)


def test_a_loaded_move_is_withdrawn_by_a_lost_connection_and_the_next_one_comes_at_once() -> None:
    async def test(bench: Bench) -> None:
        await make_ready(bench)
        origin = await bench.read_counts()
        await bench.load(-500)
        await bench.driver.close()
        began_ns = bench.clock.now_ns()
        await bench.driver.connect()
        assert bench.clock.now_ns() - began_ns < 3 * NS_PER_S
        reading = await bench.driver.poll()
        assert reading.axes["x"].commanded_counts == origin
        assert not reading.restarted

    run(test)


def test_a_jog_is_stopped_by_its_end() -> None:
    async def test(bench: Bench) -> None:
        await make_ready(bench)
        driver = bench.driver
        assert isinstance(driver, ManualDriver)
        origin = await bench.read_counts()
        await driver.jog_axis(
            "x", JogMove(-1000.0, 2500.0, origin - 20_000)
        )  # at half of it, 0x85 leaves that firmware in Jog
        await asyncio.sleep(0.5)
        await driver.stop_axes(["x"])
        await asyncio.sleep(1.0)
        counts = await bench.read_counts()
        assert origin - 2000 < counts < origin
        assert counts == await bench.read_counts()

    run(test)


def test_the_description_of_grbl_is_refused() -> None:
    async def test(bench: Bench) -> None:
        with pytest.raises(ControllerFault, match="it is grblHAL, and not GRBL"):
            await bench.driver.connect()

    run(test, "grbl")
