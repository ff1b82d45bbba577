"""Virtual axes as a table."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.monitor.tables import make_plain_table

if TYPE_CHECKING:
    from rich.console import RenderableType


def make_virtual_table(states: Mapping[str, VirtualState]) -> "RenderableType":
    """Build a table with one row per virtual axis: where it is, how well that is known, and why it is not ready."""
    table = make_plain_table(["virtual", "of", "axis", "position>", "within>", "velocity>", "axis is"], ["axis is"])
    for group, state in states.items():
        for index, (axis, axis_now) in enumerate(state.axes.items()):
            width = max(axis_now.high - axis_now.position, axis_now.position - axis_now.low)
            table.add_row(
                group if index == 0 else "",
                ", ".join(state.of) if index == 0 else "",
                axis,
                f"{axis_now.position:,.4f} {axis_now.unit}",
                f"±{width:,.4f}",
                f"{axis_now.velocity:,.2f} /s",
                "moving" if state.moving else state.obstacle or "ready",
            )
        if not state.axes:
            table.add_row(group, ", ".join(state.of), "-", "-", "-", "-", state.obstacle)
    return table
