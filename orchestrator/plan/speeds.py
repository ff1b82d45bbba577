"""Speeds of a move as limits of its axes: a speed along a straight line, or that of the axis that it names."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.linear_map import CorrectedMap, LinearMap
from orchestrator.model.steps.base import MotionOptions
from orchestrator.model.steps.speed import MANUAL
from orchestrator.model.units import Unit, UnitError, parse_rate
from orchestrator.plan.racks import require_racks
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove, StepPlan, plan_step
from orchestrator.plan.virtual_moves import group_virtual

TOLERANCE = 1e-9  # of a limit: a speed that was rounded
LEAST_TIME_S = 1e-9  # a way that takes less is only the rounding to counts


def plan_motion(fleet: Fleet, step: MotionOptions, moves: Sequence[AxisMove]) -> StepPlan:
    """Plan the moves of a step at its speed. Raises `PlanError`, `Refusal` for motors that may be too far apart."""
    speed = step.speed
    if isinstance(speed, float | int):
        plan = plan_step(moves, step.sync, speed, step.ramps)
    else:
        plan = plan_step(limit_speeds(fleet, step, moves), step.sync, 1.0, step.ramps)
    require_racks(fleet, plan)
    return plan


def limit_speeds(fleet: Fleet, step: MotionOptions, moves: Sequence[AxisMove]) -> list[AxisMove]:
    """The moves of a step with the speed that it states as the limit of each. Raises `PlanError`."""
    speed = step.speed
    if isinstance(speed, float | int):
        return [replace(move, velocity=move.velocity * speed) for move in moves]
    if speed == MANUAL:
        return [replace(move, velocity=move.velocity * fleet.axis(move.axis).manual_speed) for move in moves]
    owners = _find_owners(fleet, step)
    if owners and owners.keys() >= set(step.named_axes).intersection(fleet.names.virtual):
        return _limit_named(fleet, step, _name_owners(step, speed, owners, moves), moves)
    distances = _find_virtual_distances(fleet, step, moves)
    if isinstance(speed, Mapping):
        moves = _limit_together(moves, _find_virtual_duration(fleet, speed, distances))
        speeds = {name: value for name, value in speed.items() if name not in distances}
        return _limit_named(fleet, step, speeds, moves)
    units = {fleet.unit_of(name) for name in distances}
    if len(units) == 1 and len(distances) == len(step.named_axes):
        length = hypot(*distances.values())
        return _limit_together(moves, length / _parse_speed(speed, units.pop(), next(iter(distances))))
    return _limit_line(fleet, speed, moves)


def _find_owners(fleet: Fleet, step: MotionOptions) -> dict[str, str]:
    """By corrected axis that a step names, its own real axis, whose speed it has."""
    maps = (fleet.virtual_axes.maps[group] for group in group_virtual(fleet, step))
    pairs = [
        pair for axes in maps if isinstance(axes, CorrectedMap) for pair in zip(axes.virtual, axes.real, strict=True)
    ]
    return {name: real for name, real in pairs if name in step.named_axes}


def _name_owners(
    step: MotionOptions, speed: Mapping[str, float | str] | str, owners: Mapping[str, str], moves: Sequence[AxisMove]
) -> dict[str, float | str]:
    """The speeds of a step by real axis, with those that stand for corrected ones: each axis moves in its own time."""
    speeds = speed if isinstance(speed, Mapping) else dict.fromkeys(step.named_axes, speed)
    moved_axes = {move.axis for move in moves}
    return {
        owners.get(name, name): value
        for name, value in speeds.items()
        if name not in owners or owners[name] in moved_axes
    }


def _find_virtual_distances(fleet: Fleet, step: MotionOptions, moves: Sequence[AxisMove]) -> dict[str, float]:
    """How far the virtual axes that a step names go, in their units; without those of which a real axis is missing, as
    its beginning is not known."""
    distances: dict[str, float] = {}
    for group, names in group_virtual(fleet, step).items():
        ways = {
            move.axis: float((move.target_counts - move.start_counts) / fleet.axis(move.axis).counts_per_unit)
            for move in moves
        }
        virtual_map = fleet.virtual_axes.maps[group]
        if not all(axis in ways for axis in virtual_map.real):
            continue
        if not isinstance(virtual_map, LinearMap):
            _require_no_speed(step, names)
            continue
        for name, row in zip(virtual_map.virtual, virtual_map.rows, strict=True):
            if name in names:
                distances[name] = sum(part * ways[axis] for part, axis in zip(row, virtual_map.real, strict=True))
    return distances


def _require_no_speed(step: MotionOptions, names: Sequence[str]) -> None:
    """Raise `PlanError` for a speed of a curved virtual axis, which differs along its way."""
    speed = step.speed
    is_stated = any(name in speed for name in names) if isinstance(speed, Mapping) else isinstance(speed, str)
    if is_stated and speed != MANUAL:
        text = f"speed of {names[0]}: it differs along a curve; give a fraction of the limits, or the speed of its real"
        raise PlanError(f"{text} axis in a mapping")


def _find_virtual_duration(fleet: Fleet, speeds: Mapping[str, float | str], distances: Mapping[str, float]) -> float:
    """How long the ways of virtual axes take at least at the speeds that are stated for them, s."""
    least_s = 0.0
    for name, distance in distances.items():
        speed = speeds.get(name)
        if isinstance(speed, str):
            least_s = max(least_s, abs(distance) / _parse_speed(speed, fleet.unit_of(name), name))
        elif speed is not None:
            raise PlanError(f"speed of {name}: a virtual axis has no limit of its own; give a speed with its unit")
    return least_s


def _limit_together(moves: Sequence[AxisMove], least_s: float) -> list[AxisMove]:
    """The moves with no axis faster than its whole way in `least_s`: on a straight line that limits all alike."""
    limited_moves: list[AxisMove] = []
    for move in moves:
        distance = abs(move.target_counts - move.start_counts)
        velocity = distance / least_s if least_s > LEAST_TIME_S and distance else move.velocity
        if velocity > move.velocity * (1 + TOLERANCE):
            share = velocity / move.velocity
            raise PlanError(f"{move.axis} would move at {share:.3g} times its velocity limit; lower the speed")
        limited_moves.append(replace(move, velocity=min(move.velocity, velocity)))
    return limited_moves


def _limit_named(
    fleet: Fleet, step: MotionOptions, speeds: Mapping[str, float | str], moves: Sequence[AxisMove]
) -> list[AxisMove]:
    """The moves with the speeds of the axes that are named; the others keep their limits. One that stands at its target
    already is not among the moves, nor is one whose beginning a forecast does not know."""
    names = {move.axis for move in moves}.union(fleet.find_real_axes(step.named_axes))
    strangers = [name for name in speeds if name not in names]
    if strangers:
        raise PlanError(f"speed names {', '.join(strangers)}, which the step does not move")
    limited_moves: list[AxisMove] = []
    for move in moves:
        speed, axis = speeds.get(move.axis, 1.0), fleet.axis(move.axis)
        if isinstance(speed, str):
            limited_moves.append(_limit_axis(move, axis, _parse_speed(speed, axis.unit, move.axis), speed))
        else:
            limited_moves.append(replace(move, velocity=move.velocity * speed))
    return limited_moves


def _limit_line(fleet: Fleet, speed: str, moves: Sequence[AxisMove]) -> list[AxisMove]:
    """The moves with a speed along the straight line that their axes make."""
    axes = {move.axis: fleet.axis(move.axis) for move in moves}
    moves_in_motion = [move for move in moves if move.start_counts != move.target_counts]
    units = {axes[move.axis].unit for move in moves_in_motion}
    if len(units) > 1:
        example = f"{{{moves_in_motion[0].axis}: {speed}}}"
        raise PlanError(f"speed {speed}: the axes have different units; name the axis whose speed it is: {example}")
    distances = {
        move.axis: abs(move.target_counts - move.start_counts) / abs(float(axes[move.axis].counts_per_unit))
        for move in moves_in_motion
    }
    length = hypot(*distances.values())
    limited_moves: list[AxisMove] = []
    for move in moves:
        if move.axis not in distances:
            limited_moves.append(move)
            continue
        axis = axes[move.axis]
        share = distances[move.axis] / length
        limited_moves.append(_limit_axis(move, axis, _parse_speed(speed, axis.unit, move.axis) * share, speed))
    return limited_moves


def _parse_speed(speed: str, unit: Unit, name: str) -> float:
    """A speed in units of an axis per second."""
    try:
        return parse_rate(speed, unit, 1)
    except UnitError as error:
        raise PlanError(f"speed of {name}: {error}") from None


def _limit_axis(move: AxisMove, axis: Axis, speed: float, text: str) -> AxisMove:
    """The move of an axis at most at `speed`, in its unit/s."""
    limit = axis.limits.velocity
    if speed > limit * (1 + TOLERANCE):
        raise PlanError(f"speed {text}: {move.axis} would move at {speed:g} {axis.unit}/s; its limit is {limit:g}")
    return replace(move, velocity=min(move.velocity, move.velocity * speed / limit))
