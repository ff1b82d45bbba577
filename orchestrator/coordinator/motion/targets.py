"""Convert the targets of a move, in units, to counts for the planner."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import floor

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.job import Move
from orchestrator.model.names import controller_of
from orchestrator.model.state import AxisState, ControllerInfo
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.step import AxisMove, ExactTargets


@dataclass(frozen=True, slots=True)
class ResolvedMove:
    """A move in counts, with the exact targets that the counts were rounded from."""

    moves: list[AxisMove]
    exact: dict[str, tuple[Fraction, int]]


@dataclass(frozen=True, slots=True)
class AxisContext:
    """What targets are resolved with. states: by axis. infos: by controller. targets: exact earlier targets."""

    fleet: Fleet
    states: Mapping[str, AxisState]
    infos: Mapping[str, ControllerInfo]
    targets: ExactTargets


def resolve_targets(step: Move, context: AxisContext, goal: Mapping[str, Fraction]) -> ResolvedMove:
    """Absolute counts for all axes of `step`, checked against referenced, enabled and soft limits.

    goal: the exact targets from before a feed hold. Raises `Refusal`.
    """
    moves: list[AxisMove] = []
    exact: dict[str, tuple[Fraction, int]] = {}
    for name, value in (step.to | step.by).items():
        axis, state = context.fleet.axis(name), context.states[name]
        controller = controller_of(name)
        _require_ready(name, state, controller)
        here = context.targets.exact_position(name, state.commanded_counts, axis.counts_per_unit)
        try:
            amount = parse_quantity(value, axis.unit)
        except UnitError as error:
            raise Refusal("bad-unit", f"{name}: {error}", controller=controller) from None
        if name in goal:
            target = goal[name]
        else:
            target = here + amount if name in step.by else _choose_turn(axis, here, amount - state.offset, state.offset)
        counts = axis.to_counts(target)
        _require_within_limits(name, axis, counts, target + state.offset, state.offset)
        exact[name] = (target, counts)
        scale = float(axis.scale)
        moves.append(
            AxisMove(
                axis=name,
                start_counts=state.commanded_counts,
                target_counts=counts,
                velocity=axis.limits.velocity * scale,
                acceleration=axis.limits.acceleration * scale,
                jerk=None if axis.limits.jerk is None else axis.limits.jerk * scale,
                order=max(context.infos[controller].orders),
                soft_limits=axis.soft_limits_counts,
            )
        )
    return ResolvedMove(moves, exact)


def _choose_turn(axis: Axis, here: Fraction, target: Fraction, offset: Fraction) -> Fraction:
    """The motor position of an absolute target. On an axis that wraps it exists once per turn; taken is the one in
    the present turn of user positions or, with `shortest_way`, the one nearest to `here`; inside the soft limits
    if possible."""
    turn = axis.turn_length
    if turn is None:
        return target
    if axis.shortest_way:
        turned = target + turn * round((here - target) / turn)
    else:
        turned = target + turn * (floor((here + offset) / turn) - floor((target + offset) / turn))
    limits = axis.soft_limits_counts
    if limits is None or limits[0] <= axis.to_counts(turned) <= limits[1]:
        return turned
    inside = [way for way in (turned - turn, turned + turn) if limits[0] <= axis.to_counts(way) <= limits[1]]
    return min(inside, key=lambda way: abs(way - here), default=turned)


def _require_ready(name: str, state: AxisState, controller: str) -> None:
    if not state.enabled:
        raise Refusal("not-enabled", f"axis {name} is not enabled", "add a step `do: enable` before it", controller)
    if not state.referenced:
        raise Refusal("not-referenced", f"axis {name} is not referenced", "add a step `do: home` before it", controller)


def _require_within_limits(name: str, axis: Axis, counts: int, user_target: Fraction, offset: Fraction) -> None:
    """Soft limits are motor positions; the message uses user positions, like the target."""
    limits = axis.soft_limits_counts
    if limits is None or limits[0] <= counts <= limits[1]:
        return
    low, high = sorted(axis.to_unit(limit) + float(offset) for limit in limits)
    raise Refusal(
        "soft-limit",
        f"axis {name}: target {float(user_target):g} {axis.unit} is beyond its soft limits {low:g} to "
        f"{high:g} {axis.unit}",
        "change the target, or the soft limits in the fleet file",
        controller_of(name),
    )
