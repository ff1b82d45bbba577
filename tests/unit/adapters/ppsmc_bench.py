"""A driver of a simulated pp-electronic SMC, with other clients at the same time, in virtual time."""

from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass
from typing import Any

from adapters.contract import DriverSetup, HostInterval, MoveOutcome
from adapters.ppsmc import MAKE
from adapters.ppsmc.driver import PpSmcDriver
from adapters.ppsmc.lowering import PpSmcLowered
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import LAN, MemoryWire, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import CommandedMotion, FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.ppsmc import PPSMC
from sim.ppsmc.controller import PpsmcController

# 5 to 20 ms a command: as allowed for by the driver's default options.
TIMING = FirmwareTiming(decode_ns=5_000_000, spread_ns=15_000_000)
NAMES = {"x": "1", "y": "2", "z": "3"}
SPEED, RAMP = 50_000.0, 200_000.0  # steps/s, steps/s²


def controller(names: str = "xyz", serial: bool = False, options: Mapping[str, Any] | None = None, **more: Any) -> Any:
    axis = {
        "unit": "mm",
        "scale": 1000,
        "limits": {"velocity": 50, "acceleration": 200},
        "start_rate": {"min": 0.1, "max": 2},
        "homing": {"speed": 10},
        **more.pop("axis", {}),
    }
    link = {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600} if serial else None
    return Controller.model_validate(
        {
            "adapter": "ppsmc",
            "link": link or {"kind": "tcp", "host": "10.0.0.5", "port": 1234},
            "axes": {name: {**axis, "motors": [NAMES[name]]} for name in names},
            "options": dict(options or {}),
            **more,
        }
    )


class Client:
    """Another client that is connected to the controller."""

    def __init__(self, unit: PpsmcController, port: str = "tcp") -> None:
        self.raw = b""
        self._connection = unit.connect(port, self._take, lambda: None)

    def _take(self, data: bytes) -> None:
        self.raw += data

    def send(self, *lines: str, end: str = "\r") -> None:
        self._connection.receive_bytes("".join(line + end for line in lines).encode())


@dataclass
class Bench:
    clock: VirtualClock
    unit: PpsmcController
    wire: MemoryWire
    driver: PpSmcDriver
    config: Controller

    async def send_as_other_client(self, *lines: str, wait_ms: int = 200) -> Client:
        """Lines by a client of its own, executed."""
        client = Client(self.unit)
        client.send(*lines)
        await sleep_ns(self.clock, wait_ms * NS_PER_MS)
        return client

    async def ready(self) -> None:
        await self.driver.connect()
        await self.driver.configure()
        await self.driver.poll()

    async def reached_again(self) -> None:
        await self.driver.close()
        await sleep_ns(self.clock, 20 * NS_PER_MS)
        await self.ready()

    async def reached_again_quietly(self) -> None:
        """Connected and compared, but not polled."""
        await self.driver.close()
        await sleep_ns(self.clock, 20 * NS_PER_MS)
        await self.driver.connect()
        await self.driver.configure()

    async def lowered(
        self, targets: Mapping[str, int], how: StartOptions | None = None, factor: float = 1.1
    ) -> PpSmcLowered:
        reading = await self.driver.poll()
        moves = [AxisMove(n, reading.axes[n].commanded_counts, to, SPEED, RAMP) for n, to in targets.items()]
        if not moves:
            return self.driver.lower_profiles({}, how or StartOptions(), None)
        plan = plan_step(moves)
        return self.driver.lower_profiles(
            plan.stretch_to(plan.duration_s * factor).profiles, how or StartOptions(), None
        )

    async def arm(self, targets: Mapping[str, int], how: StartOptions | None = None) -> tuple[int, PpSmcLowered]:
        """Plan from the present positions, arm, and return T0."""
        lowered = await self.lowered(targets, how)
        t0_ns = self.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + 300 * NS_PER_MS
        began_ns = self.clock.now_ns()
        await self.driver.slots.present.load(lowered, t0_ns, None)
        assert self.clock.now_ns() - began_ns <= lowered.costs.arm_ns
        return t0_ns, lowered

    async def start(self, targets: Mapping[str, int], how: StartOptions | None = None) -> tuple[int, PpSmcLowered]:
        found = await self.arm(targets, how)
        await self.driver.slots.present.verify()
        await self.driver.slots.present.release()
        return found

    async def followed(self) -> tuple[Mapping[str, HostInterval], MoveOutcome]:
        started = await self.driver.slots.present.wait_for_start()
        return started, await self.driver.slots.present.wait_for_end()

    async def move(self, targets: Mapping[str, int]) -> MoveOutcome:
        await self.start(targets)
        return (await self.followed())[1]

    async def until(self, at_ns: int) -> None:
        await sleep_until_ns(self.clock, max(at_ns, self.clock.now_ns()))

    @property
    def moving(self) -> bool:
        return any(self.unit.is_moving(name) for name in self.unit.axis_names)

    async def rest(self, within_ns: int = 10 * NS_PER_S) -> None:
        until_ns = self.clock.now_ns() + within_ns
        while self.moving:
            assert self.clock.now_ns() <= until_ns
            await sleep_ns(self.clock, NS_PER_MS)

    def steps(self, axis: str) -> int:
        return self.unit.find_axis(NAMES[axis]).steps

    def moved(self) -> Sequence[CommandedMotion]:
        return self.unit.commanded_motions


Case = Callable[[Bench], Awaitable[None]]


def run(
    case: Case,
    *,
    seed: int = 0,
    config: Controller | None = None,
    simulate: Mapping[str, Any] | None = None,
    ppm: float = 0.0,
    timing: FirmwareTiming = TIMING,
    gear: int = 1000,
) -> None:
    """Run `case` with a controller of three axes with `gear` steps/mm that have been saved in it."""

    async def main(clock: VirtualClock) -> None:
        fleet = config or controller()
        serial = fleet.link.kind == "serial"
        options = {"axes": 3, "hardware": ["io_port"], **(simulate or {})}
        oscillator = Oscillator(drift_ppm=ppm, seed=seed)
        unit = PPSMC.build_controller(clock, options, oscillator=oscillator, timing=timing, seed=seed)
        assert isinstance(unit, PpsmcController)
        for axis in unit.machine.axes:
            axis.settings.gnum = axis.settings.gnum * gear
        unit.unit.disk.default = [axis.settings.copy_settings() for axis in unit.machine.axes]
        model = serial_wire(9600) if serial else LAN
        wire = MemoryWire(clock, model, unit, "serial" if serial else "tcp", "unit a", copy_context(), seed)
        MAKE.check_config(fleet)
        setup = DriverSetup(
            "a", fleet, MAKE.options_model.model_validate(fleet.options), clock, wire.open_link, LoopTimedWriter(clock)
        )
        driver = MAKE.create_driver(setup)
        assert isinstance(driver, PpSmcDriver)
        try:
            await case(Bench(clock, unit, wire, driver, fleet))
        finally:
            await driver.close()

    run_virtual(main)
