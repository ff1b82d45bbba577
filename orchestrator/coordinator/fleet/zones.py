"""The check of what moves against keep-out zones, with the other axes where the fleet's states prove them to be."""

import asyncio
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from orchestrator.bus.base import BusError
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.fleet.zone_reservations import WHOLE_STEP, ZONE_BUSY, ZoneReservations
from orchestrator.model.errors import Refusal
from orchestrator.model.names import split_name
from orchestrator.model.state import ControllerState
from orchestrator.model.zone_problems import list_zone_axes
from orchestrator.plan.homing_order import HomingOrder
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Sweep
from orchestrator.plan.zones.memory import ZoneMemory
from orchestrator.plan.zones.refusals import ZoneRefusal
from orchestrator.plan.zones.rooms import Room


@dataclass(frozen=True, slots=True)
class ZoneMover:
    """What moves axes. holder: of their leases; index: of the step."""

    holder: str
    index: int = WHOLE_STEP


@dataclass(frozen=True, slots=True)
class ZoneGuard:
    """Checks motions of one fleet, and reserves what they sweep. execute: calls the check, which may take longer than a
    message may wait."""

    view: FleetView
    memory: ZoneMemory
    reservations: ZoneReservations
    execute: Executor

    async def require(
        self,
        sweep: Sweep,
        mover: ZoneMover,
        ends: Mapping[str, tuple[Fraction, int]] | None = None,
        execute: Executor | None = None,
    ) -> Box:
        """Raise `Refusal` for what may bring bodies together: code `zone`, or `zone-busy` where a running job has axes
        of the same rules. Reserve what it sweeps, and return where its axes may have stopped shortly before its end.

        sweep: with the positions of those axes that are anywhere between them. ends: as of `query_rest_positions`.
        execute: calls this check.
        """
        moved_axes = {*sweep.profiles, *sweep.adrift}
        if moved_axes.isdisjoint(self.list_axes()):
            return sweep.recent
        fleet, holder = self.view.fleet, mover.holder
        async with self.reservations.lock:
            blockers = self._find_blockers(moved_axes, holder)
            positions = await self._query_positions(moved_axes, holder, ends)
            sweep = replace(sweep, positions={**positions, **sweep.positions})
            try:
                checked_sweep = await (execute or self.execute)(self.memory.require, fleet, sweep)
            except Refusal as refusal:
                raise self._explain(refusal, blockers | self._find_blockers(moved_axes, holder), holder) from None
            self.reservations.reserve(holder, mover.index, checked_sweep.reach, behind=ends is not None)
        return checked_sweep.recent

    async def require_homing(self, order: HomingOrder, holder: str) -> None:
        """Raise `Refusal` (as `require`) for a homing in an order that may bring bodies together; else reserve the
        ranges of its axes."""
        if order.axes.isdisjoint(self.list_axes()):
            return
        async with self.reservations.lock:
            blockers = self._find_blockers(order.axes, holder)
            positions = await self._query_positions((), holder)
            try:
                await self.execute(self.memory.require_homing, self.view.fleet, positions, order)
            except Refusal as refusal:
                raise self._explain(refusal, blockers | self._find_blockers(order.axes, holder), holder) from None
            ranges = self.memory.read(self.view.fleet).ranges
            box = {axis: ranges[axis] for axis in order.axes if axis in ranges}
            self.reservations.reserve(holder, WHOLE_STEP, box)

    def _find_blockers(self, moved: Collection[str], holder: str) -> dict[str, list[str]]:
        """The running jobs that have axes of the same rules as `moved`, and these axes. One that ends while a step is
        checked counts in the check all the same, so that they are asked for before it as well."""
        blockers: dict[str, list[str]] = {}
        for axis in sorted(self.memory.list_related(self.view.fleet, moved)):
            controller, local = split_name(axis)
            state = self.view.last_state(controller)
            owner = holder if state is None else state.leases.get(local, holder)
            if owner != holder and self.reservations.is_job(owner):
                blockers.setdefault(owner, []).append(axis)
        return blockers

    def _explain(self, refusal: Refusal, blockers: Mapping[str, Collection[str]], holder: str) -> Refusal:
        """The refusal of a step; of one that may go on when other jobs have moved or ended, with code `zone-busy`. Jobs
        that have no axis of the rule that refuses it are not in its way."""
        if isinstance(refusal, ZoneRefusal):
            blockers = {owner: axes for owner, axes in blockers.items() if not refusal.axes.isdisjoint(axes)}
        if refusal.code != "zone" or not blockers:
            return refusal
        self.reservations.note_blockers(holder, blockers)
        jobs = ", ".join(f"job {owner} has {', '.join(axes)}" for owner, axes in blockers.items())
        return Refusal(ZONE_BUSY, f"{refusal.text}; {jobs}", refusal.remedy, refusal.controller)

    async def require_search(self, axes: Collection[str], holder: str) -> None:
        """Raise `Refusal` (code `zone`) for axes that would search for their references at the same time."""
        if not set(axes).isdisjoint(self.list_axes()):
            positions = await self._query_positions(axes, holder)
            await self.execute(self.memory.require_search, self.view.fleet, positions, axes)

    async def find_rooms(self, axes: Collection[str], holder: str) -> Mapping[str, Room]:
        """Where axes that are jogged under one lease may be, by axis; those whose positions are not known have none."""
        if set(axes).isdisjoint(self.list_axes()):
            return {}
        async with self.reservations.lock:  # a step that is checked meanwhile is reserved before, or sees the lease
            positions = await self._query_positions((), holder)
            return await self.execute(self.memory.find_rooms, self.view.fleet, positions, axes)

    def list_axes(self) -> list[str]:
        """The real axes on which rules depend."""
        fleet = self.view.fleet
        return [] if fleet.zones is None else list_zone_axes(fleet.zones, fleet)

    async def _query_positions(
        self, moved: Collection[str], holder: str, ends: Mapping[str, tuple[Fraction, int]] | None = None
    ) -> Box:
        """As `query_rest_positions`, of all axes on which rules depend. moved: without these."""
        resting_axes = [name for name in self.list_axes() if name not in moved]
        return await query_rest_positions(self.view, resting_axes, ends or {}, holder, self.reservations)


