"""Axes in people's hands: leases that run out when nobody renews them.

Most end when a permit is lost. What somebody has reserved for work at the machine does not: who opens the door to work
there must not find a job moving when it is closed. It is in the journal, and stands when a coordinator starts anew;
only the right to move is gone then.
"""

import asyncio
from collections.abc import Coroutine
from datetime import timedelta
from typing import Any

from orchestrator.bus.log import Log
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.executor import Runs
from orchestrator.coordinator.fleet.leases import Held, LeaseBook
from orchestrator.coordinator.fleet.permits import Guard, Permits
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.jobs.steps import expand
from orchestrator.coordinator.journal.journal import Journal, JournalError
from orchestrator.coordinator.motion.targets import Refuse
from orchestrator.model.queue import format_utc, parse_utc
from orchestrator.model.service import Take, Taken


class Hands:
    """Gives axes to people, and takes them back when they may not be moved any more."""

    def __init__(
        self,
        view: FleetView,
        leases: LeaseBook,
        permits: Permits,
        clock: Clock,
        journal: Journal,
        runs: Runs,
        log: Log,
    ) -> None:
        self._view = view
        self._leases = leases
        self._permits = permits
        self._clock = clock
        self._journal = journal
        self._runs = runs
        self._log = log
        self._guards: dict[str, Guard] = {}
        self._reserved: set[str] = set()
        self._lost = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Go on with what is reserved. Raises `JournalError`."""
        now, now_ns = parse_utc(self._clock.utc()), self._clock.now_ns()
        for each in await self._runs(self._journal.reserved):
            left_s = (parse_utc(each.until_utc) - now).total_seconds()
            axes = tuple(axis for axis in each.axes if axis in self._view.fleet.axis_names)
            if left_s <= 0 or not axes:
                await self._runs(self._journal.unreserve, each.holder)
                continue
            self._reserved.add(each.holder)
            until_ns = now_ns + round(left_s * NS_PER_S)
            self._leases.restore(Held(each.holder, each.actor, each.what, axes, until_ns))
        self._permits.listen(self._lost.set)
        self._leases.listen(self._given_back)
        self._spawn(self._watch())

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()

    async def take(self, request: Take) -> Taken:
        """Take axes in hand, or go on holding them. Raises `Refuse`, `UnknownName`, `JournalError`."""
        axes = expand(self._view.fleet, request.axes)
        missing = self._permits.missing(axes)
        if missing is not None and not request.reserve:
            raise Refuse("permit", missing, "bring it about, then take them again")
        ttl_ns = round(request.ttl_s * NS_PER_S)
        idle = missing is not None
        held = await self._leases.take(request.holder, request.actor, request.what, axes, ttl_ns, idle=idle)
        if request.reserve:
            await self._reserve(request, held)
        if request.holder not in self._guards:
            self._guards[request.holder] = self._permits.guard(axes)
        return Taken(axes=list(held), may_move=self._leases.may_move(request.holder))

    async def _reserve(self, request: Take, axes: tuple[str, ...]) -> None:
        until = parse_utc(self._clock.utc()) + timedelta(seconds=request.ttl_s)
        values = (request.holder, request.actor, request.what, axes, format_utc(until))
        self._reserved.add(request.holder)
        try:
            await self._runs(self._journal.reserve, *values)
        except JournalError:
            await self._leases.give_back(request.holder)
            raise

    def _given_back(self, holder: str) -> None:
        self._guards.pop(holder, None)
        if holder in self._reserved:
            self._reserved.discard(holder)
            self._spawn(self._unreserve(holder))

    async def _unreserve(self, holder: str) -> None:
        try:
            await self._runs(self._journal.unreserve, holder)
        except JournalError as error:
            self._log.warning(f"what {holder} gave back is reserved again after a restart: {error}", holder=holder)

    async def _watch(self) -> None:
        while True:
            await self._lost.wait()
            self._lost.clear()
            holders = {held.holder for held in self._leases.held}
            self._guards = {holder: guard for holder, guard in self._guards.items() if holder in holders}
            ends = {holder: why for holder, guard in self._guards.items() if (why := guard.lost()) is not None}
            for holder in ends:
                del self._guards[holder]
            await asyncio.gather(*(self._end(holder, why) for holder, why in ends.items()))

    async def _end(self, holder: str, why: str) -> None:
        if holder in self._reserved:
            await self._leases.suspend(holder, why)
        else:
            await self._leases.give_back(holder, why)

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = asyncio.get_running_loop().create_task(coroutine)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
