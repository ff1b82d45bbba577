"""Speeds of a move as limits of its axes: a speed along a straight line, or that of the axis that it names."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import hypot

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.steps.base import MotionOptions
from orchestrator.model.steps.speed import MANUAL
from orchestrator.model.units import UnitError, parse_rate
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import AxisMove, StepPlan, plan_step
from orchestrator.plan.virtual_moves import drop_virtual_speeds, limit_virtual_speeds

TOLERANCE = 1e-9  # of a limit: a speed that was rounded


def plan_motion(fleet: Fleet, step: MotionOptions, moves: Sequence[AxisMove]) -> StepPlan:
    """Plan the moves of a step at its speed. Raises `PlanError`."""
    speed = step.speed
    if isinstance(speed, float | int):
        return plan_step(moves, step.sync, speed, step.ramps)
    return plan_step(limit_speeds(fleet, step, moves), step.sync, 1.0, step.ramps)


def limit_speeds(fleet: Fleet, step: MotionOptions, moves: Sequence[AxisMove]) -> list[AxisMove]:
    """The moves of a step with the speed that it states as the limit of each. Raises `PlanError`."""
    speed = step.speed
    if isinstance(speed, float | int):
        return [replace(move, velocity=move.velocity * speed) for move in moves]
    if (limited_moves := limit_virtual_speeds(fleet, step, moves)) is not None:
        if not isinstance(speed, Mapping):
            return limited_moves
        moves, speed = limited_moves, drop_virtual_speeds(fleet, speed)
    if isinstance(speed, Mapping):
        return _limit_named(fleet, speed, moves)
    if speed == MANUAL:
        return [replace(move, velocity=move.velocity * fleet.axis(move.axis).manual_speed) for move in moves]
    return _limit_line(fleet, speed, moves)


def _limit_named(fleet: Fleet, speeds: Mapping[str, float | str], moves: Sequence[AxisMove]) -> list[AxisMove]:
    """The moves with the speeds of the axes that are named; the others keep their limits."""
    names = {move.axis for move in moves}
    strangers = [name for name in speeds if name not in names]
    if strangers:
        raise PlanError(f"speed names {', '.join(strangers)}, which the step does not move")
    limited_moves: list[AxisMove] = []
    for move in moves:
        speed, axis = speeds.get(move.axis, 1.0), fleet.axis(move.axis)
        if isinstance(speed, str):
            limited_moves.append(_limit_axis(move, axis, _parse_speed(speed, axis, move.axis), speed))
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
        limited_moves.append(_limit_axis(move, axis, _parse_speed(speed, axis, move.axis) * share, speed))
    return limited_moves


def _parse_speed(speed: str, axis: Axis, name: str) -> float:
    """A speed in units of the axis per second."""
    try:
        return parse_rate(speed, axis.unit, 1)
    except UnitError as error:
        raise PlanError(f"speed of {name}: {error}") from None


def _limit_axis(move: AxisMove, axis: Axis, speed: float, text: str) -> AxisMove:
    """The move of an axis at most at `speed`, in its unit/s."""
    limit = axis.limits.velocity
    if speed > limit * (1 + TOLERANCE):
        raise PlanError(f"speed {text}: {move.axis} would move at {speed:g} {axis.unit}/s; its limit is {limit:g}")
    return replace(move, velocity=min(move.velocity, move.velocity * speed / limit))
