"""Checks of lost controllers and lines: silence, noise, power cycles, and controllers that others move."""

import contextlib
from collections.abc import Awaitable, Callable
from functools import partial

from adapters.abilities import set_output
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.conformance.checks import ContractCheck, require_step
from orchestrator.conformance.findings import NotApplicable, require, require_error
from orchestrator.conformance.worlds import World
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault
from orchestrator.model.messages import StartOptions

LOST = (ControllerFault, LinkClosed, LinkRefused)
SILENCE_LIMIT_NS = 10 * NS_PER_S
OFF_NS = NS_PER_S
STARTUP_NS = 5 * NS_PER_S


async def check_silence(world: World, call: str) -> None:
    """Call a driver whose controller does not answer any more."""
    if call == "set_output" and not world.hit.config.outputs:
        raise NotApplicable("this make has no outputs, or its example names none")
    await world.ready()
    driver = world.driver
    profiles = await world.plan(world.targets())
    mapping = driver.clock_mapping()
    lowered_step = driver.lower_profiles(profiles, StartOptions(), mapping)
    t0_ns = world.clock.now_ns() + 3 * NS_PER_S
    if call == "verify":
        await driver.slots.present.load(lowered_step, t0_ns, mapping)
    world.hit.wire.cut = True
    calls: dict[str, Callable[[], Awaitable[object]]] = {
        "connect": driver.connect,
        "configure": driver.configure,
        "poll": driver.poll,
        "enable": lambda: driver.set_enabled(world.axes, on=False),
        "home": lambda: driver.home_axes(world.axes, lambda _: None),
        "arm": lambda: driver.slots.present.load(lowered_step, t0_ns, mapping),
        "verify": driver.slots.present.verify,
        "set_output": lambda: set_output(driver, 1, on=True),
    }
    began_ns = world.clock.now_ns()
    error = await require_error(calls[call](), f"{call} of a silent controller", *LOST)
    took_ns = world.clock.now_ns() - began_ns
    require(took_ns < SILENCE_LIMIT_NS, f"{call} of a silent controller took {took_ns / NS_PER_S:g} s")
    require(
        not isinstance(error, ControllerFault) or error.remedy,
        f"the fault of a silent controller has no remedy: {error}",
    )
    world.hit.wire.cut = False
    await world.leave()
    await driver.connect()
    await driver.configure()
    await driver.slots.unload()
    await world.poll(5)
    require(world.at_rest, "an axis moves after the line was cut")


async def check_noise(world: World) -> None:
    """Poll over a line with noise."""
    await world.ready()
    positions_before = world.positions()

    def garble(data: bytes) -> bytes:
        return bytes(world.draw.randrange(256) if world.draw.random() < 0.2 else byte for byte in data)

    world.hit.wire.to_near = garble
    wrong = 0
    for _ in range(20):
        try:
            await world.driver.poll()
        except LOST:
            wrong += 1
            await world.leave()
            with contextlib.suppress(*LOST):
                await world.driver.connect()
    require(wrong, "no poll over a line with noise has failed")
    world.hit.wire.to_near = None
    await world.leave()
    await sleep_ns(world.clock, NS_PER_S)
    await world.driver.connect()
    await world.driver.configure()
    read_positions = {axis: reading.commanded_counts for axis, reading in (await world.driver.poll()).axes.items()}
    require(
        read_positions == positions_before,
        f"after the noise the positions {read_positions} are read, before it they were {positions_before}",
    )
    require(world.positions() == positions_before, "noise towards the host has moved an axis")


