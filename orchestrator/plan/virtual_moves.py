"""Moves of virtual axes: the targets of the real axes that they stand for.

A move of virtual axes is one of their real axes on a straight line (`sync: phase`), on which every virtual position
changes in proportion as well. Virtual axes of a group that the step does not name keep their positions.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import TypeVar

from orchestrator.model.curved_map import CurvedMap
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import MapError
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.move import Move
from orchestrator.model.units import UnitError, parse_quantity
from orchestrator.model.virtual_maps import VirtualMap
from orchestrator.plan.pairs import find_pair_targets

MotionT = TypeVar("MotionT", bound=Motion)


def find_virtual_names(fleet: Fleet, step: Step) -> list[str]:
    """The virtual axes that a step names."""
    names = fleet.names.virtual
    return [name for name in step.named_axes if name in names] if names else []


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


def group_virtual(fleet: Fleet, step: Step) -> dict[str, list[str]]:
    """The virtual axes that a step names, by group."""
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
    if isinstance(virtual_map, CurvedMap) and len(virtual_map.real) > 1:
        text = f"{group} of {len(virtual_map.real)} real axes is curved: its real axes would leave the curve on the way"
        raise Refusal("curved", text, "move its real axes")
    virtual_positions = None if positions is None else _map(virtual_map.to_virtual, positions)
    targets = _find_stated_targets(fleet, step, virtual_map, virtual_positions)
    if targets is None:
        return None
    if (pair := fleet.virtual_axes.pairs.get(group)) is not None:
        targets = find_pair_targets(pair, targets, virtual_positions)
    if virtual_positions is not None:
        target_pairs = zip(targets, virtual_positions, strict=True)
        targets = [position if target is None else target for target, position in target_pairs]
    known_targets = [target for target in targets if target is not None]
    if len(known_targets) < len(targets):
        return None
    return dict(zip(virtual_map.real, _map(virtual_map.to_real, known_targets), strict=True))


def _find_stated_targets(
    fleet: Fleet, step: Move, virtual_map: VirtualMap, positions: Sequence[Fraction] | None
) -> list[Fraction | None] | None:
    """Where a step sends the virtual axes of a group, None for those that it does not name. positions: of all of them
    now. None: that depends on where they stand, which is not known. Raises `Refusal`."""
    targets: list[Fraction | None] = []
    for number, name in enumerate(virtual_map.virtual):
        target: Fraction | None = None
        if name in step.to:
            target = _parse_amount(fleet, name, step.to[name])
        elif name in step.by:
            if positions is None:
                return None
            target = positions[number] + _parse_amount(fleet, name, step.by[name])
        if target is not None:
            beyond_limits = fleet.virtual_axes.explain_beyond_limits(name, target)
            if beyond_limits is not None:
                raise Refusal("soft-limit", beyond_limits, "change the target, or the soft limits in the fleet file")
        targets.append(target)
    return targets


def _map(convert: Callable[[Sequence[Fraction]], Sequence[Fraction]], values: Sequence[Fraction]) -> Sequence[Fraction]:
    try:
        return convert(values)
    except MapError as error:
        raise Refusal("outside-map", str(error), "choose other targets") from None


def _parse_amount(fleet: Fleet, name: str, value: int | float | str) -> Fraction:
    try:
        return parse_quantity(value, fleet.unit_of(name))
    except UnitError as error:
        raise Refusal("bad-unit", f"{name}: {error}", "correct the unit") from None
