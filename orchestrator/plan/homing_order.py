"""The order in which axes are homed."""

from dataclasses import dataclass

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet


@dataclass(frozen=True, slots=True)
class HomingOrder:
    """entries: axes homed in parallel, each entry after all entries before it. loners: axes without an order, homed
    one by one after the entries, whether the one before has succeeded or not."""

    entries: list[list[str]]
    loners: list[str]

    @property
    def axes(self) -> set[str]:
        """All axes that are homed."""
        return {*self.loners, *(axis for entry in self.entries for axis in entry)}


def homing_order(fleet: Fleet, axes: list[str] | None) -> HomingOrder:
    """The given axes in the given order; else the fleet's `home_order`, followed by all axes that are not in it."""
    seen_axes, entries = set[str](), list[list[str]]()
    for entry in fleet.home_order if axes is None else axes:
        fresh = [axis for axis in _with_partners(fleet, fleet.expand_name(entry)) if axis not in seen_axes]
        seen_axes.update(fresh)
        if fresh:
            entries.append(fresh)
    return HomingOrder(entries, [axis for axis in fleet.axis_names if axis not in seen_axes] if axes is None else [])


def find_partners(fleet: Fleet) -> dict[str, str]:
    """By axis of a pair, the other one: both search at the same time."""
    pairs = [pair.real for pair in fleet.virtual_axes.pairs.values()]
    return {axis: partner for pair in pairs for axis, partner in (pair, pair[::-1])}


def _with_partners(fleet: Fleet, axes: list[str]) -> list[str]:
    partners = find_partners(fleet)
    return list(dict.fromkeys(name for axis in axes for name in (axis, partners.get(axis, axis))))


def find_prerequisites(fleet: Fleet, order: HomingOrder) -> dict[str, set[str]]:
    """By axis, the axes that must be referenced before it begins: all earlier entries, and its `homing.after`.

    Raises `Refusal` if the two contradict each other.
    """
    waits: dict[str, set[str]] = {}
    earlier_axes: set[str] = set()
    for entry in [*order.entries, order.loners]:
        for axis in entry:
            waits[axis] = earlier_axes | set(fleet.axis(axis).homing.after)
        for pair in fleet.virtual_axes.pairs.values():
            if set(pair.real) <= set(entry):
                both_waits = set[str]().union(*(waits[axis] for axis in pair.real))
                waits |= dict.fromkeys(pair.real, both_waits)
        earlier_axes = earlier_axes | set(entry)
    waits_left = dict(waits)
    # `isdisjoint` ends at the first axis that is left, which is nearly always a predecessor: hundreds of entries are
    # sorted in milliseconds, where intersections take seconds of the coordinator's loop.
    while free := [axis for axis, predecessors in waits_left.items() if predecessors.isdisjoint(waits_left)]:
        for axis in free:
            del waits_left[axis]
    if waits_left:
        first = min(waits_left)
        raise Refusal(
            "homing-order",
            f"{first} must be homed after {', '.join(sorted(waits_left[first] & waits_left.keys()))} (homing.after), "
            "but comes before it in the given order",
            "change the order, or home_order in the fleet file",
        )
    return waits
