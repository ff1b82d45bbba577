"""The axes of a fleet as they are now, where a forecast begins."""

from collections.abc import Mapping

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.forecast import AxisForecast
from orchestrator.model.names import split_name
from orchestrator.model.state import ControllerState


def look_at_axes(fleet: Fleet, states: Mapping[str, ControllerState]) -> dict[str, AxisForecast]:
    """All axes as they are now; those of silent controllers are unknown."""
    axes: dict[str, AxisForecast] = {}
    for name in fleet.axis_names:
        controller, local = split_name(name)
        state = states.get(controller)
        axis_now = None if state is None or state.mode == "offline" else state.axes.get(local)
        if axis_now is not None:
            axis = fleet.axis(name)
            axes[name] = AxisForecast(
                motor=axis.to_position(axis_now.axis_counts),
                known=True,
                offset=axis_now.offset,
                enabled=axis_now.enabled or axis.enable != "manual",
                referenced=axis_now.referenced,
                play=axis_now.play,
            )
    return axes
