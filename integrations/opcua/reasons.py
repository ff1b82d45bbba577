"""Why an axis, or the fleet, does not move. It knows no protocol library."""

from collections.abc import Mapping

from tutti import AxisState, ControllerState


def find_axis_reason(mode: str, state: AxisState) -> str:
    """Why an axis cannot be moved to a position; empty if nothing is known against it. mode: of its controller."""
    if mode == "offline":
        return "its controller is offline"
    if state.fault:
        return state.fault
    if mode == "fault":
        return "its controller has a fault"
    if not state.enabled:
        return "its motor is off"
    if not state.referenced:
        return "it is not referenced; home it"
    return "" if state.limit == "none" else f"it stands at a limit switch: {state.limit}"


def is_latched(states: Mapping[str, ControllerState]) -> bool:
    """Whether an e-stop is latched anywhere."""
    return any(state.estop is not None for state in states.values())


def describe_fleet(states: Mapping[str, ControllerState]) -> str:
    """`e-stop`, `offline`, `fault`, `moving` or `idle`: the first that is true of any controller."""
    modes = {state.mode for state in states.values()}
    if is_latched(states):
        return "e-stop"
    for mode in ("offline", "fault"):
        if mode in modes:
            return mode
    return "moving" if modes - {"idle"} else "idle"