async def check_power_cycle(world: World) -> None:
    """Switch a controller with a released move off and on."""
    await world.ready()
    await world.arm(await world.plan(world.targets()))
    await world.driver.slots.present.verify()
    await world.driver.slots.present.release()
    world.hit.controller.set_power(on=False)
    await sleep_ns(world.clock, OFF_NS)
    world.hit.controller.set_power(on=True)
    await sleep_ns(world.clock, STARTUP_NS)
    is_noticed = False
    for _ in range(5):
        try:
            is_noticed = is_noticed or (await world.driver.poll()).restarted
        except LOST:
            # Its links are lost with it; after that it is queried again.
            await world.leave()
            await world.driver.connect()
            await world.driver.configure()
    require(is_noticed, "no reading after the power cycle says that the controller has restarted")
    real_motions = [
        motion for motion in world.hit.controller.commanded_motions if motion.end_counts != motion.start_counts
    ]
    require(world.at_rest and not real_motions, f"an axis has moved after the power cycle: {real_motions}")
    await world.driver.set_enabled(world.axes, on=True)
    await world.poll(40)
    await require_step(world)


async def check_power_cycle_between_connections(world: World) -> None:
    """Switch a controller off and on while nothing is connected to it."""
    await world.ready()
    failures = await world.driver.home_axes(world.axes, lambda _: None)
    require(not failures, f"homing failed: {failures}")
    await require_step(world)
    places_before, positions = world.places(), world.positions()
    await world.leave()
    world.hit.controller.set_power(on=False)
    await sleep_ns(world.clock, OFF_NS)
    world.hit.controller.set_power(on=True)
    await sleep_ns(world.clock, STARTUP_NS)
    # The axes stand where they did, though their controllers report another position now.
    require(
        all(abs(counts - places_before[axis]) <= 1 for axis, counts in world.places().items()),
        "a power cycle moved an axis",
    )
    require(world.positions() != positions, "the simulator keeps its position over a power cycle")
    for is_noticed in (True, False):
        # A detected restart is reported although the link breaks before the next poll.
        for _ in range(2 if is_noticed else 1):
            await world.driver.connect()
            await world.driver.configure()
            await world.leave()
        await world.driver.connect()
        await world.driver.configure()
        restarts = [(await world.driver.poll()).restarted for _ in range(3)]
        require(
            restarts == [is_noticed, False, False],
            f"three polls report a restart so: {restarts}, expected once: {is_noticed}",
        )
        await world.leave()


async def check_moving_controller(world: World) -> None:
    """Connect to a controller that moves."""
    await world.ready()
    _, t0_ns = await world.arm(await world.plan(world.targets(2)))
    await world.driver.slots.present.verify()
    await world.driver.slots.present.release()
    await world.until(t0_ns + 200 * NS_PER_MS)
    await world.leave()
    try:
        await world.driver.connect()
    except ControllerFault as error:
        require(error.remedy, f"the fault of a moving controller has no remedy: {error}")
    await world.rest(60 * NS_PER_S)
    goals, places = world.targets(2), world.positions()
    if not world.case.led:
        # It went where it was going.
        require(places == goals, f"connecting has stopped the axes at {places}, on their way to {goals}")
        return
    # It received no further setpoints, and needs no reset for that.
    are_between = all(0 < abs(counts) < abs(goals[axis]) for axis, counts in places.items())
    require(are_between, f"without setpoints the axes went to {places}")
    await world.driver.configure()
    axes = (await world.driver.poll()).axes.values()
    require(all(axis.enabled for axis in axes), "an axis without setpoints was disabled")


LOSS_CHECKS: tuple[ContractCheck, ...] = (
    *(
        ContractCheck("the link of a silent controller is closed in time", partial(check_silence, call=call), call)
        for call in ("connect", "configure", "poll", "enable", "home", "arm", "verify", "set_output")
    ),
    *(
        ContractCheck("noise is reported and survived", check_noise, f"seed {seed}", seed, is_long=seed > 1)
        for seed in range(4)
    ),
    ContractCheck("a power cycle is noticed and leaves nothing armed", check_power_cycle),
    ContractCheck("a power cycle while disconnected is noticed once", check_power_cycle_between_connections),
    ContractCheck("connecting does not stop a controller that others move", check_moving_controller),
)
