"""The state of one axis, asked for when it matters: a published one may be older than what was just set."""

from orchestrator.bus.base import BusError
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.names import split_name
from orchestrator.model.state import AxisState


async def require_axis(view: FleetView, axis: str) -> AxisState:
    """The state of `controller.axis` as of now. Raises `Refusal`."""
    controller, name = split_name(axis)
    try:
        state = await view.query_state(controller)
    except BusError as error:
        raise view.make_absence(controller, str(error)) from None
    if state.mode == "offline":
        raise view.make_absence(controller, "it is offline")
    return state.axes[name]
