"""What the stream shows of a controller: its state, with limits and targets beside each axis."""

from collections.abc import Mapping
from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.gateway.stream.merge_patch import drop_nulls
from orchestrator.model.fleet import Controller
from orchestrator.model.state import AxisState, ControllerState
from orchestrator.model.units import parse_quantity

DIGITS = 6  # after the point: nanometres of a mm axis
STALE_NS = NS_PER_S  # a state that is older is shown with its age


def find_age_s(age_ns: int) -> int:
    """The age of a state as it is shown: whole seconds, 0 up to a second."""
    return age_ns // NS_PER_S if age_ns > STALE_NS else 0


def show_controller(state: ControllerState, config: Controller | None, targets: Mapping[str, float]) -> dict[str, Any]:
    """The controller for the stream. config: of the fleet file; None: not in it. targets: of its axes, by name."""
    shown_controller: dict[str, Any] = {
        "mode": state.mode,
        "epoch": state.epoch,
        "digest": state.digest,
        "inputs": state.inputs,
        "outputs": state.outputs,
        "faults": [drop_nulls(fault.to_plain()) for fault in state.faults],
        "axes": {name: _show_axis(name, axis, config, targets.get(name)) for name, axis in state.axes.items()},
    }
    if state.job is not None:
        shown_controller["job"] = state.job
    if state.step is not None:
        shown_controller["step"] = state.step
    if state.estop is not None:
        shown_controller["estop"] = state.estop.to_plain()
    if state.clock is not None:
        # In whole seconds: an age that is other in every state would be half of the stream.
        age_ns = state.clock.age_ns // NS_PER_S * NS_PER_S
        shown_controller["clock"] = {"bound_ns": state.clock.bound_ns, "age_ns": age_ns, "samples": state.clock.samples}
    if config is not None:
        shown_controller["make"] = config.adapter
    return shown_controller


def _show_axis(name: str, axis: AxisState, config: Controller | None, target: float | None) -> dict[str, Any]:
    shown_axis: dict[str, Any] = {
        "position": round(axis.position, DIGITS),
        "commanded": round(axis.commanded, DIGITS),
        "velocity": round(axis.velocity, DIGITS),
        "unit": axis.unit,
        "moving": axis.moving,
        "homing": axis.homing,
        "enabled": axis.enabled,
        "referenced": axis.referenced,
        "limit": axis.limit,
        "offset": str(axis.offset),
    }
    if axis.fault is not None:
        shown_axis["fault"] = axis.fault
    if target is not None:
        shown_axis["target"] = round(target, DIGITS)
    known_axis = None if config is None else config.axes.get(name)
    if known_axis is not None:
        shown_axis["max_velocity"] = known_axis.limits.velocity
        shown_axis["manual_speed"] = float(known_axis.manual_speed)
        shown_axis["jog_velocity"] = known_axis.jog_speed(referenced=axis.referenced)
        if known_axis.soft_limits is not None and known_axis.turn_length is None:
            # Soft limits are motor positions.
            for end, limit in (("min", known_axis.soft_limits.min), ("max", known_axis.soft_limits.max)):
                shown_axis[end] = round(float(parse_quantity(limit, known_axis.unit) + axis.offset), DIGITS)
    return shown_axis
