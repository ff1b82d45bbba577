"""Several simulated CiA 402 drives on one bus in memory, each with its driver."""

from collections.abc import Awaitable, Callable, Mapping
from contextvars import copy_context
from dataclasses import dataclass, field
from random import Random
from typing import Any

from adapters.cia402 import MAKE
from adapters.cia402.driver import Cia402Driver
from adapters.contract import AxisReading, DriverSetup, Lowered
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.can import CanFrame
from orchestrator.link.memory import MemoryWire, can_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.cia402 import CIA402
from sim.core.controller import DeviceSpec, FirmwareTiming
from sim.core.oscillator import Oscillator

VELOCITY, ACCELERATION = 80_000.0, 400_000.0
SYNC = 0x080


def config(
    node: int,
    options: Mapping[str, Any] | None = None,
    outputs: Mapping[str, Any] | None = None,
    inputs: Mapping[str, Any] | None = None,
    **axis: Any,
) -> Controller:
    return Controller.model_validate(
        {
            "adapter": "cia402",
            "link": {"kind": "can", "interface": "socketcan", "channel": "can0", "address": node},
            "options": dict(options or {}),
            "outputs": dict(outputs or {}),
            "inputs": dict(inputs or {}),
            "axes": {
                "a": {
                    "motors": ["1"],
                    "unit": "counts",
                    "limits": {"velocity": VELOCITY, "acceleration": ACCELERATION},
                    **axis,
                }
            },
        }
    )


def profiles(begin: int, end: int) -> dict[str, Profile]:
    return dict(plan_step([AxisMove("a", begin, end, VELOCITY / 2, ACCELERATION / 2)]).profiles)


@dataclass
class Drives:
    """The bus, its drives and their drivers, by number from 0; node n + 1."""

    clock: Clock
    bus: Any
    units: list[Any]
    drivers: list[Cia402Driver]
    wire: MemoryWire
    shared: dict[str, Any]
    frames: list[tuple[int, CanFrame]] = field(default_factory=list[tuple[int, CanFrame]])
    late_ns: Callable[[int], int] = lambda at_ns: 0
    """How much later than usual the bytes that are due now are written."""

    @property
    def driver(self) -> Cia402Driver:
        return self.drivers[0]

    @property
    def unit(self) -> Any:
        return self.units[0]

    async def ready(self) -> None:
        for driver in self.drivers:
            await driver.connect()
            await driver.configure()
            await driver.set_enabled(["a"], on=True)

    async def until(self, at_ns: int) -> None:
        await sleep_until_ns(self.clock, at_ns)

    async def rest(self, ms: float) -> None:
        await self.until(self.clock.now_ns() + round(ms * NS_PER_MS))

    async def arm(self, number: int, target: int, t0_ns: int, begin: int = 0) -> Lowered:
        """Armed and verified."""
        driver = self.drivers[number]
        lowered = driver.lower_profiles(profiles(begin, target), StartOptions(), None)
        await driver.slots.present.load(lowered, t0_ns, None)
        await driver.slots.present.verify()
        return lowered

    async def go(self, target: int = 40_000, after_ms: int = 200) -> int:
        """The first drive armed and released; T0."""
        t0_ns = self.clock.now_ns() + after_ms * NS_PER_MS
        await self.arm(0, target, t0_ns)
        await self.driver.slots.present.release()
        return t0_ns

    async def stop_in_motion(self, distance: int, *, abort: bool, rest_ms: float) -> tuple[int, AxisReading]:
        """Stop the first drive in the middle of a move; return where that began, and the axis at rest."""
        driver = self.driver
        here = (await driver.poll()).axes["a"].commanded_counts
        t0_ns = self.clock.now_ns() + 200 * NS_PER_MS
        await self.arm(0, here + distance, t0_ns, begin=here)
        await driver.slots.present.release()
        await driver.slots.present.wait_for_start()
        await self.until(t0_ns + 300 * NS_PER_MS)
        await driver.stop(abort=abort)
        assert (await driver.slots.present.wait_for_end()).state == "stopped"
        await self.rest(rest_ms)
        axis = (await driver.poll()).axes["a"]
        assert axis.enabled and not axis.moving and not self.unit.is_moving("1")
        return here, axis

    def fresh(self) -> Cia402Driver:
        """A driver of the first drive without a connection to the others: that of a restarted process."""
        its = config(1)
        firer = LoopTimedWriter(self.clock)
        return MAKE.create_driver(
            DriverSetup("d1", its, MAKE.options_model.model_validate({}), self.clock, self.wire.open_link, firer)
        )

    def syncs(self, since_ns: int = 0) -> int:
        """How many SYNCs have been on the bus."""
        return sum(frame.id == SYNC for at_ns, frame in self.frames if at_ns >= since_ns)


def run(
    main: Callable[[Drives], Awaitable[None]],
    count: int = 1,
    simulate: Mapping[str, Any] | None = None,
    options: Mapping[str, Any] | None = None,
    **axis: Any,
) -> None:
    """Run `main` with `count` drives. simulate: options of the simulated drives; options, axis, and `outputs` among
    these: of the fleet file."""

    async def within(clock: VirtualClock) -> None:
        branches = [
            DeviceSpec(node, dict(simulate or {}), Oscillator(0, 7.0 * node), FirmwareTiming(300 * NS_PER_US), node)
            for node in range(1, count + 1)
        ]
        segment, units = CIA402.build_shared(clock, branches)
        wire = MemoryWire(clock, can_wire(), segment, "can", "can can0", copy_context(), 3)
        draw, shared = Random(5), dict[str, Any]()
        firer = LoopTimedWriter(clock, lambda: draw.randrange(50 * NS_PER_US) + drives.late_ns(clock.now_ns()))
        drivers: list[Cia402Driver] = []
        for node in range(1, count + 1):
            its = config(node, options, **axis)
            MAKE.check_config(its)
            setup = DriverSetup(
                f"d{node}", its, MAKE.options_model.model_validate(its.options), clock, wire.open_link, firer, shared
            )
            drivers.append(MAKE.create_driver(setup))
        drives = Drives(clock, segment.bus, list(units), drivers, wire, shared)
        segment.bus.add_listener(lambda frame, begin_ns, end_ns: drives.frames.append((end_ns, frame)))
        try:
            await main(drives)
        finally:
            for driver in drivers:
                await driver.close()

    run_virtual(within)


SECOND = NS_PER_S
