"""Whether two bodies stay apart for all positions of their axes in a box: proven by bounds, or refuted by a place."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from orchestrator.model.errors import TuttiError
from orchestrator.model.zone_fields import Vector
from orchestrator.plan.zones.chain import Body, Box, LinearPart, Rates
from orchestrator.plan.zones.distance import find_separation
from orchestrator.plan.zones.vectors import ORIGIN, dot, length, subtract

MAX_LOOKS = 1_000
"""Boxes that are looked at for one rule and one step."""
FINEST = 1e-4
"""mm. A box in which bodies move by less is not divided any more; of a relation, in the unit of its axis."""
ROUNDING = 1e-5
"""mm. Bodies that are nearer than their distance by less are as far apart as they must be."""


class OutOfWork(TuttiError):
    """More looks would be needed than are allowed."""


class Look(NamedTuple):
    """What is known of a rule in a box. holds: everywhere in it; False: not in its middle; None: not decided. nearest:
    the smallest distance that is known, mm. widest: the axis that changes most in the box of what decides; None where
    the box is not worth dividing."""

    holds: bool | None
    nearest: float = math.inf
    widest: str | None = None


class Constraint(Protocol):
    """What must hold for all positions in a box."""

    @property
    def axes(self) -> list[str]:
        """The real axes that it depends on."""
        ...

    def look(self, box: Box) -> Look:
        """Try to decide it for a whole box."""
        ...

    def relax(self, box: Box) -> "Constraint | None":
        """What must hold if it shall nowhere be broken by more than in a box; None: that cannot be stated."""
        ...

    def describe(self, positions: Mapping[str, float]) -> str:
        """What is broken at positions, in words."""
        ...


@dataclass(slots=True)
class Search:
    """Counts looks. nearest: the smallest distance seen."""

    most: int = MAX_LOOKS
    looks: int = 0
    nearest: float = math.inf

    def look(self, constraint: Constraint, box: Box) -> Look:
        """One look. Raises `OutOfWork`."""
        if self.looks >= self.most:
            raise OutOfWork
        self.looks += 1
        result = constraint.look(box)
        self.nearest = min(self.nearest, result.nearest)
        return result


def find_violation(search: Search, constraint: Constraint, box: Box) -> dict[str, float] | None:
    """Positions in a box at which a constraint is broken, or too near to that to be told; None: it holds in all of the
    box. Raises `OutOfWork`."""
    boxes: list[Box] = [box]
    while boxes:
        part = boxes.pop()
        result = search.look(constraint, part)
        if result.holds:
            continue
        if result.holds is False or result.widest is None:
            return find_middle(part)
        boxes += [{**part, result.widest: half} for half in halve(part, result.widest)]
    return None


def halve(box: Box, axis: str) -> list[tuple[float, float]]:
    """The two halves of the range of an axis."""
    low, high = box[axis]
    return [(low, (low + high) / 2), ((low + high) / 2, high)]


def find_middle(box: Box) -> dict[str, float]:
    """The middle of a box."""
    return {axis: (low + high) / 2 for axis, (low, high) in box.items()}


class PairClearance:
    """Two bodies that are to be apart by `distance`, mm. What carries both moves neither against the other."""

    def __init__(self, first: Body, second: Body, distance: float) -> None:
        self.bodies = first, second
        common = 0
        for joint, second_joint in zip(first.joints, second.joints, strict=False):
            if joint != second_joint:
                break
            common += 1
        self.first, self.second = first.without_first(common), second.without_first(common)
        self.distance = distance
        self.axes = list(dict.fromkeys([*self.first.axes, *self.second.axes]))
        self._size = 2 * (first.shape.radius + second.shape.radius) + distance

    def find_distance(self, positions: Mapping[str, float]) -> tuple[float, float]:
        """Between what the distance is at positions, mm."""
        first, second = self.first.place_at(positions), self.second.place_at(positions)
        begin = subtract(first.middle, second.middle)
        least, most, _ = find_separation(first.find_support, second.find_support, begin, self._size)
        return least, most

    def look(self, box: Box) -> Look:
        """The gap along the direction that separates both in the middle of the box shrinks by at most what each axis
        moves them along it; that they come nearer along another direction does not matter."""
        own_box = {axis: box[axis] for axis in self.axes}
        middle = find_middle(own_box)
        first, second = self.first.place_at(middle), self.second.place_at(middle)
        begin = subtract(first.middle, second.middle)
        least, most, direction = find_separation(first.find_support, second.find_support, begin, self._size)
        rates = self.first.find_rates(own_box), self.second.find_rates(own_box)
        shares = {axis: _find_rate(axis, rates, direction) * _half(box[axis]) for axis in self.axes}
        share, enough = sum(shares.values()), self.distance - ROUNDING
        if least - share >= enough:
            return Look(holds=True, nearest=most)
        if most < enough:
            return Look(holds=False, nearest=most)
        return Look(holds=None, nearest=most, widest=max(shares, key=shares.__getitem__) if share > FINEST else None)

    def relax(self, box: Box) -> "PairClearance | None":
        """The distance of now, of bodies that are apart, and whose axes are at known positions."""
        if any(box[axis][1] - box[axis][0] > FINEST for axis in self.axes):
            return None
        least, _ = self.find_distance(find_middle({axis: box[axis] for axis in self.axes}))
        return PairClearance(*self.bodies, min(least, self.distance)) if least > ROUNDING else None

    def find_gap(self, balls: Iterable[tuple[Vector, float]]) -> float:
        """How much farther apart than they must be both are, by balls that they do not leave, mm; not above 0: these do
        not show it."""
        (first, first_radius), (second, second_radius) = balls
        return length(subtract(first, second)) - first_radius - second_radius - self.distance

    def describe(self, positions: Mapping[str, float]) -> str:
        """How near both are at positions."""
        nearest = self.find_distance(positions)[1]
        gap_text = "touch" if nearest <= ROUNDING else f"are {nearest:.4g} mm apart"
        return f"{self.first.name} and {self.second.name} {gap_text}, and must be {self.distance:g} mm apart"


class RelationConstraint:
    """Two positions that exclude each other."""

    def __init__(self, when: "End", forbid: "End", words: str) -> None:
        """when, forbid: as they are checked. words: the rule, as the file has it."""
        self._when, self._forbid, self._words = when, forbid, words
        self.axes = list(dict.fromkeys(axis for end in (when, forbid) for axis, _ in end.way.factors))

    def look(self, box: Box) -> Look:
        """Each of both positions has its range in the box."""
        if not (self._when.may_hold(box) and self._forbid.may_hold(box)):
            return Look(holds=True)
        middle = find_middle(box)
        if self._when.holds_at(middle) and self._forbid.holds_at(middle):
            return Look(holds=False)
        shares = {
            axis: _half(box[axis]) * abs(factor) for e in (self._when, self._forbid) for axis, factor in e.way.factors
        }
        widest = max(shares, key=shares.__getitem__)
        return Look(holds=None, widest=widest if shares[widest] > FINEST else None)

    def find_depth(self, positions: Mapping[str, float]) -> float:
        """How far positions are behind both ends, in the unit of the axis that is less so; below 0: it is kept."""
        return min(end.find_depth(positions) for end in (self._when, self._forbid))

    def relax(self, box: Box) -> "NoDeeper":
        """Neither position goes farther behind its end than it may be in the box."""
        return NoDeeper(self, [(end, end.way.find_range(box)) for end in (self._when, self._forbid)])

    def describe(self, positions: Mapping[str, float]) -> str:
        """The positions that exclude each other."""
        ends = ", ".join(
            f"{end.name} at {end.way.find_at(positions):.6g} {end.unit}" for end in (self._when, self._forbid)
        )
        return f"{self._words}: {ends}"


class NoDeeper:
    """Positions that do not go farther behind their ends than they may be. spans: where each may be now."""

    def __init__(self, relation: RelationConstraint, spans: Sequence[tuple["End", tuple[float, float]]]) -> None:
        self._relation, self._spans, self.axes = relation, spans, relation.axes

    def look(self, box: Box) -> Look:
        """Each of both has its range in the box."""
        for end, (low, high) in self._spans:
            least, most = end.way.find_range(box)
            if (least < low - FINEST) if end.is_below else (most > high + FINEST):
                return Look(holds=False)
        return Look(holds=True)

    def relax(self, box: Box) -> None:
        """It is what must hold already."""
        del box

    def describe(self, positions: Mapping[str, float]) -> str:
        """The positions that exclude each other."""
        return self._relation.describe(positions)


@dataclass(frozen=True, slots=True)
class End:
    """A position on one side of an end. name, unit: of the axis, which may be virtual."""

    name: str
    unit: str
    way: LinearPart
    is_below: bool
    end: float

    def holds_at(self, positions: Mapping[str, float]) -> bool:
        """Whether it holds with axes at positions."""
        return self.find_depth(positions) > 0.0

    def find_depth(self, positions: Mapping[str, float]) -> float:
        """How far positions are on its side of the end, in its unit."""
        excess = self.way.find_at(positions) - self.end
        return -excess if self.is_below else excess

    def may_hold(self, box: Box) -> bool:
        """Whether it holds anywhere in a box."""
        low, high = self.way.find_range(box)
        return low < self.end if self.is_below else high > self.end


def _half(ends: tuple[float, float]) -> float:
    return (ends[1] - ends[0]) / 2


def _find_rate(axis: str, rates: tuple[Rates, Rates], direction: Vector) -> float:
    """How fast an axis moves both bodies against each other along a direction, at most."""
    first, second = rates
    along = dot(subtract(first.along.get(axis, ORIGIN), second.along.get(axis, ORIGIN)), direction)
    return abs(along) + first.beside.get(axis, 0.0) + second.beside.get(axis, 0.0)
