"""Manual control: leases for operators, which expire unless renewed.

Most end when a permit is lost. A reservation for work at the machine does not: an operator that opens a door to work
inside must not find a job moving when the door is closed. Reservations are in the journal and survive a restart of
the coordinator; only the right to move ends then.
"""

import asyncio
from collections.abc import Coroutine
from datetime import datetime, timedelta
from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.jog_rooms import JogRooms
from orchestrator.coordinator.fleet.lease_states import LeaseHold, LeaseUser
from orchestrator.coordinator.fleet.leases import LeaseRegistry
from orchestrator.coordinator.fleet.permits import PermitWatch
from orchestrator.coordinator.fleet.zones import ZoneGuard
from orchestrator.coordinator.journal.facts import Reservation
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import MAX_MANUAL_LEASE_S, AcquireAxes, AxesAcquired
from orchestrator.model.queue import format_utc, parse_utc


class ManualLeases:
    """Grants axes for manual control, and ends the right to move them when it may no longer be used."""

    def __init__(
        self, fleet: FleetAccess, leases: LeaseRegistry, journal: JournalStore, execute: Executor, zones: ZoneGuard
    ) -> None:
        self._fleet = fleet
        self._rooms = JogRooms(zones, leases)
        leases.find_rooms = self._rooms.find
        zones.reservations.find_owner = leases.find_owner
        self._leases = leases
        self._journal = journal
        self._execute = execute
        self._guards: dict[str, PermitWatch] = {}
        self._reserved: set[str] = set()
        self._lost = asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()

    async def start(self) -> None:
        """Restore reservations. Raises `JournalError`."""
        utc, now_ns = parse_utc(self._fleet.clock.utc()), self._fleet.clock.now_ns()
        for reservation in await self._execute(self._journal.list_reservations):
            left_s = self._find_rest_s(reservation, utc)
            axes = tuple(axis for axis in reservation.axes if self._fleet.view.fleet.has_axis(axis))
            if left_s <= 0 or not axes:
                await self._execute(self._journal.delete_reservation, reservation.holder)
                continue
            self._reserved.add(reservation.holder)
            until_ns = now_ns + round(left_s * NS_PER_S)
            self._leases.restore_reservation(
                LeaseHold(reservation.holder, reservation.actor, reservation.what, axes, until_ns)
            )
        self._fleet.permits.add_loss_listener(self._lost.set)
        self._leases.add_release_listener(self._on_release)
        self._spawn(self._watch_permits())

    def _find_rest_s(self, reservation: Reservation, now: datetime) -> float:
        """How long a reservation lasts. One with a damaged end lasts: a person may be inside the machine."""
        try:
            return (parse_utc(reservation.until_utc) - now).total_seconds()
        except ValueError:
            problem = f"its end {reservation.until_utc!r} in the journal is damaged"
            self._fleet.log.warning(f"axes stay reserved by {reservation.actor} until they are released: {problem}")
            return MAX_MANUAL_LEASE_S

    def close(self) -> None:
        for task in self._tasks:
            task.cancel()

    async def acquire(self, request: AcquireAxes) -> AxesAcquired:
        """Acquire axes for manual control, or renew the lease. Raises `Refusal`, `UnknownName`, `JournalError`."""
        axes = self._fleet.view.fleet.expand_names(request.axes)
        missing_permit = self._fleet.permits.find_missing(axes)
        if missing_permit is not None and not request.reserve:
            raise Refusal("permit", missing_permit, "satisfy the permit, then acquire the axes again")
        ttl_ns = round(request.ttl_s * NS_PER_S)
        idle = missing_permit is not None
        user = LeaseUser(request.holder, request.actor, request.what)
        hold = await self._leases.acquire(user, axes, ttl_ns, idle=idle)
        if request.holder in self._guards:
            self._spawn(self._rooms.renew(hold, request.holder))
        if request.reserve:
            await self._record_reservation(request, hold)
        if request.holder not in self._guards:
            self._guards[request.holder] = self._fleet.permits.watch_losses(axes)
        return AxesAcquired(axes=list(hold), may_move=self._leases.may_move(request.holder))

    def find_reserved(self) -> dict[str, str]:
        """The axes that are reserved for work at the machine, each with the reason in words."""
        return {
            axis: f"reserved by {held_lease.actor}: {held_lease.what}"
            for held_lease in self._leases.all_leases
            if held_lease.holder in self._reserved
            for axis in held_lease.axes
        }

    async def _record_reservation(self, request: AcquireAxes, axes: tuple[str, ...]) -> None:
        end_utc = parse_utc(self._fleet.clock.utc()) + timedelta(seconds=request.ttl_s)
        values = (request.holder, request.actor, request.what, axes, format_utc(end_utc))
        self._reserved.add(request.holder)
        try:
            await self._execute(self._journal.store_reservation, *values)
        except JournalError:
            await self._leases.release(request.holder)
            raise

    def _on_release(self, holder: str) -> None:
        self._guards.pop(holder, None)
        self._rooms.forget(holder)
        if holder in self._reserved:
            self._reserved.discard(holder)
            self._spawn(self._delete_reservation(holder))

    async def _delete_reservation(self, holder: str) -> None:
        try:
            await self._execute(self._journal.delete_reservation, holder)
        except JournalError as error:
            self._fleet.log.warning(
                f"the reservation that {holder} released will be back after a restart: {error}", holder=holder
            )

    async def _watch_permits(self) -> None:
        while True:
            await self._lost.wait()
            self._lost.clear()
            holders = {held_lease.holder for held_lease in self._leases.all_leases}
            self._guards = {holder: guard for holder, guard in self._guards.items() if holder in holders}
            ends = {
                holder: reason
                for holder, guard in self._guards.items()
                if (reason := guard.describe_loss()) is not None
            }
            for holder in ends:
                del self._guards[holder]
            await asyncio.gather(*(self._end_lease(holder, reason) for holder, reason in ends.items()))

    async def _end_lease(self, holder: str, why: str) -> None:
        if holder in self._reserved:
            await self._leases.suspend_motion(holder, why)
        else:
            await self._leases.release(holder, why)

    def _spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        task = self._fleet.tasks.spawn(coroutine, vital=True)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
