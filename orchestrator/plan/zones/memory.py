"""Checks of motions, with the rules of the fleet of which one was checked last: to make 190 of them takes 10 ms."""

from collections.abc import Collection
from itertools import chain
from typing import NamedTuple

from orchestrator.model.fleet import Fleet
from orchestrator.plan.homing_order import HomingOrder
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Sweep
from orchestrator.plan.zones.homing import ZoneHoming
from orchestrator.plan.zones.refusals import make_refusal
from orchestrator.plan.zones.rooms import Room, find_rooms
from orchestrator.plan.zones.rules import FleetZones


class CheckedSweep(NamedTuple):
    """A step that keeps all rules. recent: where its axes may have stopped shortly before its end (`Sweep.recent` of
    what begins then). reach: where they may be in all of it."""

    recent: Box
    reach: Box


class ZoneMemory:
    """The rules of one fleet. All methods are for fleets with zones."""

    def __init__(self) -> None:
        self._made: tuple[Fleet, FleetZones] | None = None

    def require(self, fleet: Fleet, sweep: Sweep) -> "CheckedSweep":
        """Raise `Refusal` (code `zone`) for a step that may break a rule; return what is known of one that does not."""
        zones = self.read(fleet)
        course = zones.make_course(sweep)
        for violation in zones.find_violations(course):
            raise make_refusal(zones, course, violation)
        return CheckedSweep(course.find_recent(), {axis: course.whole_box[axis] for axis in course.moved})

    def list_related(self, fleet: Fleet, axes: Collection[str]) -> set[str]:
        """The axes that rules bind to some of `axes`, without these."""
        rules = self.read(fleet).rules
        bound_axes = [rule.constraint.axes for rule in rules if not set(axes).isdisjoint(rule.constraint.axes)]
        return set(chain.from_iterable(bound_axes)) - set(axes)

    def require_homing(self, fleet: Fleet, positions: Box, order: HomingOrder) -> None:
        """Raise `Refusal` (code `zone`) for a homing in an order that zones do not allow. positions: as of
        `ZoneHoming`."""
        ZoneHoming(self.read(fleet), fleet, positions).require_order(order)

    def require_search(self, fleet: Fleet, positions: Box, axes: Collection[str]) -> None:
        """Raise `Refusal` (code `zone`) for axes that cannot search for their references at the same time."""
        refusal = ZoneHoming(self.read(fleet), fleet, positions).find_refusal(axes)
        if refusal is not None:
            raise refusal

    def find_rooms(self, fleet: Fleet, positions: Box, axes: Collection[str]) -> dict[str, Room]:
        """How far axes may be jogged together, see `find_rooms`."""
        return find_rooms(self.read(fleet), positions, axes)

    def read(self, fleet: Fleet) -> FleetZones:
        """The rules of a fleet."""
        entry = self._made
        if entry is None or entry[0] is not fleet:
            entry = self._made = fleet, FleetZones(fleet)
        return entry[1]
