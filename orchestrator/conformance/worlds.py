"""One simulated controller with its driver, in virtual time, for the contract suite of makes."""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from contextvars import copy_context
from dataclasses import dataclass, replace
from random import Random
from typing import Any

from adapters.abilities import LimitDriver, ManualDriver
from adapters.contract import Driver, DriverSetup, HostInterval, Lowered, MoveOutcome, TimedWriter
from adapters.host.makes import find_make
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.conformance.findings import NotApplicable, require
from orchestrator.conformance.together import Together
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.direct import DirectWire
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


@dataclass(frozen=True)
class Case:
    """A controller as in a fleet file, its simulator's options, and its port that the link leads to.

    beside: addresses of controllers of the same make on the same line, which are polled all the time.
    led: its motion is streamed by the adapter, position by position, and ends with the connection.
    also: controllers of the same make, each on a link of its own, with axes of other names, that take part in every
    step.
    targets: of a usual step, in counts, one per axis; further steps go to multiples of them.
    base_counts: the middle of the range within which all axes may move; steps go to both sides of it.
    short_counts: a short distance.
    jogs_together: its axes can be jogged at the same time.
    forgives_late_lines: a start may be later than declared where the simulated line has delayed its command beyond
    what any adapter assumes, as it seldom does.
    """

    config: Mapping[str, Any]
    simulate: Mapping[str, Any]
    port: str
    beside: tuple[int, ...] = ()
    led: bool = False
    also: "tuple[Case, ...]" = ()
    targets: tuple[int, ...] = (23_456, -12_345)
    base_counts: int = 0
    short_counts: int = 1000
    jogs_together: bool = True
    forgives_late_lines: bool = False

    @property
    def controller(self) -> Controller:
        return Controller.model_validate(self.config)


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

    case: what they are made from.
    units: one, or one per link.
    driver: of all of them.
    polled_beside: how often each of the other controllers on their lines has been read.
    """

    clock: VirtualClock
    case: Case
    units: Sequence[Unit]
    driver: Driver
    draw: Random
    polled_beside: dict[str, int]

    @property
    def hit(self) -> Unit:
        """The controller that is subject to faults, and that has the wired trigger line. Those on other links have
        to cope with it."""
        return self.units[0]

    def targets(self, factor: float = 1.0) -> dict[str, float]:
        """Targets of a step to `factor` times the usual distance, in counts."""
        base = self.case.base_counts
        return {
            axis: base + round(distance * factor) for axis, distance in zip(self.axes, self.case.targets, strict=False)
        }

    def short_targets(self, factor: float) -> dict[str, float]:
        """Targets of a step of all axes to `factor` times the short distance, in counts."""
        return dict.fromkeys(self.axes, float(self.case.base_counts + round(factor * self.case.short_counts)))

    @property
    def axes(self) -> list[str]:
        return [axis for unit in self.units for axis in unit.config.axes]

    def axis(self, name: str) -> Axis:
        return next(unit.config.axes[name] for unit in self.units if name in unit.config.axes)

    def _find_motor(self, axis: str) -> tuple[SimulatedController, str]:
        """The controller of an axis, and its name for the axis."""
        controller = next(unit.controller for unit in self.units if axis in unit.config.axes)
        return controller, self.axis(axis).motors[0]

    def position(self, axis: str) -> float:
        controller, motor = self._find_motor(axis)
        return controller.position(motor)

    def velocity(self, axis: str) -> float:
        controller, motor = self._find_motor(axis)
        return controller.velocity(motor)

    def moving(self, axis: str) -> bool:
        controller, motor = self._find_motor(axis)
        return controller.is_moving(motor)

    def positions(self) -> dict[str, float]:
        return {axis: self.position(axis) for axis in self.axes}

    def places(self) -> dict[str, float]:
        return {
            axis: controller.physical_position(motor)
            for axis in self.axes
            for controller, motor in [self._find_motor(axis)]
        }

    @property
    def at_rest(self) -> bool:
        return not any(self.moving(axis) for axis in self.axes)

    @property
    def motions(self) -> list[tuple[Unit, CommandedMotion]]:
        """Every commanded motion, in order of start."""
        every = [(unit, motion) for unit in self.units for motion in unit.controller.commanded_motions]
        return sorted(every, key=lambda unit_motion: unit_motion[1].start_ns)

    # What an adapter does with it

    async def ready(self, polls: int = 40) -> None:
        """Connected, compared, enabled, and its clock estimated."""
        await self.driver.connect()
        await self.driver.configure()
        await self.load_soft_limits(dict.fromkeys(self.axes))
        await self.driver.set_enabled(self.axes, on=True)
        await self.poll(polls)

    async def load_soft_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        """Load soft limits where the controller keeps some."""
        if isinstance(self.driver, LimitDriver):
            await self.driver.load_soft_limits(limits)

    @property
    def manual(self) -> ManualDriver:
        """The driver, for jogs. Raises `NotApplicable` for a make that has none."""
        if not isinstance(self.driver, ManualDriver):
            raise NotApplicable("this make cannot jog an axis")
        return self.driver

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
        axes = (await self.driver.poll()).axes
        order = max(self.driver.capabilities.orders)
        moves: list[AxisMove] = []
        for name, target in targets.items():
            axis, counts = self.axis(name), axes[name].commanded_counts
            scale, limits = float(axis.scale), axis.limits
            jerk = None if limits.jerk is None else limits.jerk * scale
            velocity, acceleration = limits.velocity * scale, limits.acceleration * scale
            moves.append(
                AxisMove(
                    axis=name,
                    start_counts=counts,
                    target_counts=round(target),
                    velocity=velocity,
                    acceleration=acceleration,
                    jerk=jerk,
                    order=order,
                )
            )
        plan = plan_step(moves)
        return dict(plan.stretch_to(plan.duration_s * stretch).profiles)

    async def arm(self, profiles: Mapping[str, Profile], how: StartOptions = AUTO) -> tuple[Lowered, int]:
        """Lowered and loaded; with T0, which is as near as the make allows."""
        mapping = self.driver.clock_mapping()
        lowered_step = self.driver.lower_profiles(profiles, how, mapping)
        t0_ns = self.clock.now_ns() + lowered_step.costs.arm_ns + lowered_step.costs.disarm_ns + 200 * NS_PER_MS
        if mapping is not None:
            lead_options = how.model_copy(update={"lead_ns": t0_ns - mapping.host_at_ns})
            lowered_step = self.driver.lower_profiles(profiles, lead_options, mapping)
        await self.driver.slots.present.load(lowered_step, t0_ns, mapping)
        return lowered_step, t0_ns

    async def move(
        self, targets: Mapping[str, float]
    ) -> tuple[Lowered, Mapping[str, HostInterval], MoveOutcome, int, dict[str, Profile]]:
        """A whole step."""
        profiles = await self.plan(targets)
        lowered_step, t0_ns = await self.arm(profiles)
        await self.driver.slots.present.verify()
        await self.driver.slots.present.release()
        start_spans = await self.driver.slots.present.wait_for_start()
        return lowered_step, start_spans, await self.driver.slots.present.wait_for_end(), t0_ns, profiles

    def was_line_late(self, start_ns: int) -> bool:
        """Return whether a start may be later than declared because of the line."""
        return self.case.forgives_late_lines and any(unit.wire.delayed_start(start_ns) for unit in self.units)

    def line(self, *, active: bool) -> None:
        """Make the wired input active, or passive, if there is one."""
        if "line" in self.hit.config.inputs:
            point = self.hit.config.inputs["line"]
            self.hit.controller.set_input(point.number, level=active == (point.active == "high"))

    def start_task(self, call: Coroutine[Any, Any, None]) -> "asyncio.Task[None]":
        """Run a call beside the check."""
        return asyncio.get_running_loop().create_task(call)

    async def rest(self, within_ns: int) -> None:
        """Wait until no axis moves."""
        until_ns = self.clock.now_ns() + within_ns
        while not self.at_rest:
            require(self.clock.now_ns() <= until_ns, f"an axis still moves after {within_ns / 1e9:g} s")
            await sleep_ns(self.clock, NS_PER_MS)

    async def until(self, at_ns: int) -> None:
        await sleep_until_ns(self.clock, at_ns)


@dataclass(frozen=True)
class Surroundings:
    """What a unit is built in. ppm: rate error of its crystal."""

    clock: VirtualClock
    firer: TimedWriter
    seed: int
    ppm: float


def build_unit(chosen: Case, name: str, around: Surroundings) -> Unit:
    """The wire of a case with the controllers on it, and a driver of each. name: of the one that it is about."""
    config, clock, seed = chosen.controller, around.clock, around.seed
    make = find_make(config.adapter)
    make.check_config(config)
    own = config.link.address if isinstance(config.link, SerialLink | CanBusLink) else None

    def branch(address: int | None) -> DeviceSpec:
        oscillator = Oscillator(37 * NS_PER_S, around.ppm, 0.05, seed + (address or 0))
        timing = FirmwareTiming(decode_ns=500 * NS_PER_US, spread_ns=500 * NS_PER_US)
        return DeviceSpec(address, chosen.simulate, oscillator, timing, seed)

    addresses = {name: own, **{f"beside {name} {address}": address for address in chosen.beside}}
    in_order = dict(sorted(addresses.items(), key=lambda name_and_address: name_and_address[1] or 0))
    line = build_line(
        find_simulator(config.adapter), clock, {line_name: branch(a) for line_name, a in in_order.items()}
    )
    model = serial_wire(config.link.baud) if config.link.kind == "serial" else LAN
    if config.link.kind == "can":
        model = can_wire()
    if config.link.kind == "tcp" and chosen.port == "serial":
        # A bridge forwards bytes as quickly as its serial side takes them.
        model = replace(LAN, char_ns=10 * NS_PER_S // 38400)
    make_wire = DirectWire if config.link.kind == "process" else MemoryWire
    wire = make_wire(
        clock=clock,
        model=model,
        far=line.endpoint,
        port=chosen.port,
        endpoint=config.link.endpoint,
        far_context=copy_context(),
        seed=seed,
    )
    options = make.options_model.model_validate(config.options)
    shared_values: dict[str, Any] = {}

    def driver_of(each: str) -> Driver:
        link = config.link
        if each != name:
            link = link.model_copy(update={"address": addresses[each]})
        its = config.model_copy(update={"link": link})
        return make.create_driver(
            DriverSetup(
                controller=each,
                config=its,
                options=options,
                clock=clock,
                open_link=wire.open_link,
                timed_writer=around.firer,
                shared=shared_values,
            )
        )

    driver, *other_drivers = [driver_of(driver_name) for driver_name in addresses]
    drivers_beside = dict(zip(list(addresses)[1:], other_drivers, strict=True))
    return Unit(config, line.devices[name], wire, driver, drivers_beside)


def run_case(chosen: Case, main: Callable[[World], Awaitable[None]], seed: int = 0, ppm: float = 40.0) -> None:
    """Run `main` with the world of a case, in virtual time. ppm: rate error of the controller's crystal."""

    async def within(clock: VirtualClock) -> None:
        draw = Random(seed)
        firer = LoopTimedWriter(clock, lambda: draw.randrange(60 * NS_PER_US))
        units = [build_unit(chosen, "it", Surroundings(clock, firer, seed, ppm))]
        for number, other_case in enumerate(chosen.also, 1):
            # Its clock goes wrong the other way.
            units.append(
                build_unit(other_case, f"also{number}", Surroundings(clock, firer, seed + 1000 * number, -ppm))
            )
        driver = units[0].driver
        if chosen.also:
            driver = Together({unit.driver: list(unit.config.axes) for unit in units})
        drivers_beside = {name: driver for unit in units for name, driver in unit.beside.items()}
        world = World(
            clock=clock,
            case=chosen,
            units=units,
            driver=driver,
            draw=draw,
            polled_beside=dict.fromkeys(drivers_beside, 0),
        )
        loop = asyncio.get_running_loop()

        def poll_beside(name: str) -> "asyncio.Task[None]":
            def polled() -> None:
                world.polled_beside[name] += 1

            return loop.create_task(poll_for_ever(clock, drivers_beside[name], polled))

        polls = [poll_beside(name) for name in drivers_beside]
        try:
            await main(world)
        finally:
            for poll in polls:
                poll.cancel()
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


def require_evidence(spans: Mapping[str, HostInterval], truth: Mapping[str, int], what: str) -> None:
    """Raise `ContractBroken` unless each span contains the true instant of its axis."""
    for axis, span in spans.items():
        require(
            span.earliest_ns <= truth[axis] <= span.latest_ns,
            f"the {what} of {axis} was {truth[axis] - span.earliest_ns} ns into the interval that the driver states, "
            f"which has {span.latest_ns - span.earliest_ns} ns",
        )


def motions_by_axis(world: World, since: int) -> dict[str, Any]:
    """The commanded motions since a number of them, by axis of the fleet file: one each."""
    return {
        name: motion
        for unit, motion in world.motions[since:]
        for name, axis in unit.config.axes.items()
        if axis.motors[0] == motion.axis
    }
