"""What differs between two states of a controller, and how soon it is published."""

from enum import Enum

from orchestrator.model.state import RESTING_MODES, AxisState, ControllerState

_AT_ONCE = (
    "instance",
    "mode",
    "inputs",
    "outputs",
    "faults",
    "estop",
    "epoch",
    "digest",
    "job",
    "step",
    "leases",
)
_AXIS_AT_ONCE = ("offset", "unit", "moving", "homing", "enabled", "referenced", "limit", "fault")


class StateChange(Enum):
    """How a state differs from the one before."""

    NONE = "none"
    """In its instants alone."""
    GRADUAL = "gradual"
    """In positions, or of a controller that works: published with those of the others."""
    AT_ONCE = "at once"


def find_change(before: ControllerState | None, state: ControllerState) -> StateChange:
    """How `state` differs from the state that was published last. That of a controller that works or is leased always
    counts as changed, so that its readings are complete."""
    if before is None or any(getattr(before, name) != getattr(state, name) for name in _AT_ONCE):
        return StateChange.AT_ONCE
    if before.axes != state.axes and any(
        _differs_at_once(axis, state.axes[name]) for name, axis in before.axes.items()
    ):
        return StateChange.AT_ONCE
    if state.mode not in RESTING_MODES or state.leases:
        return StateChange.GRADUAL
    is_same = before.axes == state.axes and before.event_seq == state.event_seq
    return StateChange.NONE if is_same else StateChange.GRADUAL


def _differs_at_once(before: AxisState, axis: AxisState) -> bool:
    return any(getattr(before, name) != getattr(axis, name) for name in _AXIS_AT_ONCE)


def has_new_reading(before: ControllerState, state: ControllerState) -> bool:
    """Whether the controller was read since `before` was seen, as far as that is known; if not, its age is the news."""
    return state.mode == "offline" or state.read_fleet_ns is None or state.read_fleet_ns != before.read_fleet_ns
