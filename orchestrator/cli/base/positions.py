"""Positions of axes in words, and for programs: what a command answers."""

from collections.abc import Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.model.operation.virtual_state import VirtualAxisState, VirtualState
    from orchestrator.model.state import AxisState, ControllerState


def describe_positions(states: "Mapping[str, ControllerState]", axes: Collection[str] | None = None) -> str:
    """`gantry.x 120.000 mm, gantry.y 0.000 mm`: of `axes`, or of all; without those of controllers that are offline."""
    return ", ".join(
        f"{name} {state_now.position:.3f} {state_now.unit}" for name, state_now in _select_axes(states, axes)
    )


def list_positions(states: "Mapping[str, ControllerState]", axes: Collection[str]) -> dict[str, dict[str, Any]]:
    """The same for programs."""
    return {
        name: {
            "position": state_now.position,
            "unit": state_now.unit,
            "enabled": state_now.enabled,
            "referenced": state_now.referenced,
        }
        for name, state_now in _select_axes(states, axes)
    }


def describe_virtual_positions(states: "Mapping[str, VirtualState]", axes: Collection[str]) -> str:
    """`slit.gap 5.000 mm`: of those of `axes` that are virtual."""
    return ", ".join(
        f"{name} {state_now.position:.3f} {state_now.unit}" for name, _, state_now in _select_virtual(states, axes)
    )


def list_virtual_positions(states: "Mapping[str, VirtualState]", axes: Collection[str]) -> dict[str, dict[str, Any]]:
    """The same for programs."""
    return {
        name: {
            "position": state_now.position,
            "unit": state_now.unit,
            "enabled": group.enabled,
            "referenced": group.referenced,
        }
        for name, group, state_now in _select_virtual(states, axes)
    }


def _select_virtual(
    states: "Mapping[str, VirtualState]", axes: Collection[str]
) -> "Iterator[tuple[str, VirtualState, VirtualAxisState]]":
    for group in states.values():
        for axis, state_now in group.axes.items():
            if f"{group.group}.{axis}" in axes:
                yield f"{group.group}.{axis}", group, state_now


def _select_axes(
    states: "Mapping[str, ControllerState]", axes: Collection[str] | None
) -> "Iterator[tuple[str, AxisState]]":
    for controller, state in states.items():
        for axis, state_now in state.axes.items() if state.mode != "offline" else ():
            if axes is None or f"{controller}.{axis}" in axes:
                yield f"{controller}.{axis}", state_now
