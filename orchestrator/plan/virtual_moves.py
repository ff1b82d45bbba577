"""Moves of virtual axes: the targets and speeds of the real axes that they stand for.

A move of virtual axes is one of their real axes on a straight line (`sync: phase`), on which every virtual position
changes in proportion as well. Virtual axes of a group that the step does not name keep their positions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from math import hypot
from typing import TypeVar

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.steps.base import MotionOptions
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.move import Move
from orchestrator.model.units import Unit, UnitError, parse_quantity, parse_rate
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove

LEAST_TIME_S = 1e-9
"""A way that takes less is only the rounding to counts."""


def find_virtual_names(fleet: Fleet, step: Motion) -> list[str]:
    """The virtual axes that a motion names."""
    names = fleet.names.virtual
    return [name for name in step.named_axes if name in names] if names else []


MotionT = TypeVar("MotionT", bound=Motion)


def straighten(fleet: Fleet, step: MotionT) -> MotionT:
    """The step as it is planned: one of virtual axes goes along a straight line of its real axes."""
    return step.model_copy(update={"sync": "phase"}) if find_virtual_names(fleet, step) else step


def require_apart(fleet: Fleet, step: Move) -> None:
    """Raise `Refusal` for a step that moves a real axis twice, or in which virtual axes cannot go straight."""
    virtual_names = find_virtual_names(fleet, step)
    if virtual_names and step.sync == "none":
        text = f"`sync: none` would move {virtual_names[0]} and its group elsewhere on the way"
        raise Refusal("bad-step", text, "leave `sync` out: virtual axes move on a straight line")
    movers: dict[str, str] = {}
    for name in step.named_axes:
        owner = split_name(name)[0] if name in virtual_names else name
        for axis in fleet.find_real_axes([name]):
            mover = movers.setdefault(axis, owner)
            if mover != owner:
                text = f"axis {axis} would be moved by {mover} and by {owner}"
                raise Refusal("bad-step", text, "name only one of them, or make two steps", controller_of(axis))


def group_virtual(fleet: Fleet, step: Motion) -> dict[str, list[str]]:
    """The virtual axes that a motion names, by group."""
    groups: dict[str, list[str]] = {}
    for name in find_virtual_names(fleet, step):
        groups.setdefault(split_name(name)[0], []).append(name)
    return groups


def find_virtual_targets(
    fleet: Fleet, step: Move, group: str, positions: Sequence[Fraction] | None
) -> dict[str, Fraction] | None:
    """Where the real axes of a group go: user positions in their units; None if that depends on where they stand.

    positions: user positions of its real axes now, in order; None: unknown. Raises `Refusal`.
    """
    virtual_map = fleet.virtual_axes.maps[group]
    virtual_positions = None if positions is None else virtual_map.to_virtual(positions)
    targets: list[Fraction] = []
    for number, name in enumerate(virtual_map.virtual):
        position = None if virtual_positions is None else virtual_positions[number]
        if name in step.to:
            targets.append(_parse_amount(fleet, name, step.to[name]))
        elif position is None:
            return None
        else:
            targets.append(position + (_parse_amount(fleet, name, step.by[name]) if name in step.by else 0))
        if name in step.to or name in step.by:
            beyond_limits = fleet.virtual_axes.explain_beyond_limits(name, targets[-1])
            if beyond_limits is not None:
                raise Refusal("soft-limit", beyond_limits, "change the target, or the soft limits in the fleet file")
    return dict(zip(virtual_map.real, virtual_map.to_real(targets), strict=True))


def _parse_amount(fleet: Fleet, name: str, value: int | float | str) -> Fraction:
    try:
        return parse_quantity(value, fleet.unit_of(name))
    except UnitError as error:
        raise Refusal("bad-unit", f"{name}: {error}", "correct the unit") from None


# Speeds


def limit_virtual_speeds(fleet: Fleet, step: MotionOptions, moves: Sequence[AxisMove]) -> list[AxisMove] | None:
    """The moves with a speed of virtual axes as the limits of their real ones; None where the step states none.

    A speed with a unit is that along the line of the virtual axes that the step names; in a mapping, that of the axis.
    Raises `PlanError`.
    """
    speed = step.speed
    distances = {name: distance for name, distance in _find_distances(fleet, moves).items() if name in step.named_axes}
    if not distances or isinstance(speed, float | int):
        return None
    if not isinstance(speed, Mapping):
        units = {fleet.unit_of(name) for name in distances}
        if speed == "manual" or len(units) > 1 or len(distances) < len(step.named_axes):
            return None
        unit = next(iter(units))
        length = hypot(*distances.values())
        return _limit_together(moves, length / _parse_speed(speed, unit, next(iter(distances))))
    least_s = 0.0
    for name, value in speed.items():
        if name not in distances:
            continue
        if not isinstance(value, str):
            raise PlanError(f"speed of {name}: a virtual axis has no limit of its own; give a speed with its unit")
        least_s = max(least_s, abs(distances[name]) / _parse_speed(value, fleet.unit_of(name), name))
    return _limit_together(moves, least_s)


def drop_virtual_speeds(fleet: Fleet, speeds: Mapping[str, float | str]) -> dict[str, float | str]:
    """The speeds of real axes among those that a step states."""
    return {name: speed for name, speed in speeds.items() if name not in fleet.names.virtual}


def _find_distances(fleet: Fleet, moves: Sequence[AxisMove]) -> dict[str, float]:
    """How far virtual axes go, in their units, for the groups whose real axes all move."""
    ways = {
        move.axis: float((move.target_counts - move.start_counts) / fleet.axis(move.axis).counts_per_unit)
        for move in moves
    }
    distances: dict[str, float] = {}
    for virtual_map in fleet.virtual_axes.maps.values():
        if not all(axis in ways for axis in virtual_map.real):
            continue
        for name, row in zip(virtual_map.virtual, virtual_map.matrix, strict=True):
            distances[name] = sum(float(part) * ways[axis] for part, axis in zip(row, virtual_map.real, strict=True))
    return distances


def _limit_together(moves: Sequence[AxisMove], least_s: float) -> list[AxisMove]:
    """The moves with no axis faster than its whole way in `least_s`: on a straight line that limits all alike."""
    limited_moves: list[AxisMove] = []
    for move in moves:
        distance = abs(move.target_counts - move.start_counts)
        velocity = distance / least_s if least_s > LEAST_TIME_S and distance else move.velocity
        if velocity > move.velocity * (1 + 1e-9):
            share = velocity / move.velocity
            raise PlanError(f"{move.axis} would move at {share:.3g} times its velocity limit; lower the speed")
        limited_moves.append(replace(move, velocity=min(move.velocity, velocity)))
    return limited_moves


def _parse_speed(speed: str, unit: Unit, name: str) -> float:
    try:
        return parse_rate(speed, unit, 1)
    except UnitError as error:
        raise PlanError(f"speed of {name}: {error}") from None
