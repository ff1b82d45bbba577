"""Checks of stops: moves that must not start, motions that must end, and jogs."""

import contextlib
from functools import partial

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.conformance.checks import ContractCheck, follow_to_end, require_step
from orchestrator.conformance.findings import require
from orchestrator.conformance.worlds import World
from orchestrator.model.errors import Refusal

ON_THE_LINE_NS = 100 * NS_PER_MS  # for bytes that were on the line before a stop


async def check_disarm(world: World, stage: str) -> None:
    """Disarm a move after a stage of its step."""
    await world.ready()
    positions_before = world.positions()
    lowered_step, t0_ns = await world.arm(await world.plan(world.targets()))
    if stage != "arm":
        await world.driver.slots.present.verify()
    if stage == "go":
        await world.driver.slots.present.release()
    await world.until(min(t0_ns - lowered_step.costs.disarm_ns, world.clock.now_ns() + 30 * NS_PER_MS))
    await world.driver.slots.unload()
    await world.driver.slots.unload()
    await world.until(t0_ns + 3 * NS_PER_S)
    require(world.positions() == positions_before and world.at_rest, "a disarmed move has started")
    await require_step(world)


async def check_nothing_without_go(world: World) -> None:
    """An armed move without its release."""
    await world.ready()
    positions_before = world.positions()
    _, t0_ns = await world.arm(await world.plan(world.targets()))
    await world.driver.slots.present.verify()
    await world.until(t0_ns + 3 * NS_PER_S)
    require(world.positions() == positions_before, "an armed move has started without `go`")
    await world.driver.slots.unload()
    await require_step(world)


async def check_stop(world: World, when_ms: int) -> None:
    """Stop, by ramp and by abort, some time before or after T0."""
    await world.ready()
    for abort, factor in ((False, 1.0), (True, -0.4)):
        lowered_step, t0_ns = await world.arm(await world.plan(world.targets(4)))
        await world.driver.slots.present.verify()
        await world.driver.slots.present.release()
        following = world.start_task(follow_to_end(world))
        await world.until(max(world.clock.now_ns(), t0_ns + when_ms * NS_PER_MS))
        await world.driver.stop(abort=abort)
        await sleep_ns(world.clock, lowered_step.costs.stop_ns)
        require(world.at_rest, f"an axis still moves {lowered_step.costs.stop_ns} ns after the stop, the declared time")
        rests = world.positions()
        await following
        await world.until(max(world.clock.now_ns(), t0_ns) + 2 * NS_PER_S)
        require(world.positions() == rests, "an axis has moved after the stop")
        await world.driver.clear_faults()
        await world.driver.set_enabled(world.axes, on=True)
        await world.poll(5)
        await require_step(world, factor)


async def check_stop_of_homing(world: World, when_ms: int) -> None:
    """Stop a homing some time after it was commanded."""
    await world.ready()
    references: list[str] = []
    failures: dict[str, Refusal] = {}

    async def search() -> None:
        with contextlib.suppress(Refusal):
            failures.update(await world.driver.home_axes(world.axes, references.append))
            every = sorted([*references, *failures])
            require(every == sorted(world.axes), f"homing returned for the axes {every}, not for {world.axes}")

    searching = world.start_task(search())
    await sleep_ns(world.clock, when_ms * NS_PER_MS + 1)
    if searching.done():
        return  # a drive whose reference is its present position
    stopped_ns = world.clock.now_ns()
    await world.driver.stop(abort=False)
    await searching
    await sleep_ns(world.clock, 3 * NS_PER_S)
    require(world.at_rest, "an axis still moves after homing was stopped")
    # Bytes that were on the line before the stop may still start a motion, which the stop after them ends.
    late_motions = [motion for _, motion in world.motions if motion.start_ns > stopped_ns + ON_THE_LINE_NS]
    require(not late_motions, f"a search began after the stop: {late_motions}")
    await world.driver.clear_faults()
    await world.driver.set_enabled(world.axes, on=True)
    await world.poll(5)
    new_failures = await world.driver.home_axes(world.axes, references.append)
    require(not new_failures, f"homing after a stop failed: {new_failures}")


async def check_jog(world: World) -> None:
    """A jog to its end, and a jog of all axes of which one is stopped."""
    await world.ready()
    axis, *other_axes = world.axes
    config = world.axis(axis)
    speed, ramp = config.limits.velocity * float(config.scale) / 4, config.limits.acceleration * float(config.scale)
    end = round(speed)
    await world.manual.jog_axis(axis, JogMove(speed, ramp, end))
    fastest = 0.0
    for _ in range(300):
        await sleep_ns(world.clock, 10 * NS_PER_MS)
        fastest = max(fastest, abs(world.velocity(axis)))
        require(world.position(axis) <= end, f"a jog went to {world.position(axis)}, beyond its end {end}")
    # As fast as its crystal is.
    require(0.8 * speed < fastest <= speed * (1 + 1e-4), f"the jog had {fastest:g} counts/s, requested {speed:g}")
    require(world.position(axis) == end, f"the jog ended at {world.position(axis)}, not at {end}")
    await world.manual.jog_axis(axis, JogMove(-speed, ramp, None))
    try:
        for other_axis in other_axes:
            await world.manual.jog_axis(other_axis, JogMove(speed, ramp, None))
    except Refusal as error:
        require(not world.case.jogs_together, f"a second axis cannot be jogged: {error}")
        other_axes = []
    await sleep_ns(world.clock, 300 * NS_PER_MS)
    await world.manual.stop_axes([axis])
    await sleep_ns(world.clock, 400 * NS_PER_MS)
    require(not world.moving(axis), f"{axis} still jogs after `stop_axes`")
    require(
        all(world.moving(other_axis) for other_axis in other_axes), "`stop_axes` of one axis has stopped another one"
    )
    await world.driver.stop(abort=False)
    await world.rest(world.driver.capabilities.costs.stop_ns)
    await world.poll(3)
    await require_step(world)


STOP_CHECKS: tuple[ContractCheck, ...] = (
    *(
        ContractCheck("a disarmed move never starts", partial(check_disarm, stage=stage), f"after {stage}")
        for stage in ("arm", "verify", "go")
    ),
    ContractCheck("nothing starts without go", check_nothing_without_go),
    *(
        ContractCheck(
            "a stop at any moment stops all in the declared time",
            partial(check_stop, when_ms=when_ms),
            f"{when_ms} ms after T0",
            seed=when_ms,
            is_long=when_ms in (-60, 90),
        )
        for when_ms in (-400, -10, 3, 400, -60, 90)
    ),
    *(
        ContractCheck(
            "a stop at any moment ends a homing or prevents its start",
            partial(check_stop_of_homing, when_ms=when_ms),
            f"after {when_ms} ms",
            seed=when_ms,
            is_long=when_ms in (1, 9, 25, 70),
        )
        for when_ms in (0, 4, 16, 40, 130, 1, 9, 25, 70)
    ),
    ContractCheck("a jog keeps to its speed and its end", check_jog),
)
