"""Moves of virtual axes: the targets of the real axes that they stand for.

A move of virtual axes is one of their real axes on a straight line (`sync: phase`), on which every virtual position
changes in proportion as well; but for corrected ones, whose real axes move in their own time. Virtual axes of a group
that the step does not name keep their positions.
"""

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import NamedTuple

from orchestrator.model.curved_map import CurvedMap
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.linear_map import CorrectedMap, MapError
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.move import Move
from orchestrator.model.virtual_maps import VirtualMap
from orchestrator.plan.pairs import find_pair_targets
from orchestrator.plan.targets import parse_target


def find_virtual_names(fleet: Fleet, step: Step) -> list[str]:
    """The virtual axes that a step names."""
    names = fleet.names.virtual
    return [name for name in step.named_axes if name in names] if names else []


def find_curved_group(fleet: Fleet, step: Step) -> str | None:
    """The curved group of several real axes whose virtual axes a step names: its real axes follow a path."""
    maps = {group: fleet.virtual_axes.maps[group] for group in group_virtual(fleet, step)}
    curved_groups = (name for name, axes in maps.items() if isinstance(axes, CurvedMap) and len(axes.real) > 1)
    return next(curved_groups, None)


def go_straight(fleet: Fleet, step: Move) -> Move:
    """The move with its virtual axes on a straight line of their real axes. Where all of them are corrected ones, their
    real axes take their own time, unless the step states `phase`: what an axis moves along by the errors of another one
    is too short for a ramp as long as that one's."""
    groups = group_virtual(fleet, step)
    if not groups:
        return step
    if not all(isinstance(fleet.virtual_axes.maps[group], CorrectedMap) for group in groups):
        return step.model_copy(update={"sync": "phase"})
    return step if step.sync == "phase" else step.model_copy(update={"sync": "none"})


def require_apart(fleet: Fleet, step: Move) -> None:
    """Raise `Refusal` for a step that moves a real axis twice, or in which virtual axes cannot go straight."""
    virtual_names = find_virtual_names(fleet, step)
    if virtual_names and go_straight(fleet, step).sync != step.sync == "none":
        text = f"`sync: none` would move {virtual_names[0]} and its group elsewhere on the way"
        raise Refusal("bad-step", text, "leave `sync` out: virtual axes move on a straight line")
    curved_group = find_curved_group(fleet, step)
    if curved_group is not None and any(split_name(name)[0] != curved_group for name in step.named_axes):
        text = f"{curved_group} is curved: its real axes follow a path, which nothing else can be a part of"
        raise Refusal("bad-step", text, "move the other axes in another step")
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
    way = find_virtual_way(fleet, step, group, positions)
    return None if way is None else dict(zip(fleet.virtual_axes.maps[group].real, way.targets, strict=True))


class VirtualWay(NamedTuple):
    """From where to where a group goes. begin, end: of its virtual axes, in order; begin is empty if it is not known.
    targets: of its real axes, user positions, in order."""

    begin: Sequence[Fraction]
    end: Sequence[Fraction]
    targets: Sequence[Fraction]


def find_virtual_way(fleet: Fleet, step: Move, group: str, positions: Sequence[Fraction] | None) -> VirtualWay | None:
    """As `find_virtual_targets`, with both ends of the way in virtual axes."""
    virtual_map = fleet.virtual_axes.maps[group]
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
    return VirtualWay(virtual_positions or (), known_targets, _map(virtual_map.to_real, known_targets))


def _find_stated_targets(
    fleet: Fleet, step: Move, virtual_map: VirtualMap, positions: Sequence[Fraction] | None
) -> list[Fraction | None] | None:
    """Where a step sends the virtual axes of a group, None for those that it does not name. positions: of all of them
    now. None: that depends on where they stand, which is not known. Raises `Refusal`."""
    targets: list[Fraction | None] = []
    for number, name in enumerate(virtual_map.virtual):
        target: Fraction | None = None
        if name in step.to:
            target = parse_target(name, step.to[name], fleet.unit_of(name))
        elif name in step.by:
            if positions is None:
                return None
            target = positions[number] + parse_target(name, step.by[name], fleet.unit_of(name))
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
