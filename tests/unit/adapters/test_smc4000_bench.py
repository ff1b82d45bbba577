"""A simulated SMC-4000 on a wire in virtual time with a driver before it, as the other tests of the driver use it."""

from collections.abc import Callable, Coroutine, Mapping
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

from adapters.contract import Driver, DriverSetup
from adapters.toolkit.firing import LoopTimedWriter
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.smc4000.driver import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import LAN, MemoryWire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.yaskawa import SMC4000

VELOCITY, ACCELERATION, JERK = 100_000.0, 1_000_000.0, 2e7  # of jerk-limited moves, counts
LIMITS = {"velocity": 100.0, "acceleration": 1000.0}
FLEET = {
    "adapter": "smc4000",
    "link": {"kind": "tcp", "host": "10.0.0.1", "port": 23},
    "axes": {
        "x": {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": LIMITS},
        "y": {"motors": ["Y"], "unit": "mm", "scale": 1000, "limits": LIMITS},
    },
}


@dataclass
class World:
    clock: Clock
    controller: SimulatedController
    wire: MemoryWire
    driver: Driver
    other: Callable[[], Any]

    async def talk(self, line: str) -> str:
        """The commands of another user at a terminal of his own."""
        link = await self.wire.open_link()
        reply = ""
        link.write(line.encode("latin-1") + b"\r")
        while not reply.endswith((":", "?")):
            reply += (await link.read()).data.decode("latin-1")
        await link.close()
        return reply

    async def ready(self, polls: int = 30) -> None:
        await self.driver.connect()
        await self.driver.configure()
        await self.driver.set_enabled(["x", "y"], on=True)
        for _ in range(polls):
            await self.driver.poll()
            await sleep_ns(self.clock, 100 * NS_PER_MS)

    async def moved(self, profiles: dict[str, Profile], lead_s: float = 0.5) -> tuple[Any, Any, Any, int]:
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


def run(
    main: Callable[[World], Coroutine[Any, Any, Any]],
    *,
    seed: int = 1,
    fleet: dict[str, Any] | None = None,
    options: dict[str, Any] | None = None,
    ppm: float = 40.0,
    decode_ns: int = 500_000,
) -> Any:
    async def within(clock: VirtualClock) -> Any:
        config = Controller.model_validate(fleet or FLEET)
        MAKE.check_config(config)
        oscillator = Oscillator(Random(seed).randrange(10**9), ppm, 0.05, seed)
        timing = FirmwareTiming(decode_ns=decode_ns, spread_ns=50_000)
        controller = SMC4000.build_controller(clock, options or {}, oscillator=oscillator, timing=timing, seed=seed)
        wire = MemoryWire(clock, LAN, controller, "tcp", "smc", copy_context(), seed)

        def driver() -> Driver:
            chosen = YaskawaOptions.model_validate(config.options)
            return MAKE.create_driver(DriverSetup("c", config, chosen, clock, wire.open_link, LoopTimedWriter(clock)))

        return await main(World(clock, controller, wire, driver(), driver))

    return run_virtual(within)


def trapezoid(start: int, end: int, speed: float, ramp: float, stretch: float = 1.0) -> Profile:
    way = abs(end - start)
    sign = 1 if end > start else -1
    speed = min(speed, (way * ramp) ** 0.5)
    t, hold = speed / ramp, way / speed - speed / ramp
    profile = Profile(start, end, sign * 1.0, [t, max(hold, 0.0), t], [ramp, 0.0, -ramp], [0.0, 0.0, 0.0])
    return profile.stretch_time(stretch)


def jerked(targets: Mapping[str, tuple[int, int]], share: float = 1.0) -> dict[str, Profile]:
    """By axis from where to where, all in one time, at a share of the axes' speed."""
    moves = [
        AxisMove(axis, start, end, VELOCITY * share, ACCELERATION, JERK, order=3)
        for axis, (start, end) in targets.items()
    ]
    return dict(plan_step(moves).profiles)
