"""A controller that loses power for a moment while a motion is commanded does not start after power-up: it has other
speeds and another origin then. Every make and link, at many moments of each kind of motion."""

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import suppress
from functools import partial

import pytest
from adapter_worlds import CASES, World, run

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns

OFF_NS = 20 * NS_PER_MS
MOMENTS_NS = [k * 47 * NS_PER_MS + k % 7 * 370 * NS_PER_US for k in range(18)]  # the longest takes most of a second


async def jog(world: World) -> None:
    axis = world.axis(world.axes[0])
    velocity, acceleration = (float(limit * axis.scale) for limit in (axis.limits.velocity, axis.limits.acceleration))
    await world.driver.jog_axis(world.axes[0], JogMove(-velocity / 4, acceleration / 2, 500))


async def home(world: World) -> None:
    await world.driver.home_axes(world.axes, lambda _: None)


async def step(world: World) -> None:
    await world.move(dict.fromkeys(world.axes, 1000.0))


@pytest.mark.parametrize(
    "moments_ns",
    [
        MOMENTS_NS[::4],
        *(pytest.param(MOMENTS_NS[first::4], marks=pytest.mark.nightly) for first in (1, 2, 3)),
    ],
    ids=["", "more", "still more", "all others"],
)
@pytest.mark.parametrize("name", CASES)
@pytest.mark.parametrize("act", [jog, home, step])
def test_a_short_power_cut_while_a_motion_is_commanded(
    name: str, act: Callable[[World], Coroutine[None, None, None]], moments_ns: list[int]
) -> None:
    begun: dict[int, list[str]] = {}
    refused: list[bool] = []

    async def main(world: World, moment_ns: int) -> None:
        await world.ready()
        await world.move(dict.fromkeys(world.axes, 3000.0))
        moving = asyncio.ensure_future(act(world))
        await sleep_ns(world.clock, moment_ns)
        world.hit.controller.set_power(on=False)
        await sleep_ns(world.clock, OFF_NS)
        back_ns = world.clock.now_ns()
        world.hit.controller.set_power(on=True)
        await sleep_ns(world.clock, 3 * NS_PER_S)
        began = [each for unit, each in world.motions if unit is world.hit and each.start_ns >= back_ns]
        if began:
            begun[moment_ns] = [f"{each.axis}: {each.start_counts} to {each.end_counts}" for each in began]
        refused.append(moving.done() and moving.exception() is not None)
        moving.cancel()
        with suppress(BaseException):
            await moving

    for moment_ns in moments_ns:
        run(name, partial(main, moment_ns=moment_ns))
    assert not begun
    assert any(refused)
