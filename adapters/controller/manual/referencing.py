"""Referenced state of axes: gained by homing, dropped when the controller or the axis loses its position."""

import asyncio
from collections.abc import Callable, Sequence

from adapters.abilities import LimitDriver
from adapters.contract import ControllerReading, Driver
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.monitoring.settling import SettlingMonitor
from adapters.controller.publishing.publisher import StatePublisher
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import HomeReply, RefusalDetails


class AxisReferencing:
    """The references of one controller.

    polling: reads the controller and publishes at once.
    """

    def __init__(
        self,
        driver: Driver,
        settling: SettlingMonitor,
        status: ControllerStatus,
        publisher: StatePublisher,
        polling: StatePolling,
    ) -> None:
        self._driver = driver
        self._settling = settling
        self._status = status
        self._publisher = publisher
        self._polling = polling

    async def home_axes(self, axes: Sequence[str]) -> HomeReply:
        """Find the reference of `axes`, all simultaneously. Raises `Refusal` when no axis began, `ControllerFault`."""
        status = self._status
        status.require_enabled(axes)
        status.referenced.update(dict.fromkeys(axes, False))
        status.homing.update(axes)
        restarts, stopped_ns, homed_axes = status.restarts, status.stopped_ns, list[str]()

        def report_found(name: str) -> None:
            homed_axes.append(name)
            status.homing.discard(name)
            self._publisher.emit_event("homed", f"axis {name} has found its reference")

        try:
            # Soft limits are meaningless for an axis whose position is unknown, and must not restrict it.
            await self.load_soft_limits(axes)
            await self._polling.poll_and_publish()
            if status.stopped_ns != stopped_ns:
                raise Refusal("stopped", "the controller was stopped before homing began", "home again")
            failures = await self._search_references(axes, report_found)
        finally:
            status.homing.difference_update(axes)
        await self._polling.poll_and_publish()
        if status.reading is None or status.restarts != restarts:
            raise Refusal("restarted", "the connection to the controller was lost while homing", "home again")
        for name in [name for name in homed_axes if status.reading.axes[name].position_lost]:
            homed_axes.remove(name)
            failures[name] = Refusal("unreferenced", f"axis {name} has lost its position again", "home it again")
        status.referenced.update(dict.fromkeys(homed_axes, True))
        await self.load_soft_limits(homed_axes)
        for error in failures.values():
            self._publisher.emit_event("refusal", f"home: {error}")
        return HomeReply(homed=homed_axes, failed={name: RefusalDetails.of(error) for name, error in failures.items()})

    async def _search_references(self, axes: Sequence[str], found: Callable[[str], None]) -> dict[str, Refusal]:
        """Return the axes without a reference: those that the driver reports, or that are still searching at the
        timeout."""
        config = self._status.config
        longest_s = max(config.axes[name].homing.timeout_s for name in axes)
        try:
            async with asyncio.timeout(longest_s):
                return dict(await self._driver.home_axes(axes, found))
        except TimeoutError:
            axes_left = [name for name in axes if name in self._status.homing]
            await self._driver.stop(abort=False)
            # No other motion may begin while these axes still decelerate.
            await self._settling.wait_for_rest(axes, self._driver.capabilities.costs.stop_ns + NS_PER_S)
            text = f"no reference found within {longest_s:g} s"
            remedy = "check the home switch, or allow more time (homing.timeout_s)"
            return {name: Refusal("homing-timeout", f"axis {name}: {text}", remedy) for name in axes_left}

    def handle_reading(self, reading: ControllerReading) -> list[str]:
        """Handle a poll: drop the reference of axes that have just lost their position, and return these axes."""
        status = self._status
        if reading.restarted:
            status.restarts += 1
            lost_axes = [name for name, is_known in status.referenced.items() if is_known]
            status.forget_references()
            return lost_axes
        lost_axes = [
            name
            for name, axis_reading in reading.axes.items()
            if axis_reading.position_lost and status.referenced[name]
        ]
        status.referenced.update(dict.fromkeys(lost_axes, False))
        for name in lost_axes:
            self._publisher.emit_event("unreferenced", f"axis {name} has lost its position and must be homed again")
        return lost_axes

    async def load_soft_limits(self, axes: Sequence[str]) -> None:
        """Load the controller's own soft limits, for axes with a known position."""
        if isinstance(self._driver, LimitDriver):
            await self._driver.load_soft_limits(self._status.limits_counts(axes))
