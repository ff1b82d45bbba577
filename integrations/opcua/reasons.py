"""Why an axis does not move. It knows no protocol library."""

from tutti import AxisState


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
