"""Whether zones allow a homing, and in what order of its axes.

An axis that searches for its reference may be anywhere in its range, and at its reference; it is there afterwards. One
of which the fleet file says that its homing leads away from all bodies is not checked while it searches.
"""

from collections.abc import Collection, Sequence

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.plan.homing_order import HomingOrder, find_partners
from orchestrator.plan.zones.chain import Box
from orchestrator.plan.zones.course import Course, Sweep, Timing, join_spans
from orchestrator.plan.zones.refusals import make_refusal
from orchestrator.plan.zones.rules import FleetZones
from orchestrator.plan.zones.search import Violation

ORDER_WORDS = "home in this order, each axis by itself: "


class ZoneHoming:
    """A homing of axes of a fleet with zones. positions: between what motor positions the axes of rules are before it;
    without one they may be anywhere in their range."""

    def __init__(self, zones: FleetZones, fleet: Fleet, positions: Box) -> None:
        self._zones = zones
        self._fleet = fleet
        self._positions = dict(positions)
        assert fleet.zones is not None, "the fleet has zones"
        self._away = set(fleet.zones.homes_away)

    def require_order(self, order: HomingOrder) -> None:
        """Raise `Refusal` (code `zone`) for a homing that may bring bodies together, with an order that does not, or
        with the axes that cannot be homed in any."""
        begin_positions = dict(self._positions)
        for axes in [*order.entries, *([axis] for axis in order.loners)]:
            refusal = self.find_refusal(axes)
            if refusal is not None:
                self._positions = begin_positions
                all_axes = [*(axis for entry in order.entries for axis in entry), *order.loners]
                raise Refusal("zone", refusal.text, self._find_remedy(all_axes, refusal))
            self.take(axes)

    def find_refusal(self, axes: Collection[str]) -> Refusal | None:
        """Why axes cannot search for their references at the same time; None: they can."""
        course = self._make_course(axes)
        violation = None if course is None else next(self._zones.find_violations(course), None)
        return None if course is None or violation is None else self._make_refusal(axes, course, violation)

    def take(self, axes: Collection[str]) -> None:
        """These axes have been homed."""
        for axis in axes:
            reference = float(self._fleet.axis(axis).to_position(0))
            self._positions[axis] = reference, reference

    def find_order(self, axes: Sequence[str]) -> list[str] | None:
        """An order in which they can be homed; None: there is none. It takes each as soon as it can be: a homing makes
        a position known, so that what could be homed before it can be behind it as a rule."""
        left_axes, order, partners = list(axes), list[str](), find_partners(self._fleet)
        while left_axes:
            for axis in left_axes:
                group = [name for name in (axis, partners.get(axis)) if name is not None]
                waits = set(self._fleet.axis(axis).homing.after) & set(left_axes)
                if not waits and self.find_refusal(group) is None:
                    break
            else:
                return None
            self.take(group)
            order += group
            left_axes = [name for name in left_axes if name not in group]
        return order

    def _make_course(self, axes: Collection[str]) -> Course | None:
        """Axes that search; None where nothing of them is checked."""
        searching = [axis for axis in axes if axis in self._zones.ranges]
        swept_axes = [axis for axis in searching if axis not in self._away]
        if not swept_axes:
            return None
        spans = {axis: self._find_span(axis) for axis in searching}
        return self._zones.make_course(Sweep({}, {**self._positions, **spans}, Timing({}), swept_axes))

    def _find_span(self, axis: str) -> tuple[float, float]:
        reference = float(self._fleet.axis(axis).to_position(0))
        return join_spans(self._zones.ranges[axis], (reference, reference))

    def _make_refusal(self, axes: Collection[str], course: Course, violation: Violation) -> Refusal:
        refusal = make_refusal(self._zones, course, violation)
        rule_axes = [axis for axis in axes if axis in violation.rule.constraint.axes]
        spans = [
            f"{axis} counts as anywhere between {low:g} and {high:g} {self._zones.units[axis]}"
            for axis in rule_axes
            for low, high in [self._find_span(axis)]
        ]
        text = f"homing of {', '.join(axes)}: {refusal.text}; until it has its reference, {', '.join(spans)}"
        return Refusal("zone", text, refusal.remedy)

    def _find_remedy(self, axes: Sequence[str], refusal: Refusal) -> str:
        order = self.find_order(axes)
        if order is not None:
            return ORDER_WORDS + ", ".join(order)
        text = (
            "no order of homing fits; state in `zones` where axes can be at all (`ranges`), or whose homing leads away "
        )
        return f"{text}from all bodies (`homes_away`); or {refusal.remedy}"
