"""One simulated controller of each make and link, with its driver, for the contract suite of adapters."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass, replace
from random import Random
from typing import Any

from drivers_together import Together

from adapters.contract import Driver, DriverSetup, HostInterval, Lowered, MoveOutcome, TimedWriter
from adapters.host.makes import find_make
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.memory import LAN, MemoryWire, can_wire, serial_wire
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Axis, CanBusLink, Controller, SerialLink
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import CommandedMotion, DeviceSpec, FirmwareTiming, SimulatedController, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

AUTO = StartOptions()
SERVO = {"unit": "mm", "scale": 1000, "limits": {"velocity": 80, "acceleration": 400}}
STEPPER = {
    "unit": "mm",
    "scale": 10_000,
    "limits": {"velocity": 8, "acceleration": 40},
    "start_rate": {"min": 0.01, "max": 0.4},
    "homing": {"speed": 2},
}
TCP = {"kind": "tcp", "host": "127.0.0.1", "port": 1}
YASKAWA = {"home_edge": {"X": -2000, "Y": -1500}, "index_every": {"X": 200, "Y": 200}}


@dataclass(frozen=True)
class Case:
    """A controller as in a fleet file, its simulator's options, and its port that the link leads to.

    beside: addresses of controllers of the same make on the same line, which are polled all the time.
    led: its motion is streamed by the adapter, position by position, and ends with the connection.
    also: controllers of the same make, each on a link of its own, with axes of other names, that take part in every
    step.
    """

    config: Mapping[str, Any]
    simulate: Mapping[str, Any]
    port: str
    beside: tuple[int, ...] = ()
    led: bool = False
    also: "tuple[Case, ...]" = ()

    @property
    def controller(self) -> Controller:
        return Controller.model_validate(self.config)


def case(
    adapter: str,
    link: Mapping[str, Any],
    axes: Mapping[str, str],
    kind: Mapping[str, Any],
    simulate: Mapping[str, Any],
    port: str,
    **options: Any,
) -> Case:
    config = {
        "adapter": adapter,
        "link": dict(link),
        "options": options,
        "axes": {name: {**kind, "motors": [motor]} for name, motor in axes.items()},
        "inputs": {"line": {"number": 1, "active": "low"}},
        "outputs": {"line": {"number": 1}},
    }
    return Case(config, simulate, port)


STEPS = {
    "unit": "mm",
    "scale": 1000,
    "limits": {"velocity": 10, "acceleration": 50},
    "start_rate": {"min": 0.05, "max": 0.4},
    "homing": {"speed": 1.5},
}
SMC30_LINK = {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600, "data_bits": 7, "parity": "odd"}
SMC30_ENDS = {"travel_steps": [-20_000, 200_000]}
PULSES = {
    "unit": "counts",
    "limits": {"velocity": 80_000, "acceleration": 400_000},
    "start_rate": {"min": 100, "max": 4000},
    "homing": {"speed": 20_000},
}
ORG = {"axes": 2, "hardware": ["io_port"], "org_steps": {"1": [-9000, -2000], "2": [-9000, -1500]}}
STAGE = {"divide": 20, "speed": [100, 20000, 100]}
CAN = {"kind": "can", "interface": "socketcan", "channel": "can0", "bitrate": 1_000_000, "address": 3}
DRIVE = {**SERVO, "homing": {"method": "home_switch_negative"}}
SMOOTH = {**DRIVE, "limits": {"velocity": 80, "acceleration": 400, "jerk": 8000}}
PROMPT = {"cycle_us": 100, "start_us": 50, "start_spread_us": 50}
SWITCH = {"home_switch": [-3000, -2000]}
CASES = {
    "smc4000 on TCP": case("smc4000", TCP, {"x": "X", "y": "Y"}, SERVO, {"axes": 2, **YASKAWA}, "tcp"),
    "smc4000 on UDP": case(
        "smc4000", {**TCP, "kind": "udp"}, {"x": "X", "y": "Y"}, SERVO, {"axes": 2, **YASKAWA}, "udp"
    ),
    "smc4000 on serial": case(
        "smc4000",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200},
        {"x": "X", "y": "Y"},
        SERVO,
        {"axes": 2, **YASKAWA},
        "serial",
    ),
    "galil dmc40x0": case("galil", TCP, {"x": "X", "y": "Y"}, SERVO, {"axes": 2, **YASKAWA}, "tcp", family="dmc40x0"),
    "galil dmc21x3": case(
        "galil",
        TCP,
        {"x": "X", "y": "Y"},
        SERVO,
        {"axes": 2, "family": "dmc21x3", **YASKAWA},
        "tcp",
        family="dmc21x3",
    ),
    "smc2000 on serial": case(
        "smc2000",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200},
        {"x": "X", "y": "Y"},
        SERVO,
        {"axes": 2, **YASKAWA},
        "serial",
    ),
    "smc2000 in a chain of three": replace(
        case(
            "smc2000",
            {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200, "address": 1},
            {"x": "X", "y": "Y"},
            SERVO,
            {"axes": 2, **YASKAWA},
            "serial",
        ),
        beside=(0, 2),
    ),
    "shrc203 on serial": case(
        "shrc203",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 38400},
        {"u": "1", "v": "2"},
        STEPPER,
        STAGE,
        "serial",
        nm_per_pulse=100,
    ),
    "shrc203 behind a TCP bridge": case(
        "shrc203", TCP, {"u": "1", "v": "2"}, STEPPER, STAGE, "serial", nm_per_pulse=100
    ),
    "smc30 on serial": case(
        "smc30", SMC30_LINK, {"u": "1"}, STEPS, {**SMC30_ENDS, "checksum": False}, "serial", checksum=False
    ),
    "smc30, seven on a bus with checksum": replace(
        case("smc30", {**SMC30_LINK, "address": 3}, {"u": "1"}, STEPS, {**SMC30_ENDS, "checksum": True}, "serial"),
        beside=(1, 2, 4, 5, 6, 7),
    ),
    "ppsmc on TCP": case(
        "ppsmc", TCP, {"u": "1", "v": "2"}, PULSES, ORG, "tcp", decode_us=750, decode_spread_us=250, io_port=True
    ),
    "ppsmc on serial": case(
        "ppsmc",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600},
        {"u": "1", "v": "2"},
        PULSES,
        ORG,
        "serial",
        decode_us=750,
        decode_spread_us=250,
        io_port=True,
    ),
    "cia402 alone": case("cia402", CAN, {"u": "1"}, DRIVE, SWITCH, "can"),
    "cia402, four on one bus": replace(case("cia402", CAN, {"u": "1"}, DRIVE, SWITCH, "can"), beside=(1, 2, 120)),
    "cia402, streamed to, two on one bus": replace(
        case("cia402", CAN, {"u": "1"}, SMOOTH, SWITCH, "can"), beside=(120,), led=True
    ),
    # Of one number: messages of one bus must not be taken for the other's. No SYNC is for both; they start together
    # only because each is written at the instant.
    "cia402, two on two buses": replace(
        case("cia402", CAN, {"u": "1"}, DRIVE, SWITCH, "can", **PROMPT),
        also=(case("cia402", {**CAN, "channel": "can1"}, {"v": "1"}, DRIVE, SWITCH, "can", **PROMPT),),
    ),
}


@dataclass(frozen=True)
class Unit:
    """A controller of the step and its driver, with the link between them. beside: drivers of the other controllers
    on the link, by name."""

    config: Controller
    controller: SimulatedController
    wire: MemoryWire
    driver: Driver
    beside: Mapping[str, Driver]


@dataclass
class World:
    """A driver and the controllers that it drives, with their ground truth.

    units: one, or one per link.
    driver: of all of them.
    polled_beside: how often each of the other controllers on their lines has been read.
    """

    clock: VirtualClock
    units: Sequence[Unit]
    driver: Driver
    draw: Random
    polled_beside: dict[str, int]

    @property
    def hit(self) -> Unit:
        """The controller that is subject to faults, and that has the wired trigger line. Those on other links have
        to cope with it."""
        return self.units[0]

    @property
    def axes(self) -> list[str]:
        return [axis for unit in self.units for axis in unit.config.axes]

    def axis(self, name: str) -> Axis:
        return next(unit.config.axes[name] for unit in self.units if name in unit.config.axes)

    def _its(self, axis: str) -> tuple[SimulatedController, str]:
        """The controller of an axis, and its name for the axis."""
        controller = next(unit.controller for unit in self.units if axis in unit.config.axes)
        return controller, self.axis(axis).motors[0]

    def position(self, axis: str) -> float:
        controller, motor = self._its(axis)
        return controller.position(motor)

    def velocity(self, axis: str) -> float:
        controller, motor = self._its(axis)
        return controller.velocity(motor)

    def moving(self, axis: str) -> bool:
        controller, motor = self._its(axis)
        return controller.is_moving(motor)

    def positions(self) -> dict[str, float]:
        return {axis: self.position(axis) for axis in self.axes}

    def places(self) -> dict[str, float]:
        return {
            axis: controller.physical_position(motor) for axis in self.axes for controller, motor in [self._its(axis)]
        }

    @property
    def at_rest(self) -> bool:
        return not any(self.moving(axis) for axis in self.axes)

    @property
    def motions(self) -> list[tuple[Unit, CommandedMotion]]:
        """Every commanded motion, in order of start."""
        every = [(unit, motion) for unit in self.units for motion in unit.controller.commanded_motions]
        return sorted(every, key=lambda each: each[1].start_ns)

    # What an adapter does with it

    async def ready(self, polls: int = 40) -> None:
        """Connected, compared, enabled, and its clock estimated."""
        await self.driver.connect()
        await self.driver.configure()
        await self.driver.load_soft_limits(dict.fromkeys(self.axes))
        await self.driver.set_enabled(self.axes, on=True)
        await self.poll(polls)

    async def leave(self) -> None:
        """Close the driver, and wait until the other side has detected it."""
        await self.driver.close()
        await sleep_ns(self.clock, 20 * NS_PER_MS)

    async def poll(self, times: int) -> None:
        for _ in range(times):
            await self.driver.poll()
            await sleep_ns(self.clock, 90 * NS_PER_MS + self.draw.randrange(20 * NS_PER_MS))

    async def plan(self, targets: Mapping[str, float], stretch: float = 1.3) -> dict[str, Profile]:
        """Profiles to `targets` (counts) from the present positions, of one duration; trapezoids if no jerk is
        limited."""
        now = (await self.driver.poll()).axes
        order = max(self.driver.capabilities.orders)
        moves: list[AxisMove] = []
        for name, target in targets.items():
            axis, here = self.axis(name), now[name].commanded_counts
            scale, limits = float(axis.scale), axis.limits
            jerk = None if limits.jerk is None else limits.jerk * scale
            velocity, acceleration = limits.velocity * scale, limits.acceleration * scale
            moves.append(AxisMove(name, here, round(target), velocity, acceleration, jerk, order=order))
        plan = plan_step(moves)
        return dict(plan.stretch_to(plan.duration_s * stretch).profiles)

    async def arm(self, profiles: Mapping[str, Profile], how: StartOptions = AUTO) -> tuple[Lowered, int]:
        """Lowered and loaded; with T0, which is as near as the make allows."""
        mapping = self.driver.clock_mapping()
        lowered = self.driver.lower_profiles(profiles, how, mapping)
        t0_ns = self.clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + 200 * NS_PER_MS
        if mapping is not None:
            ahead = how.model_copy(update={"lead_ns": t0_ns - mapping.host_at_ns})
            lowered = self.driver.lower_profiles(profiles, ahead, mapping)
        await self.driver.arm_move(lowered, t0_ns, mapping)
        return lowered, t0_ns

    async def move(
        self, targets: Mapping[str, float]
    ) -> tuple[Lowered, Mapping[str, HostInterval], MoveOutcome, int, dict[str, Profile]]:
        """A whole step."""
        profiles = await self.plan(targets)
        lowered, t0_ns = await self.arm(profiles)
        await self.driver.verify_armed()
        await self.driver.go()
        started = await self.driver.wait_for_start()
        return lowered, started, await self.driver.wait_for_end(), t0_ns, profiles

    def line(self, active: bool) -> None:
        """Make the wired input active, or passive."""
        self.hit.controller.set_input(1, level=active == (self.hit.config.inputs["line"].active == "high"))

    async def rest(self, within_ns: int) -> None:
        """Wait until no axis moves."""
        until_ns = self.clock.now_ns() + within_ns
        while not self.at_rest:
            assert self.clock.now_ns() <= until_ns, f"still moves after {within_ns / 1e9} s"
            await sleep_ns(self.clock, NS_PER_MS)

    async def until(self, at_ns: int) -> None:
        await sleep_until_ns(self.clock, at_ns)


def build(clock: VirtualClock, chosen: Case, name: str, firer: TimedWriter, seed: int, ppm: float) -> Unit:
    """The wire of a case with the controllers on it, and a driver of each. name: of the one that it is about."""
    config = chosen.controller
    make = find_make(config.adapter)
    make.check_config(config)
    own = config.link.address if isinstance(config.link, SerialLink | CanBusLink) else None

    def branch(address: int | None) -> DeviceSpec:
        oscillator = Oscillator(37 * NS_PER_S, ppm, 0.05, seed + (address or 0))
        timing = FirmwareTiming(decode_ns=500 * NS_PER_US, spread_ns=500 * NS_PER_US)
        return DeviceSpec(address, chosen.simulate, oscillator, timing, seed)

    addresses = {name: own, **{f"beside {name} {each}": each for each in chosen.beside}}
    in_order = dict(sorted(addresses.items(), key=lambda each: each[1] or 0))
    line = build_line(find_simulator(config.adapter), clock, {each: branch(a) for each, a in in_order.items()})
    model = serial_wire(config.link.baud) if config.link.kind == "serial" else LAN
    if config.link.kind == "can":
        model = can_wire()
    if config.link.kind == "tcp" and chosen.port == "serial":
        # A bridge forwards bytes as quickly as its serial side takes them.
        model = replace(LAN, char_ns=10 * NS_PER_S // 38400)
    wire = MemoryWire(clock, model, line.endpoint, chosen.port, config.link.endpoint, copy_context(), seed)
    options = make.options_model.model_validate(config.options)
    shared: dict[str, Any] = {}

    def driver_of(each: str) -> Driver:
        link = config.link
        if each != name:
            link = link.model_copy(update={"address": addresses[each]})
        its = config.model_copy(update={"link": link})
        return make.create_driver(DriverSetup(each, its, options, clock, wire.open_link, firer, shared))

    driver, *beside = [driver_of(each) for each in addresses]
    others = dict(zip(list(addresses)[1:], beside, strict=True))
    return Unit(config, line.devices[name], wire, driver, others)


def run(name: str, main: Callable[[World], Awaitable[None]], seed: int = 0, ppm: float = 40.0) -> None:
    """Run `main` with the world of a case."""

    async def within(clock: VirtualClock) -> None:
        chosen, draw = CASES[name], Random(seed)
        firer = LoopTimedWriter(clock, lambda: draw.randrange(60 * NS_PER_US))
        units = [build(clock, chosen, "it", firer, seed, ppm)]
        for number, each in enumerate(chosen.also, 1):
            # Its clock goes wrong the other way.
            units.append(build(clock, each, f"also{number}", firer, seed + 1000 * number, -ppm))
        driver = units[0].driver
        if chosen.also:
            driver = Together({unit.driver: list(unit.config.axes) for unit in units})
        beside = {name: each for unit in units for name, each in unit.beside.items()}
        world = World(clock, units, driver, draw, dict.fromkeys(beside, 0))
        loop = asyncio.get_running_loop()

        def poll_beside(name: str) -> "asyncio.Task[None]":
            def polled() -> None:
                world.polled_beside[name] += 1

            return loop.create_task(poll_for_ever(clock, beside[name], polled))

        others = [poll_beside(name) for name in beside]
        try:
            await main(world)
        finally:
            for other in others:
                other.cancel()
            await driver.close()

    run_virtual(within)


async def poll_for_ever(clock: VirtualClock, driver: Driver, polled: Callable[[], None]) -> None:
    """The activity of another controller on the same line, with any result. polled: called with each reading."""
    while True:
        try:
            await driver.connect()
            await driver.configure()
            while True:
                await driver.poll()
                polled()
                await sleep_ns(clock, 200 * NS_PER_MS)
        except (ControllerFault, LinkClosed, LinkRefused, Refusal):
            await driver.close()
            await sleep_ns(clock, NS_PER_S)


def evidence_holds(world: World, spans: Mapping[str, HostInterval], truth: Mapping[str, int], what: str) -> None:
    for axis, span in spans.items():
        assert span.earliest_ns <= truth[axis] <= span.latest_ns, (
            f"{what} of {axis}: {truth[axis] - span.earliest_ns} ns into a span of {span.latest_ns - span.earliest_ns}"
        )


def motions(world: World, since: int) -> dict[str, Any]:
    """The commanded motions since a number of them, by axis of the fleet file: one each."""
    return {
        name: motion
        for unit, motion in world.motions[since:]
        for name, axis in unit.config.axes.items()
        if axis.motors[0] == motion.axis
    }
