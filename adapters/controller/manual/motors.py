"""Switching of motors with brakes: a brake opens after its motor has torque, and closes before the motor loses
torque."""

import asyncio
from collections.abc import Sequence

from adapters.abilities import set_output
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.fleet import Axis, HoldingBrake


class MotorControl:
    """The motors of one controller. polling: reads the controller and publishes at once."""

    def __init__(
        self,
        context: ControllerContext,
        status: ControllerStatus,
        settling: SettlingMonitor,
        polling: StatePolling,
    ) -> None:
        self._driver = context.driver
        self._clock = context.clock
        self._status = status
        self._settling = settling
        self._polling = polling
        self._switch_lock = asyncio.Lock()

    async def switch_motors(self, axes: Sequence[str], *, on: bool) -> None:
        """Switch the motors of `axes`; return when they may move, or when the brakes are closed. Raises `Refusal`,
        `ControllerFault`."""
        async with self._switch_lock:
            if on:
                await self._switch_on(axes)
            else:
                await self._switch_off(axes)
            await self._polling.poll_and_publish()

    async def _switch_on(self, axes: Sequence[str]) -> None:
        brakes = self._configured_brakes(axes)
        self._status.braked.update(brakes)
        try:
            await self._driver.set_enabled(axes, on=True)
            await self._set_brakes(brakes, released=True)
            await sleep_ns(self._clock, _longest_ns([brake.release_s for brake in brakes.values()]))
        finally:
            self._status.braked.difference_update(brakes)

    async def _switch_off(self, axes: Sequence[str]) -> None:
        brakes = self._configured_brakes(axes)
        await self._set_brakes(brakes, released=False)
        await sleep_ns(self._clock, _longest_ns([brake.engage_s for brake in brakes.values()]))
        await self._driver.set_enabled(axes, on=False)

    async def switch_off_after_estop(self) -> None:
        """Switch off, once everything is at rest, the motors that must not keep torque after an e-stop."""
        config = self._status.config
        letting_go = [name for name, axis in config.axes.items() if axis.on_estop == "disable"]
        stop_ns = self._driver.capabilities.costs.stop_ns + NS_PER_S
        if letting_go and await self._settling.wait_for_rest(letting_go, stop_ns):
            on = [name for name in letting_go if self._status.require_online().axes[name].enabled]
            if on:
                await self.switch_motors(on, on=False)

    def _configured_brakes(self, axes: Sequence[str]) -> dict[str, HoldingBrake]:
        configs: dict[str, Axis] = self._status.config.axes
        return {name: brake for name in axes if (brake := configs[name].brake) is not None}

    async def _set_brakes(self, brakes: dict[str, HoldingBrake], *, released: bool) -> None:
        for brake in brakes.values():
            if brake.output is not None:
                point = self._status.config.outputs[brake.output]
                await set_output(self._driver, point.number, on=released == (point.active == "high"))


def _longest_ns(durations_s: list[float]) -> int:
    return round(max(durations_s, default=0.0) * NS_PER_S)
