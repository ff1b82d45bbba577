"""Short power cuts: a controller that loses power for a moment while a motion is commanded does not start after
power-up, because it has other speeds and another origin then."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from functools import partial

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.conformance.findings import require
from orchestrator.conformance.worlds import Case, World, run_case

OFF_NS = 20 * NS_PER_MS
# After the motion was commanded; the longest commands take most of a second.
CUT_MOMENTS_NS = [k * 47 * NS_PER_MS + k % 7 * 370 * NS_PER_US for k in range(18)]

CommandedMotion = Callable[[World], Awaitable[None]]


async def command_jog(world: World) -> None:
    """Jog the first axis."""
    axis = world.axis(world.axes[0])
    velocity, acceleration = (float(limit * axis.scale) for limit in (axis.limits.velocity, axis.limits.acceleration))
    end = world.case.base_counts + world.case.short_counts // 2
    await world.manual.jog_axis(world.axes[0], JogMove(-velocity / 4, acceleration / 2, end))


async def command_homing(world: World) -> None:
    """Home all axes."""
    await world.driver.home_axes(world.axes, lambda _: None)


async def command_step(world: World) -> None:
    """Run a short step."""
    await world.move(world.short_targets(1))


COMMANDED: Mapping[str, CommandedMotion] = {"jog": command_jog, "home": command_homing, "step": command_step}


def check_power_cuts(case: Case, act: CommandedMotion, moments_ns: Sequence[int]) -> None:
    """Cut the power at each of the moments, in a run of its own. Raises `ContractBroken`."""
    begun_motions: dict[int, list[str]] = {}
    refusals: list[bool] = []

    async def cut_power(world: World, moment_ns: int) -> None:
        await world.ready()
        await world.move(world.short_targets(3))
        command = asyncio.ensure_future(act(world))
        await sleep_ns(world.clock, moment_ns)
        world.hit.controller.set_power(on=False)
        await sleep_ns(world.clock, OFF_NS)
        back_ns = world.clock.now_ns()
        world.hit.controller.set_power(on=True)
        await sleep_ns(world.clock, 3 * NS_PER_S)
        began = [motion for unit, motion in world.motions if unit is world.hit and motion.start_ns >= back_ns]
        if began:
            begun_motions[moment_ns] = [
                f"{motion.axis}: {motion.start_counts} to {motion.end_counts}" for motion in began
            ]
        refusals.append(command.done() and command.exception() is not None)
        command.cancel()
        with suppress(BaseException):
            await command

    for moment_ns in moments_ns:
        run_case(case, partial(cut_power, moment_ns=moment_ns))
    require(not begun_motions, f"motions began after power-up, by the ns from the command to the cut: {begun_motions}")
    require(any(refusals), "no command that a power cut interrupted has failed")
