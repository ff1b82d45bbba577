"""The part of a fleet that a user names: controllers, axes, groups, and modes."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from orchestrator.model.errors import Refusal

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.state import ControllerState


async def select_states(
    tutti: "Tutti", states: "Mapping[str, ControllerState]", names: Sequence[str], modes: Sequence[str]
) -> "dict[str, ControllerState]":
    """The states of what `names` stand for, with those of its axes alone, and in one of `modes`; everything without
    names or modes. A group needs the coordinator, which knows it. Raises `Refusal` for a name that stands for
    nothing."""
    chosen_axes = {f"{controller}.{axis}" for controller, state in states.items() for axis in state.axes}
    if names:
        chosen_axes = {axis for name in names for axis in await _expand_name(tutti, states, name)}
    chosen_states: dict[str, ControllerState] = {}
    for controller, state in states.items():
        axes = {axis: state.axes[axis] for axis in state.axes if f"{controller}.{axis}" in chosen_axes}
        if (axes or not names) and (not modes or state.mode in modes):
            chosen_states[controller] = state.model_copy(update={"axes": axes})
    return chosen_states


async def _expand_name(tutti: "Tutti", states: "Mapping[str, ControllerState]", name: str) -> list[str]:
    from orchestrator.cli.base.names import unknown_name
    from orchestrator.model.names import controller_of
    from orchestrator.model.text.name_patterns import check_pattern, select_names

    try:
        check_pattern(name)
    except ValueError as error:
        raise Refusal("unknown-name", str(error), "see `tutti status`") from None
    axes = [f"{controller}.{axis}" for controller, state in states.items() for axis in state.axes]
    controllers = set(select_names([name], states))
    chosen_axes = [axis for axis in axes if controller_of(axis) in controllers] or select_names([name], axes)
    if chosen_axes:
        return chosen_axes
    groups = (await tutti.list_names()).groups
    chosen_axes = [axis for group in select_names([name], groups) for axis in groups[group]]
    if not chosen_axes:
        raise unknown_name("axis, group or controller", name, [*axes, *states, *groups])
    return chosen_axes
