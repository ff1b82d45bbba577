"""The check of what moves against keep-out zones, with the other axes where the fleet's states prove them to be."""

import asyncio
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction

from orchestrator.bus.base import BusError
from orchestrator.clock.executor import Executor
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.names import split_name
from orchestrator.model.state import ControllerState
from orchestrator.model.zone_problems import list_zone_axes
from orchestrator.plan.homing_order import HomingOrder
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Sweep
from orchestrator.plan.zones.memory import ZoneMemory
from orchestrator.plan.zones.rooms import Room


@dataclass(frozen=True, slots=True)
class ZoneGuard:
    """Checks motions of one fleet. execute: calls the check, which may take longer than a message may wait."""

    view: FleetView
    memory: ZoneMemory
    execute: Executor

    async def require(
        self,
        sweep: Sweep,
        holder: str,
        ends: Mapping[str, tuple[Fraction, int]] | None = None,
        execute: Executor | None = None,
    ) -> Box:
        """Raise `Refusal` (code `zone`) for what may bring bodies together; return where its axes may have stopped
        shortly before its end.

        sweep: with the positions of those axes that are anywhere between them. holder, ends: as of
        `query_rest_positions`. execute: calls this check.
        """
        moved_axes = {*sweep.profiles, *sweep.adrift}
        if moved_axes.isdisjoint(self.list_axes()):
            return sweep.recent
        positions = await self._query_positions(moved_axes, holder, ends)
        sweep = replace(sweep, positions={**positions, **sweep.positions})
        return await (execute or self.execute)(self.memory.require, self.view.fleet, sweep)

    async def require_homing(self, order: HomingOrder, holder: str) -> None:
        """Raise `Refusal` (code `zone`) for a homing in an order that may bring bodies together."""
        if not order.axes.isdisjoint(self.list_axes()):
            positions = await self._query_positions((), holder)
            await self.execute(self.memory.require_homing, self.view.fleet, positions, order)

    async def require_search(self, axes: Collection[str], holder: str) -> None:
        """Raise `Refusal` (code `zone`) for axes that would search for their references at the same time."""
        if not set(axes).isdisjoint(self.list_axes()):
            positions = await self._query_positions(axes, holder)
            await self.execute(self.memory.require_search, self.view.fleet, positions, axes)

    async def find_rooms(self, axes: Collection[str], holder: str) -> Mapping[str, Room]:
        """Where axes that are jogged under one lease may be, by axis; those whose positions are not known have none."""
        if set(axes).isdisjoint(self.list_axes()):
            return {}
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
        return await query_rest_positions(self.view, resting_axes, ends or {}, holder)


async def query_rest_positions(
    view: FleetView, axes: Collection[str], ends: Mapping[str, tuple[Fraction, int]], holder: str
) -> Box:
    """The motor positions of axes at rest, in their units. ends: where axes that move now will stand once what is
    planned begins, exact and in counts. holder: of the leases of what is planned.

    Without those of which nothing is known: axes that are offline, not referenced, move, or are leased by another
    holder, which may move them at any time. The last published state may be older than the end of a homing, so that
    controllers are asked.
    """
    controllers = list(dict.fromkeys(split_name(name)[0] for name in axes if name not in ends))
    answers = await asyncio.gather(*(_query_state(view, controller) for controller in controllers))
    states = dict(zip(controllers, answers, strict=True))
    positions: dict[str, tuple[float, float]] = {}
    for name in axes:
        axis = view.fleet.axis(name)
        if name in ends:
            position = axis.to_unit(ends[name][1])
        else:
            controller, local = split_name(name)
            answer = states[controller]
            state = None if answer is None else answer.axes.get(local)
            if answer is None or state is None or not state.referenced or state.moving or state.homing:
                continue
            if answer.leases.get(local, holder) != holder:
                continue
            position = float(axis.to_position(state.axis_counts))
        positions[name] = position, position
    return positions


async def _query_state(view: FleetView, controller: str) -> ControllerState | None:
    """The state of a controller now; None: it is offline, or does not answer."""
    if view.is_silent(controller):
        return None
    try:
        state = await view.query_state(controller)
    except BusError:
        return None
    return None if state.mode == "offline" else state
