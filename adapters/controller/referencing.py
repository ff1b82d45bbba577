"""Which axes know where they are: found by homing, forgotten when the controller or the axis loses it."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence

from adapters.contract import CannotDo, Driver, Reading
from adapters.controller.settling import Settling
from adapters.controller.status import Condition
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.messages import HomeReply
from orchestrator.model.state import EventKind


class Referencing:
    """The references of one controller. emit: puts an event; refresh: reads and publishes at once."""

    def __init__(
        self,
        driver: Driver,
        settling: Settling,
        condition: Condition,
        emit: Callable[[EventKind, str], None],
        refresh: Callable[[], Awaitable[None]],
    ) -> None:
        self._driver = driver
        self._settling = settling
        self._condition = condition
        self._emit = emit
        self._refresh = refresh

    async def home(self, axes: Sequence[str]) -> HomeReply:
        """Find the reference of `axes`, all at once. Raises `CannotDo` when nothing was begun, `DriverFault`."""
        condition = self._condition
        condition.require_enabled(axes)
        condition.referenced.update(dict.fromkeys(axes, False))
        condition.homing.update(axes)
        restarts, stopped_ns, homed = condition.restarts, condition.stopped_ns, list[str]()

        def found(name: str) -> None:
            homed.append(name)
            condition.homing.discard(name)
            self._emit("homed", f"axis {name} has found its reference")

        try:
            # An axis that does not know where it is must not be held by limits that mean nothing to it.
            await self.load_limits(axes)
            await self._refresh()
            if condition.stopped_ns != stopped_ns:
                raise CannotDo("stopped", "it was stopped before it began to look for its reference", "home again")
            failed = await self._find(axes, found)
        finally:
            condition.homing.difference_update(axes)
        await self._refresh()
        if condition.reading is None or condition.restarts != restarts:
            raise CannotDo("restarted", "the controller was lost while homing", "home again")
        for name in [name for name in homed if condition.reading.axes[name].lost]:
            homed.remove(name)
            failed[name] = CannotDo("unreferenced", f"axis {name} has lost its position again", "home it again")
        condition.referenced.update(dict.fromkeys(homed, True))
        await self.load_limits(homed)
        for error in failed.values():
            self._emit("refusal", f"home: {error}")
        return HomeReply(homed=homed, failed={name: error.refusal for name, error in failed.items()})

    async def _find(self, axes: Sequence[str], found: Callable[[str], None]) -> dict[str, CannotDo]:
        """Axes that have not found it: those that the driver names, or that still look when the time is over."""
        config = self._condition.config
        longest_s = max(config.axes[name].homing.timeout_s for name in axes)
        try:
            async with asyncio.timeout(longest_s):
                return dict(await self._driver.home(axes, found))
        except TimeoutError:
            left = [name for name in axes if name in self._condition.homing]
            await self._driver.stop(False)
            # Nobody may begin with anything else while these still slow down.
            await self._settling.rest(axes, self._driver.capabilities.costs.stop_ns + NS_PER_S)
            text = f"no reference found within {longest_s:g} s"
            remedy = "look at the home switch, or allow more time (homing.timeout_s)"
            return {name: CannotDo("homing-timeout", f"axis {name}: {text}", remedy) for name in left}

    def look(self, reading: Reading) -> list[str]:
        """A poll: axes that have lost their position just now are not referenced any more."""
        condition = self._condition
        if reading.restarted:
            condition.restarts += 1
            lost = [name for name, known in condition.referenced.items() if known]
            condition.forget_references()
            return lost
        lost = [name for name, now in reading.axes.items() if now.lost and condition.referenced[name]]
        condition.referenced.update(dict.fromkeys(lost, False))
        for name in lost:
            self._emit("unreferenced", f"axis {name} has lost its position and must be homed again")
        return lost

    async def load_limits(self, axes: Sequence[str]) -> None:
        """Load the unit's own soft limits, for axes that know where they are."""
        await self._driver.load_limits(self._condition.limits_counts(axes))