async def query_rest_positions(
    view: FleetView,
    axes: Collection[str],
    ends: Mapping[str, tuple[Fraction, int]],
    holder: str,
    reservations: ZoneReservations,
) -> Box:
    """The motor positions of axes at rest, in their units. ends: where axes that move now will stand once what is
    planned begins, exact and in counts. holder: of the leases of what is planned.

    Axes that a step of another job may move are anywhere in what it has reserved; between its steps they stand, because
    its next one is checked against what is planned here. Without those of which nothing is known: axes that are
    offline, not referenced, move otherwise, or are leased for manual control, which may move them at any time. The last
    published state may be older than the end of a homing, so that controllers are asked.
    """
    running_jobs = reservations.list_jobs()  # one that ends meanwhile leaves its axes where they stand
    states = await _query_states(view, dict.fromkeys(split_name(name)[0] for name in axes if name not in ends))
    positions: dict[str, tuple[float, float]] = {}
    for name in axes:
        axis, reserved_ends = view.fleet.axis(name), reservations.find_box(name, holder)
        if reserved_ends is not None:
            positions[name] = reserved_ends
            continue
        if name in ends:
            position = axis.to_unit(ends[name][1])
        else:
            controller, local = split_name(name)
            answer = states[controller]
            state = None if answer is None else answer.axes.get(local)
            if answer is None or state is None or not state.referenced or state.moving or state.homing:
                continue
            owner = reservations.find_owner(name) or answer.leases.get(local, holder)
            if owner not in (holder, *running_jobs) and not reservations.is_job(owner):
                continue
            position = float(axis.to_position(state.axis_counts))
        positions[name] = position, position
    return positions


async def _query_states(view: FleetView, controllers: Collection[str]) -> Mapping[str, ControllerState | None]:
    """The states of controllers, as of `_query_state`."""
    answers = await asyncio.gather(*(_query_state(view, controller) for controller in controllers))
    return dict(zip(controllers, answers, strict=True))


async def _query_state(view: FleetView, controller: str) -> ControllerState | None:
    """The state of a controller now; None: it is offline, or does not answer."""
    if view.is_silent(controller):
        return None
    try:
        state = await view.query_state(controller)
    except BusError:
        return None
    return None if state.mode == "offline" else state
