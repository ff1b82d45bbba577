"""Switching motors with their brakes: open after the motor holds, closed before it lets go."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence

from adapters.contract import Driver
from adapters.controller.settling import Settling
from adapters.controller.status import Condition
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.model.fleet import Axis, Brake


class Motors:
    """The motors of one controller. refresh: read and publish at once."""

    def __init__(
        self,
        driver: Driver,
        clock: Clock,
        condition: Condition,
        settling: Settling,
        refresh: Callable[[], Awaitable[None]],
    ) -> None:
        self._driver = driver
        self._clock = clock
        self._condition = condition
        self._settling = settling
        self._refresh = refresh
        self._turn = asyncio.Lock()

    async def switch(self, axes: Sequence[str], on: bool) -> None:
        """Switch the motors of `axes`; returns when they may move, or are held. Raises `CannotDo`, `DriverFault`."""
        async with self._turn:
            if on:
                await self._switch_on(axes)
            else:
                await self._switch_off(axes)
            await self._refresh()

    async def _switch_on(self, axes: Sequence[str]) -> None:
        brakes = self._brakes(axes)
        self._condition.braked.update(brakes)
        try:
            await self._driver.enable(axes, True)
            await self._set_brakes(brakes, released=True)
            await sleep_ns(self._clock, _longest_ns([brake.release_s for brake in brakes.values()]))
        finally:
            self._condition.braked.difference_update(brakes)

    async def _switch_off(self, axes: Sequence[str]) -> None:
        brakes = self._brakes(axes)
        await self._set_brakes(brakes, released=False)
        await sleep_ns(self._clock, _longest_ns([brake.engage_s for brake in brakes.values()]))
        await self._driver.enable(axes, False)

    async def after_estop(self) -> None:
        """Once everything is at rest, switch off the motors that shall not hold after an e-stop."""
        config = self._condition.config
        letting_go = [name for name, axis in config.axes.items() if axis.on_estop == "disable"]
        stop_ns = self._driver.capabilities.costs.stop_ns + NS_PER_S
        if letting_go and await self._settling.rest(letting_go, stop_ns):
            on = [name for name in letting_go if self._condition.online().axes[name].enabled]
            if on:
                await self.switch(on, False)

    def _brakes(self, axes: Sequence[str]) -> dict[str, Brake]:
        configs: dict[str, Axis] = self._condition.config.axes
        return {name: brake for name in axes if (brake := configs[name].brake) is not None}

    async def _set_brakes(self, brakes: dict[str, Brake], released: bool) -> None:
        for brake in brakes.values():
            if brake.output is not None:
                point = self._condition.config.outputs[brake.output]
                await self._driver.set_output(point.number, released == (point.active == "high"))


def _longest_ns(durations_s: list[float]) -> int:
    return round(max(durations_s, default=0.0) * NS_PER_S)
