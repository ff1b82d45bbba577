"""What is wrong with a controller, in one word: for views of many controllers, which name those alone."""

from typing import Literal

from orchestrator.model.state import ControllerState

Trouble = Literal["silent", "offline", "fault", "e-stop", "limit"]
TROUBLES: tuple[Trouble, ...] = ("fault", "offline", "silent", "limit", "e-stop")
"""In the order in which they are shown: what is of one controller before what is of all."""


def find_trouble(state: ControllerState) -> Trouble | None:
    """The trouble of a state; None: it is sound. `silent` is said of a state by its age, which it does not have."""
    if state.mode == "offline":
        return "offline"
    if state.faults or state.mode == "fault":
        return "fault"
    if any(axis.limit != "none" for axis in state.axes.values()):
        return "limit"
    return "e-stop" if state.estop is not None else None
