"""Where the axes are that keep-out zones depend on, as far as the fleet's states prove it."""

import asyncio
from collections.abc import Collection, Mapping
from fractions import Fraction

from orchestrator.bus.base import BusError
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.names import split_name
from orchestrator.model.state import ControllerState
from orchestrator.plan.zones.chain import Box


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
