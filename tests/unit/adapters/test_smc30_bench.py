"""Simulated SMC30 on one wire in virtual time with a driver before each, as the other tests of the driver use it."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

from adapters.contract import CannotDo, DriverFault, Outcome, Setup, Span
from adapters.smc30 import MAKE
from adapters.smc30.driver import SmcDriver
from adapters.smc30.lowering import SmcLowered
from adapters.toolkit.firing import LoopFirer
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.virtual import run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LineDrive, LineWait, StartWay
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import Branch, Motion, SimulatedController, Timing, build_line
from sim.core.oscillator import Oscillator
from sim.smc30 import SMC30

__all__ = ["HOST", "WINDOW_NS", "World", "config", "drive", "run", "wait"]

WINDOW_NS = 50_000
HOST = StartWay(by="host")


def wait(name: str = "go") -> StartWay:
    return StartWay(wait=LineWait(input=name, earliest_ns=-WINDOW_NS, latest_ns=WINDOW_NS))


def drive(hold_ms: int = 100) -> StartWay:
    return StartWay(drive=LineDrive(output="line", hold_ns=hold_ms * NS_PER_MS))


def config(unit: int | None = None, **more: Any) -> Controller:
    link: dict[str, Any] = {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600, "data_bits": 7, "parity": "odd"}
    if unit is not None:
        link["unit"] = unit
    axis: dict[str, Any] = {
        "motors": ["1"],
        "unit": "mm",
        "scale": 1000,
        "limits": {"velocity": 5, "acceleration": 25},
        "start_rate": {"min": 0.1, "max": 0.4},
        "homing": {"speed": 1},
    }
    axis |= more.pop("axis", {})
    points = {"inputs": {"go": {"number": 1}}, "outputs": {"line": {"number": 2}}}
    return Controller.model_validate({"adapter": "smc30", "link": link, "axes": {"x": axis}, **points, **more})


@dataclass
class World:
    """Units by address (None: one alone) and their drivers."""

    clock: Clock
    units: dict[int | None, SimulatedController]
    drivers: dict[int | None, SmcDriver]
    wire: MemoryWire

    @property
    def one(self) -> tuple[SmcDriver, SimulatedController]:
        """The first driver and its unit."""
        address = next(iter(self.drivers))
        return self.drivers[address], self.units[address]

    async def ready(self) -> None:
        for driver in self.drivers.values():
            await driver.connect()
            await driver.configure()
            await driver.enable(["x"], True)
            await driver.poll()

    async def plan(self, driver: SmcDriver, target: int, stretch: float = 1.2) -> dict[str, Profile]:
        now = (await driver.poll()).axes["x"].commanded_counts
        plan = plan_step([AxisMove("x", now, target, 5000, 25_000)])
        return dict(plan.stretched(plan.duration_s * stretch).profiles)

    def t0(self, lowered: SmcLowered, more_ms: int = 100) -> int:
        """An instant that leaves time for arming, promising and releasing."""
        return self.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + more_ms * NS_PER_MS

    async def arm(self, driver: SmcDriver, target: int, how: StartWay = HOST) -> tuple[SmcLowered, int]:
        lowered = driver.lower(await self.plan(driver, target), how, None)
        t0_ns = self.t0(lowered)
        await driver.arm(lowered, t0_ns, None)
        return lowered, t0_ns

    async def move(self, driver: SmcDriver, target: int) -> tuple[int, Span, Outcome]:
        """A whole step; T0, the start, and what has become of it."""
        _, t0_ns = await self.arm(driver, target)
        await driver.verify()
        await driver.go()
        started = await driver.started()
        return t0_ns, started["x"], await driver.outcome()

    async def sleep(self, ms: float) -> None:
        await sleep_ns(self.clock, round(ms * NS_PER_MS))

    async def power_cycle(self, unit: SimulatedController, off_ms: float) -> None:
        unit.set_power(False)
        await self.sleep(off_ms)
        unit.set_power(True)

    async def begun_by_restarted(
        self, unit: SimulatedController, doing: Coroutine[Any, Any, object], after_ms: float, watch_ms: float
    ) -> list[Motion]:
        """The unit is switched off and on for a moment while it is told to do something, whatever becomes of that:
        the motions that it begins from then on."""
        told = asyncio.ensure_future(doing)
        await self.sleep(after_ms)
        await self.power_cycle(unit, 20)
        on_ns = self.clock.now_ns()
        with suppress(CannotDo, DriverFault):
            await told
        await self.sleep(watch_ms)
        return [motion for motion in unit.motions if motion.start_ns >= on_ns]

    async def typed(self, data: bytes, ms: float = 60) -> None:
        """What somebody else says on the line before the drivers are there."""
        link = await self.wire.open()
        link.write(data)
        await self.sleep(ms)
        await link.close()
        await self.sleep(5)


def run(
    main: Callable[[World], Awaitable[None]],
    addresses: Sequence[int] = (),
    simulate: dict[str, Any] | None = None,
    seed: int = 1,
    **more: Any,
) -> None:
    """Run `main` with units at these addresses, none: one alone. more: for the configuration of each."""

    async def within(clock: Clock) -> None:
        draw = Random(seed)
        own: list[int | None] = [*addresses] if addresses else [None]
        with_checksum = more.get("options", {}).get("checksum", True)
        branches = {
            str(place): Branch(
                address,
                {"checksum": with_checksum, **(simulate or {})},
                Oscillator(0, draw.uniform(-80, 80)),
                Timing(500 * NS_PER_US, 500 * NS_PER_US),
                seed + place,
            )
            for place, address in enumerate(own)
        }
        line = build_line(SMC30, clock, branches)
        wire = MemoryWire(clock, serial_wire(9600), line.far, "serial", "serial /dev/ttyS0", copy_context(), seed)
        shared: dict[str, Any] = {}
        firer = LoopFirer(clock, lambda: draw.randrange(60_000))
        drivers: dict[int | None, SmcDriver] = {}
        for address in dict.fromkeys(own):
            each = config(address, **more)
            MAKE.check(each)
            options = MAKE.options.model_validate(each.options)
            driver = MAKE.driver(Setup(f"u{address}", each, options, clock, wire.open, firer, shared))
            assert isinstance(driver, SmcDriver)
            drivers[address] = driver
        units = {address: line.units[str(place)] for place, address in reversed(list(enumerate(own)))}
        world = World(clock, units, drivers, wire)
        try:
            await main(world)
        finally:
            for driver in drivers.values():
                await driver.close()

    run_virtual(within)
