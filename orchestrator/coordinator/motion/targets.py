"""Convert the targets of a move, in units, to counts for the planner."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from fractions import Fraction

from orchestrator.model.compensation import Play
from orchestrator.model.errors import NOT_REFERENCED, Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.report import PositionBound
from orchestrator.model.state import AxisState, ControllerInfo
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.corrected import bound_ends, require_no_offset
from orchestrator.plan.path_step import PathStart
from orchestrator.plan.play import (
    MotorWay,
    bound_position,
    choose_approach,
    explain_overrun,
    find_motor_way,
    require_play,
)
from orchestrator.plan.step import AxisMove, ExactTargets
from orchestrator.plan.targets import choose_turn, explain_beyond_limits, make_axis_move
from orchestrator.plan.virtual_moves import find_virtual_names, find_virtual_targets, group_virtual, require_apart


@dataclass(frozen=True, slots=True)
class ResolvedMove:
    """A move in counts, with the exact targets that the counts were rounded from.

    take_ups: motions before it, by which motors take up play. overruns: the targets of axes that go beyond them first,
    by a motion of their own. bounds: how far axes may be from their targets. plays: how far they are ahead of their
    motors at the end.
    """

    moves: list[AxisMove]
    exact: dict[str, tuple[Fraction, int]]
    take_ups: list[AxisMove] = field(default_factory=list[AxisMove])
    overruns: dict[str, Fraction] = field(default_factory=dict[str, Fraction])
    bounds: dict[str, PositionBound] = field(default_factory=dict[str, PositionBound])
    plays: dict[str, Play] = field(default_factory=dict[str, Play])

    @property
    def goal(self) -> dict[str, Fraction]:
        """The exact targets of the whole step."""
        return {axis: target for axis, (target, _) in self.exact.items()} | self.overruns


@dataclass(frozen=True, slots=True)
class AxisContext:
    """What targets are resolved with. states: by axis. infos: by controller. targets: exact earlier targets."""

    fleet: Fleet
    states: Mapping[str, AxisState]
    infos: Mapping[str, ControllerInfo]
    targets: ExactTargets

    def find_position(self, name: str) -> Fraction:
        """The motor position of an axis, exact where it was moved to an exact target."""
        axis, state = self.fleet.axis(name), self.states[name]
        return self.targets.exact_position(name, state.commanded_counts, axis.to_position(state.axis_counts))


def resolve_targets(step: Move, context: AxisContext, goal: Mapping[str, Fraction]) -> ResolvedMove:
    """Absolute counts for all axes of `step`, checked against referenced, enabled and soft limits.

    goal: the exact targets from before a feed hold. Raises `Refusal`.
    """
    require_play(context.fleet, step)
    resolved_move = ResolvedMove([], {})
    for name, target in _iterate_targets(step, context, goal):
        axis, state = context.fleet.axis(name), context.states[name]
        counts = axis.to_target_counts(target)
        beyond_limits = explain_beyond_limits(name, axis, target, state.offset)
        if beyond_limits is not None:
            remedy = "change the target, or the soft limits in the fleet file"
            raise Refusal("soft-limit", beyond_limits, remedy, controller_of(name))
        way = find_motor_way(axis, state.commanded_counts, state.play, counts, choose_approach(axis, step.approach))
        beyond_overrun = explain_overrun(name, axis, way, float(state.offset))
        if beyond_overrun is not None:
            raise beyond_overrun
        _add_way(resolved_move, name, context, target, way)
    resolved_move.bounds.update(bound_ends(context.fleet, step, resolved_move.bounds))
    return resolved_move


def _add_way(resolved: ResolvedMove, name: str, context: AxisContext, target: Fraction, way: MotorWay) -> None:
    axis, order = context.fleet.axis(name), max(context.infos[controller_of(name)].orders)
    limits = axis.motor_limits_counts
    move = replace(make_axis_move(name, axis, way.start, way.target, order), soft_limits=limits)
    resolved.exact[name] = (target, way.target)
    slow = None if axis.backlash is None else axis.backlash.speed
    slowly = move.velocity if slow is None else slow * float(axis.scale)
    if way.is_overrun:
        ahead_counts = 0 if way.left is None else way.left.middle
        resolved.exact[name] = (axis.to_position(way.target + ahead_counts), way.target)
        resolved.overruns[name] = target
    elif way.take_up is not None:
        resolved.take_ups.append(replace(move, target_counts=way.take_up, velocity=slowly))
    elif way.is_return:
        move = replace(move, velocity=min(move.velocity, slowly))
    resolved.moves.append(move)
    if way.left is not None:
        resolved.plays[name] = way.left
    bound = bound_position(axis, way)
    if bound is not None:
        resolved.bounds[name] = bound


def _iterate_targets(step: Move, context: AxisContext, goal: Mapping[str, Fraction]) -> Iterator[tuple[str, Fraction]]:
    """The exact motor targets of all real axes. goal: those that are known already. Raises `Refusal`."""
    virtual_names = find_virtual_names(context.fleet, step)
    for name, value in (step.to | step.by).items():
        if name in virtual_names:
            continue
        axis, state = context.fleet.axis(name), context.states[name]
        _require_ready(context.fleet, name, state)
        position_here = context.find_position(name)
        try:
            amount = parse_quantity(value, axis.unit)
        except UnitError as error:
            raise Refusal("bad-unit", f"{name}: {error}", controller=controller_of(name)) from None
        if name in goal:
            yield name, goal[name]
        elif name in step.by:
            yield name, position_here + amount
        else:
            yield name, choose_turn(axis, position_here, amount - state.offset, state.offset)
    if virtual_names:
        yield from _iterate_virtual(step, context, goal)


def _iterate_virtual(step: Move, context: AxisContext, goal: Mapping[str, Fraction]) -> Iterator[tuple[str, Fraction]]:
    """The motor targets of the real axes of all virtual ones."""
    require_apart(context.fleet, step)
    for group in group_virtual(context.fleet, step):
        names = context.fleet.virtual_axes.maps[group].real
        for name in names:
            _require_ready(context.fleet, name, context.states[name])
        require_no_offset(context.fleet, group, {name: context.states[name].offset for name in names})
        positions = [context.find_position(name) + context.states[name].offset for name in names]
        targets = find_virtual_targets(context.fleet, step, group, positions)
        assert targets is not None, "all positions are known"
        for name, target in targets.items():
            yield name, goal[name] if name in goal else target - context.states[name].offset


def make_path_starts(step: FollowPath, context: AxisContext) -> list[PathStart]:
    """Where the axes of a path stand. Raises `Refusal` for one that is not enabled or referenced, and for a member that
    executes trapezoids only."""
    starts: list[PathStart] = []
    for name in step.axes:
        axis, state, controller = context.fleet.axis(name), context.states[name], controller_of(name)
        _require_ready(context.fleet, name, state)
        position_here = context.find_position(name)
        order = max(context.infos[controller].orders)
        starts.append(
            PathStart(
                name=name,
                axis=axis,
                here=position_here,
                start_counts=state.commanded_counts,
                offset=state.offset,
                order=order,
                ahead=0 if axis.play is None else round((state.play or axis.play).middle),
            )
        )
    return starts


def _require_ready(fleet: Fleet, name: str, state: AxisState) -> None:
    controller = controller_of(name)
    if not state.enabled:
        remedy = f"enable it before: a step `do: enable`, or `tutti axis enable {name}`"
        raise Refusal("not-enabled", f"axis {name} is not enabled", remedy, controller)
    if not state.referenced:
        remedy = f"home it before: a step `do: home`, or `tutti axis home {fleet.virtual_axes.name_whole(name)}`"
        raise Refusal(NOT_REFERENCED, f"axis {name} is not referenced", remedy, controller)
