"""What keeps a step from its start or its end: a stop, or what has happened to its drive."""

from adapters.cia402.canopen import states
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.sdo import bus_off_fault
from adapters.cia402.canopen.states import DriveState
from adapters.cia402.step import DriveStep
from orchestrator.model.errors import ControllerFault


def is_interrupted(node: BusDrive, move: DriveStep) -> bool:
    """Return whether the step was stopped, or cannot continue."""
    return move.stopped_ns is not None or bool(failure_text(node, move))


def failure_text(node: BusDrive, move: DriveStep) -> str:
    """Return what has happened to the drive since it was armed; empty: nothing."""
    if node.boots != move.boots:
        return "was switched off and on"
    if node.bus.is_off or node.left_bus != move.left:
        return "was unreachable: this computer has left the bus (bus-off)"
    if node.state in (DriveState.FAULT, DriveState.REACTION):
        return f"has a fault: {node.fault_text()}"
    if move.streamed_move is not None and move.streamed_move.failure:
        return move.streamed_move.failure
    if move.lowered.target is not None and not node.is_enabled:
        return f"is {node.state.value}: was it switched off by its enable input, or stopped by another master?"
    if move.lowered.target is not None and node.status & states.INTERNAL_LIMIT:
        return "was stopped by its own limit (switch or software limit)"
    return ""


def not_started_fault(node: BusDrive, move: DriveStep, *, said: bool) -> ControllerFault:
    """Return the fault of a step that has not begun. said: the drive has accepted it."""
    if node.bus.is_off or move.left != node.left_bus:
        return bus_off_fault(node.name)
    reason = "has not accepted its set-point with the SYNC" if not said else failure_text(node, move) or "does not move"
    return ControllerFault(
        "not-started",
        f"{node.name} {reason}; it is {node.state.value}" + (f": {node.fault_text()}" if node.emergencies else ""),
        "check the cable and both terminations; is another master on the bus?",
    )
