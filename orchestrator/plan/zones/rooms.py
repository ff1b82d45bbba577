"""How far axes may be jogged together: a box of positions in which zones hold, grown around where the axes stand.

All places in the box are allowed at once, so that each axis may be jogged in its side of the box whatever the others do
in theirs. A rule that is broken already, or nearly, holds where it is not broken more: that is the way out.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.clearance import Constraint, OutOfWork, Search, find_violation
from orchestrator.plan.zones.exits import find_exit
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import RuleCheck

PARTS = 16
"""Of the range of an axis, by which its side grows in turn with the others."""
HALVINGS = 6
"""Of such a part, to where the side ends."""
LOOKS = 200
"""At boxes, for one rule and one longer side: what is not decided by then is not kept."""
MOST_LOOKS = 4_000
"""In all: a quarter of a second. Where they are used up, sides are shorter."""


class Room(NamedTuple):
    """One side of the box: between which motor positions an axis may be jogged, in its unit. low_by, high_by: what ends
    it there; empty: its range."""

    low: float
    high: float
    low_by: str = ""
    high_by: str = ""


class _Demand(NamedTuple):
    """What must hold. margins: of the axes, with which it is checked."""

    name: str
    constraint: Constraint
    margins: Mapping[str, float]


class _Side(NamedTuple):
    """An axis and one of its directions."""

    axis: str
    is_upward: bool


def find_rooms(zones: FleetZones, positions: Box, axes: Collection[str]) -> dict[str, Room]:
    """The sides of axes whose positions are known. positions: where the axes of rules stand; those without one may be
    anywhere in their range. axes: that are jogged under one lease."""
    jogged_axes = [axis for axis in axes if axis in zones.ranges and axis in positions]
    growth = _Growth(zones, positions, jogged_axes)
    growth.grow()
    return growth.rooms


class _Growth:
    """A box that grows. rooms: its sides so far."""

    def __init__(self, zones: FleetZones, positions: Box, axes: Sequence[str]) -> None:
        self._zones = zones
        self._standing = {name: positions.get(name, ends) for name, ends in zones.ranges.items()}
        self._locked: dict[str, str] = {}
        self._looks = 0
        self.rooms = {axis: Room(*positions[axis]) for axis in axes}
        self._demands = [
            self._make_demand(rule) for rule in zones.rules if not self.rooms.keys().isdisjoint(rule.constraint.axes)
        ]

    def _make_demand(self, rule: RuleCheck) -> _Demand:
        """A rule as it must hold: where it may be broken already, nowhere by more."""
        demand = _Demand(rule.name, rule.constraint, self._zones.margins)
        if self._keeps(demand, self._make_box({})):
            return demand
        relaxed_constraint = rule.constraint.relax(self._make_box({}))
        if relaxed_constraint is not None:
            return _Demand(rule.name, relaxed_constraint, {})
        self._open_exit(rule)
        return demand

    def _open_exit(self, rule: RuleCheck) -> None:
        """Of bodies that touch no distance says what leads out: the axis with the nearest place at which they are apart
        may go there, and the others of the rule not at all."""
        self._locked |= dict.fromkeys(rule.constraint.axes, rule.name)
        middle = {axis: sum(self._standing[axis]) / 2 for axis in rule.constraint.axes}
        way_out = find_exit(self._zones, rule, middle)
        if way_out is not None and way_out.axis in self.rooms:
            room, end = self.rooms[way_out.axis], middle[way_out.axis] + way_out.way
            self.rooms[way_out.axis] = Room(min(room.low, end), max(room.high, end), rule.name, rule.name)

    def grow(self) -> None:
        """Grow to the whole ranges, if they are free; else each side by a part in turn, and to its end."""
        self._name_locked()
        free_axes = [axis for axis in self.rooms if axis not in self._locked]
        ranges = {axis: Room(*self._zones.ranges[axis]) for axis in free_axes}
        if self._find_breach(ranges) is None:
            self.rooms |= ranges
            return
        sides = [_Side(axis, is_upward) for axis in free_axes for is_upward in (False, True)]
        widths = {axis: (room.high - room.low) / PARTS for axis, room in ranges.items()}
        blocked_sides: list[_Side] = []
        while sides:
            still_free = [side for side in sides if self._extend(side, widths[side.axis])]
            blocked_sides += [side for side in sides if side not in still_free]
            sides = still_free
        for halving in range(1, HALVINGS + 1):
            for side in blocked_sides:
                self._extend(side, widths[side.axis] / 2**halving)

    def _name_locked(self) -> None:
        for axis, rule in self._locked.items():
            if axis in self.rooms:
                self.rooms[axis] = self.rooms[axis]._replace(low_by=rule, high_by=rule)

    def _extend(self, side: _Side, way: float) -> bool:
        """Make a side longer by a way, within the range; return whether it can become longer still."""
        room, (low, high) = self.rooms[side.axis], self._zones.ranges[side.axis]
        end = min(room.high + way, high) if side.is_upward else max(room.low - way, low)
        if end <= room.high if side.is_upward else end >= room.low:
            return False  # it stands beyond its range, or is at its end
        wider_room = room._replace(high=end) if side.is_upward else room._replace(low=end)
        breach = self._find_breach({side.axis: wider_room})
        if breach is not None:
            self.rooms[side.axis] = room._replace(high_by=breach) if side.is_upward else room._replace(low_by=breach)
            return False
        self.rooms[side.axis] = wider_room
        return low < end < high

    def _find_breach(self, rooms: Mapping[str, Room]) -> str | None:
        """The first rule that is not surely kept with these sides in place of those so far."""
        box = self._make_box(rooms)
        return next(
            (
                demand.name
                for demand in self._demands
                if not rooms.keys().isdisjoint(demand.constraint.axes) and not self._keeps(demand, box)
            ),
            None,
        )

    def _make_box(self, rooms: Mapping[str, Room]) -> Box:
        sides = {**self.rooms, **rooms}
        return {**self._standing, **{axis: (room.low, room.high) for axis, room in sides.items()}}

    def _keeps(self, demand: _Demand, box: Box) -> bool:
        spans = {axis: box[axis] for axis in demand.constraint.axes}
        margins = demand.margins
        wide_box = {
            axis: (low - margins.get(axis, 0.0), high + margins.get(axis, 0.0)) for axis, (low, high) in spans.items()
        }
        search = Search(max(0, min(LOOKS, MOST_LOOKS - self._looks)))
        try:
            return find_violation(search, demand.constraint, wide_box) is None
        except OutOfWork:
            return False
        finally:
            self._looks += search.looks
