"""Simulated SMC30 on one wire in virtual time with a driver before each, as the other tests of the driver use it."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Sequence
from contextlib import suppress
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

from adapters.contract import DriverSetup, HostInterval, MoveOutcome
from adapters.smc30 import MAKE
from adapters.smc30.driver import Smc30Driver
from adapters.smc30.lowering import Smc30Lowered
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions, TriggerDrive, TriggerWait
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import CommandedMotion, DeviceSpec, FirmwareTiming, SimulatedController, build_line
from sim.core.oscillator import Oscillator
from sim.smc30 import SMC30

__all__ = ["HOST", "WINDOW_NS", "World", "config", "drive", "run", "wait"]

WINDOW_NS = 50_000
HOST = StartOptions(start_class="host")


def wait(name: str = "go") -> StartOptions:
    return StartOptions(wait=TriggerWait(input=name, earliest_ns=-WINDOW_NS, latest_ns=WINDOW_NS))


def drive(hold_ms: int = 100) -> StartOptions:
    return StartOptions(drive=TriggerDrive(output="line", active_ns=hold_ms * NS_PER_MS))


def config(unit: int | None = None, **more: Any) -> Controller:
    link: dict[str, Any] = {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600, "data_bits": 7, "parity": "odd"}
    if unit is not None:
        link["address"] = unit
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
    """Controllers by address (None: a single one) and their drivers."""

    clock: Clock
    units: dict[int | None, SimulatedController]
    drivers: dict[int | None, Smc30Driver]
    wire: MemoryWire

    @property
    def one(self) -> tuple[Smc30Driver, SimulatedController]:
        """The first driver and its controller."""
        address = next(iter(self.drivers))
        return self.drivers[address], self.units[address]

    async def ready(self) -> None:
        for driver in self.drivers.values():
            await driver.connect()
            await driver.configure()
            await driver.set_enabled(["x"], on=True)
            await driver.poll()

    async def plan(self, driver: Smc30Driver, target: int, stretch: float = 1.2) -> dict[str, Profile]:
        now = (await driver.poll()).axes["x"].commanded_counts
        plan = plan_step([AxisMove("x", now, target, 5000, 25_000)])
        return dict(plan.stretch_to(plan.duration_s * stretch).profiles)

    def t0(self, lowered: Smc30Lowered, more_ms: int = 100) -> int:
        """An instant that leaves time for arming, promising and releasing."""
        return self.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + more_ms * NS_PER_MS

    async def arm(self, driver: Smc30Driver, target: int, how: StartOptions = HOST) -> tuple[Smc30Lowered, int]:
        lowered = driver.lower_profiles(await self.plan(driver, target), how, None)
        t0_ns = self.t0(lowered)
        await driver.slots.present.load(lowered, t0_ns, None)
        return lowered, t0_ns

    async def move(self, driver: Smc30Driver, target: int) -> tuple[int, HostInterval, MoveOutcome]:
        """A whole step; return T0, the start, and the outcome."""
        _, t0_ns = await self.arm(driver, target)
        await driver.slots.present.verify()
        await driver.slots.present.release()
        started = await driver.slots.present.wait_for_start()
        return t0_ns, started["x"], await driver.slots.present.wait_for_end()

    async def sleep(self, ms: float) -> None:
        await sleep_ns(self.clock, round(ms * NS_PER_MS))

    async def power_cycle(self, unit: SimulatedController, off_ms: float) -> None:
        unit.set_power(on=False)
        await self.sleep(off_ms)
        unit.set_power(on=True)

    async def begun_by_restarted(
        self, unit: SimulatedController, doing: Coroutine[Any, Any, object], after_ms: float, watch_ms: float
    ) -> list[CommandedMotion]:
        """Switch the controller off and on for a moment while it receives a command, with any result of that; return
        the motions that it starts from then on."""
        told = asyncio.ensure_future(doing)
        await self.sleep(after_ms)
        await self.power_cycle(unit, 20)
        on_ns = self.clock.now_ns()
        with suppress(Refusal, ControllerFault):
            await told
        await self.sleep(watch_ms)
        return [motion for motion in unit.commanded_motions if motion.start_ns >= on_ns]

    async def typed(self, data: bytes, ms: float = 60) -> None:
        """Bytes that another client sends on the line before the drivers connect."""
        link = await self.wire.open_link()
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
    """Run `main` with controllers at these addresses, none: a single one. more: for the configuration of each."""

    async def within(clock: VirtualClock) -> None:
        draw = Random(seed)
        own: list[int | None] = [*addresses] if addresses else [None]
        with_checksum = more.get("options", {}).get("checksum", True)
        branches = {
            str(place): DeviceSpec(
                address,
                {"checksum": with_checksum, **(simulate or {})},
                Oscillator(0, draw.uniform(-80, 80)),
                FirmwareTiming(500 * NS_PER_US, 500 * NS_PER_US),
                seed + place,
            )
            for place, address in enumerate(own)
        }
        line = build_line(SMC30, clock, branches)
        wire = MemoryWire(clock, serial_wire(9600), line.endpoint, "serial", "serial /dev/ttyS0", copy_context(), seed)
        shared: dict[str, Any] = {}
        firer = LoopTimedWriter(clock, lambda: draw.randrange(60_000))
        drivers: dict[int | None, Smc30Driver] = {}
        for address in dict.fromkeys(own):
            each = config(address, **more)
            MAKE.check_config(each)
            options = MAKE.options_model.model_validate(each.options)
            driver = MAKE.create_driver(DriverSetup(f"u{address}", each, options, clock, wire.open_link, firer, shared))
            assert isinstance(driver, Smc30Driver)
            drivers[address] = driver
        units = {address: line.devices[str(place)] for place, address in reversed(list(enumerate(own)))}
        world = World(clock, units, drivers, wire)
        try:
            await main(world)
        finally:
            for driver in drivers.values():
                await driver.close()

    run_virtual(within)
