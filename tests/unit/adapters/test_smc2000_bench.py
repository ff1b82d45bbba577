"""Simulated SMC-2000 on a wire in virtual time with drivers before them, as the other tests of the driver use it."""

import asyncio
from collections.abc import Callable, Coroutine
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

from unit.adapters.test_smc4000_bench import trapezoid

from adapters.contract import Driver, DriverSetup
from adapters.toolkit.firing import LoopTimedWriter
from adapters.yaskawa.smc2000.driver import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from sim.core.controller import DeviceSpec, FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.yaskawa import SMC2000

__all__ = ["FLEET", "ChainWorld", "World", "run", "run_chain", "trapezoid"]

LIMITS = {"velocity": 100.0, "acceleration": 1000.0}
FLEET: dict[str, Any] = {
    "adapter": "smc2000",
    "link": {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200},
    "axes": {
        "x": {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": LIMITS},
        "y": {"motors": ["Y"], "unit": "mm", "scale": 1000, "limits": LIMITS},
    },
}
TIMING = FirmwareTiming(decode_ns=500_000, spread_ns=50_000)


@dataclass
class World:
    clock: Clock
    controller: SimulatedController
    wire: MemoryWire
    driver: Driver
    other: Callable[[], Any]

    async def talk(self, line: str, quiet_ms: int = 60) -> str:
        """The commands of another user at a terminal of his own, and the answers until it is quiet."""
        link = await self.wire.open_link()
        reply = await typed(self.clock, link, line + "\r", quiet_ms)
        await link.close()
        await sleep_ns(self.clock, NS_PER_MS)
        return reply

    async def ready(self, polls: int = 30, connect: bool = True) -> None:
        if connect:
            await self.driver.connect()
        await self.driver.configure()
        await self.driver.set_enabled(["x", "y"], on=True)
        for _ in range(polls):
            await self.driver.poll()
            await sleep_ns(self.clock, 100 * NS_PER_MS)

    async def moved(self, profiles: dict[str, Profile], lead_s: float = 0.8) -> tuple[Any, Any, Any, int]:
        """One step, from lowering to its outcome."""
        driver, mapping = self.driver, self.driver.clock_mapping()
        assert mapping is not None
        t0_ns = self.clock.now_ns() + round(lead_s * NS_PER_S)
        lowered = driver.lower_profiles(profiles, StartOptions(lead_ns=t0_ns - mapping.host_at_ns), mapping)
        await driver.slots.present.load(lowered, t0_ns, mapping)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        started = await driver.slots.present.wait_for_start()
        outcome = await driver.slots.present.wait_for_end()
        return lowered, started, outcome, t0_ns


async def typed(clock: Clock, link: Any, text: str, quiet_ms: int = 60) -> str:
    """Write to a link, and read until nothing more arrives."""
    link.write(text.encode("latin-1"))
    reply = b""
    try:
        while True:
            async with asyncio.timeout(quiet_ms / 1000):
                reply += (await link.read()).data
    except TimeoutError:
        return reply.decode("latin-1")


def run(
    main: Callable[[World], Coroutine[Any, Any, Any]],
    *,
    seed: int = 1,
    fleet: dict[str, Any] | None = None,
    options: dict[str, Any] | None = None,
    ppm: float = 40.0,
    hold_ms: int = 0,
) -> Any:
    async def within(clock: VirtualClock) -> Any:
        config = Controller.model_validate(fleet or FLEET)
        MAKE.check_config(config)
        oscillator = Oscillator(Random(seed).randrange(10**9), ppm, 0.05, seed)
        controller = SMC2000.build_controller(clock, options or {}, oscillator=oscillator, timing=TIMING, seed=seed)
        model = serial_wire(19200, hold_ns=hold_ms * NS_PER_MS)
        wire = MemoryWire(clock, model, controller, "serial", "serial /dev/ttyS0", copy_context(), seed)

        def driver() -> Driver:
            chosen = MAKE.options_model.model_validate(config.options)
            return MAKE.create_driver(DriverSetup("c", config, chosen, clock, wire.open_link, LoopTimedWriter(clock)))

        return await main(World(clock, controller, wire, driver(), driver))

    return run_virtual(within)


@dataclass
class ChainWorld:
    """Controllers on one daisy chain, by address, each with a driver."""

    clock: Clock
    units: dict[int, Any]  # the queries of a test are specific to each model
    drivers: dict[int, Driver]
    wire: MemoryWire

    async def ready(self, polls: int = 20) -> None:
        async def one(driver: Driver) -> None:
            await driver.connect()
            await driver.configure()
            await driver.set_enabled(["x"], on=True)
            for _ in range(polls):
                await driver.poll()
                await sleep_ns(self.clock, 100 * NS_PER_MS)

        await asyncio.gather(*(one(driver) for driver in self.drivers.values()))


def run_chain(
    main: Callable[[ChainWorld], Coroutine[Any, Any, Any]],
    *,
    seed: int = 1,
    addresses: tuple[int, ...] = (0, 1, 2),
    hold_ms: int = 0,
    options: dict[str, Any] | None = None,
) -> Any:
    """Each controller has one axis x and an input, a crystal of its own, and another start of its counter."""

    async def within(clock: VirtualClock) -> Any:
        draw = Random(seed)
        branches = [
            DeviceSpec(
                address,
                {"axes": 2, **(options or {})},
                Oscillator(draw.randrange(10**11), draw.uniform(-90, 90), 0.05, seed + address),
                TIMING,
                seed + address,
            )
            for address in addresses
        ]
        chain, built = SMC2000.build_shared(clock, branches)
        model = serial_wire(19200, hold_ns=hold_ms * NS_PER_MS)
        wire = MemoryWire(clock, model, chain, "serial", "serial /dev/ttyS0", copy_context(), seed)
        shared: dict[str, Any] = {}

        def driver(address: int) -> Driver:
            fleet = FLEET | {"link": FLEET["link"] | {"address": address}, "axes": {"x": FLEET["axes"]["x"]}}
            config = Controller.model_validate(fleet)
            MAKE.check_config(config)
            chosen = MAKE.options_model.model_validate(config.options)
            return MAKE.create_driver(
                DriverSetup(f"c{address}", config, chosen, clock, wire.open_link, LoopTimedWriter(clock), shared)
            )

        units = dict(zip(addresses, built, strict=True))
        return await main(ChainWorld(clock, units, {each: driver(each) for each in addresses}, wire))

    return run_virtual(within)
