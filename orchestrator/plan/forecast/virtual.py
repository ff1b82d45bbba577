"""Targets of virtual axes in a forecast: those of the real axes that they stand for."""

from collections.abc import Sequence
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.numbers import name_step
from orchestrator.plan.corrected import bound_ends, find_followers, require_no_offset
from orchestrator.plan.forecast.context import ForecastContext, TargetField
from orchestrator.plan.forecast.state import ForecastState
from orchestrator.plan.forecast.targets import take_target
from orchestrator.plan.forecast.ways import MoveWays
from orchestrator.plan.virtual_moves import find_virtual_names, find_virtual_targets, group_virtual, require_apart


def take_virtual_targets(state: ForecastState, at: ForecastContext, ways: MoveWays, step: Move) -> bool:
    """Move the real axes of all virtual ones that a step names, and add their ways; whether that is possible."""
    if not find_virtual_names(state.fleet, step):
        return True
    try:
        require_apart(state.fleet, step)
    except Refusal as error:
        state.add_problem(at, (), error)
        return False
    problems = len(state.problems)
    for group, names in group_virtual(state.fleet, step).items():
        field = ("by" if names[0] in step.by else "to", names[0])
        targets = _find_targets(state, at, step, group, field)
        if targets is None:
            ways.add_unknown(None)
            continue
        state.followers |= dict.fromkeys(find_followers(state.fleet, group, names), group)
        for name, target in targets.items():
            take_target(state, at, ways, TargetField("to", name, state.fleet.axis(name), field), target)
    state.bounds |= bound_ends(state.fleet, step, state.bounds)
    return len(state.problems) == problems


def _find_targets(
    state: ForecastState, at: ForecastContext, step: Move, group: str, place: tuple[str, str]
) -> dict[str, Fraction] | None:
    """Where the real axes of a group go, user positions; None where that is not known, or a problem. place: of its
    first virtual axis in the step."""
    real_axes = state.fleet.virtual_axes.maps[group].real
    for name in real_axes:
        state.require_ready(at, name, place)
    try:
        offsets = {
            name: axis.offset for name in real_axes if (axis := state.find_state(at, name)).offset_kind != "unknown"
        }
        require_no_offset(state.fleet, group, dict.fromkeys(real_axes, Fraction(0)) | offsets)
        targets = find_virtual_targets(state.fleet, step, group, find_positions(state, at, real_axes))
    except Refusal as error:
        state.add_problem(at, place, error)
        return None
    if targets is None:
        condition = f"the targets of {', '.join(real_axes)} in {name_step(at.index)} depend on where they stand"
        state.conditions[condition] = None
        state.lose_positions(at, real_axes)
    return targets


def find_positions(state: ForecastState, at: ForecastContext, axes: Sequence[str]) -> list[Fraction] | None:
    """User positions of axes; None unless all are known."""
    states = [state.find_state(at, name) for name in axes]
    if not all(axis.known and axis.offset_kind != "unknown" for axis in states):
        return None
    return [axis.motor + axis.offset for axis in states]
