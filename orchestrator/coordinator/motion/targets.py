"""From the targets of a move, in units, to what the planner takes, in counts."""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import floor

from orchestrator.model.fleet import Axis, Fleet
from orchestrator.model.job import Move
from orchestrator.model.messages import Refusal, Reply
from orchestrator.model.state import AxisState, Info
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.plan.step import AxisMove, Targets


class Refuse(Exception):
    """A step that is not begun; the reason is a value."""

    def __init__(self, code: str, text: str, remedy: str = "", member: str | None = None) -> None:
        super().__init__(text)
        self.refusal = Refusal(code=code, text=text, remedy=remedy, member=member)


def refuse(refusal: Refusal) -> Refuse:
    """A member's refusal as the step's."""
    return Refuse(refusal.code, f"{refusal.member}: {refusal.text}", refusal.remedy, refusal.member)


def refuse_if_any(replies: Mapping[str, Reply]) -> None:
    """Raises `Refuse` with the first refusal among `replies`."""
    for reply in replies.values():
        if reply.refused is not None:
            raise refuse(reply.refused)


@dataclass(frozen=True, slots=True)
class Resolved:
    """A move in counts, with the exact targets that it stands for."""

    moves: list[AxisMove]
    exact: dict[str, tuple[Fraction, int]]


def resolve(
    step: Move,
    fleet: Fleet,
    states: Mapping[str, AxisState],
    infos: Mapping[str, Info],
    targets: Targets,
    goal: Mapping[str, Fraction],
) -> Resolved:
    """Absolute counts for all axes of `step`, checked against referenced, enabled and soft limits.

    states: by axis; infos: by controller. goal: what the step was resolved to before it was held. Raises `Refuse`.
    """
    moves: list[AxisMove] = []
    exact: dict[str, tuple[Fraction, int]] = {}
    for name, value in (step.to | step.by).items():
        axis, state = fleet.axis(name), states[name]
        controller = name.partition(".")[0]
        _require_ready(name, state, controller)
        here = targets.position(name, state.commanded_counts, axis.counts_per_unit)
        try:
            amount = parse_quantity(value, axis.unit)
        except UnitError as error:
            raise Refuse("bad-unit", f"{name}: {error}", member=controller) from None
        if name in goal:
            target = goal[name]
        else:
            target = here + amount if name in step.by else _turned(axis, here, amount - state.offset, state.offset)
        counts = axis.to_counts(target)
        _require_inside(name, axis, target, counts, float(state.offset), controller)
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
                order=max(infos[controller].orders),
                soft_limits=axis.soft_limits_counts,
            )
        )
    return Resolved(moves, exact)


def _turned(axis: Axis, here: Fraction, target: Fraction, offset: Fraction) -> Fraction:
    """The motor position that an absolute target means. On an axis that wraps, it is met once a turn: in the turn of
    user positions that the axis stands in, or, with `shortest_way`, at the place nearest to `here`; in both cases
    inside the soft limits, if one is."""
    turn = axis.turn
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
        raise Refuse("not-enabled", f"axis {name} is not enabled", "add a step `do: enable` before", controller)
    if not state.referenced:
        raise Refuse("not-referenced", f"axis {name} is not referenced", "add a step `do: home` before", controller)


def _require_inside(name: str, axis: Axis, target: Fraction, counts: int, offset: float, controller: str) -> None:
    """Soft limits are motor positions; the message speaks of user positions, as the target did."""
    limits = axis.soft_limits_counts
    if limits is None or limits[0] <= counts <= limits[1]:
        return
    low, high = sorted(axis.to_unit(limit) + offset for limit in limits)
    raise Refuse(
        "soft-limit",
        f"axis {name}: target {float(target) + offset:g} {axis.unit} is beyond its soft limits {low:g} to {high:g} "
        f"{axis.unit}",
        "change the target, or the soft limits in the fleet file",
        controller,
    )
