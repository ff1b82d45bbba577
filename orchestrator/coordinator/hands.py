"""Axes in people's hands: leases that run out when nobody renews them, and end when a permit is lost."""

import asyncio

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.leases import LeaseBook
from orchestrator.coordinator.permits import Guard, Permits
from orchestrator.coordinator.steps import expand
from orchestrator.coordinator.targets import Refuse
from orchestrator.coordinator.view import FleetView
from orchestrator.model.service import Take


class Hands:
    """Gives axes to people, and takes them back when they may not be moved any more."""

    def __init__(self, view: FleetView, leases: LeaseBook, permits: Permits) -> None:
        self._view = view
        self._leases = leases
        self._permits = permits
        self._guards: dict[str, Guard] = {}
        self._lost = asyncio.Event()
        self._watching: asyncio.Task[None] | None = None

    def start(self) -> None:
        self._permits.listen(self._lost.set)
        self._watching = asyncio.get_running_loop().create_task(self._watch())

    def close(self) -> None:
        if self._watching is not None:
            self._watching.cancel()

    async def take(self, request: Take) -> tuple[str, ...]:
        """Take axes in hand, or go on holding them. Raises `Refuse`, `UnknownName`."""
        axes = expand(self._view.fleet, request.axes)
        missing = self._permits.missing(axes)
        if missing is not None:
            raise Refuse("permit", missing, "bring it about, then take them again")
        held = await self._leases.take(
            request.holder, request.actor, request.what, axes, round(request.ttl_s * NS_PER_S)
        )
        if request.holder not in self._guards:
            self._guards[request.holder] = self._permits.guard(axes)
        return held

    async def _watch(self) -> None:
        while True:
            await self._lost.wait()
            self._lost.clear()
            holders = {held.holder for held in self._leases.held}
            self._guards = {holder: guard for holder, guard in self._guards.items() if holder in holders}
            ends = {holder: why for holder, guard in self._guards.items() if (why := guard.lost()) is not None}
            for holder in ends:
                del self._guards[holder]
            await asyncio.gather(*(self._leases.give_back(holder, why) for holder, why in ends.items()))
