"""Convex shapes by their supports: the farthest point in a direction is all that distances need."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from typing import Protocol

from orchestrator.model.zone_fields import Vector, ZoneShape, to_mm, to_vector
from orchestrator.plan.zones.vectors import add, length, scale


class Shape(Protocol):
    """A convex shape in its own coordinates, mm. middle, radius: of a sphere around it."""

    @property
    def middle(self) -> Vector: ...

    @property
    def radius(self) -> float: ...

    def find_support(self, direction: Vector) -> Vector:
        """The point of the shape that is farthest in a direction of length 1."""
        ...


@dataclass(frozen=True, slots=True)
class Hull:
    """The convex hull of corners."""

    corners: tuple[Vector, ...]
    middle: Vector
    radius: float

    def find_support(self, direction: Vector) -> Vector:
        x, y, z = direction
        return max(self.corners, key=lambda corner: corner[0] * x + corner[1] * y + corner[2] * z)


@dataclass(frozen=True, slots=True)
class Ball:
    """A sphere."""

    middle: Vector
    radius: float

    def find_support(self, direction: Vector) -> Vector:
        return add(self.middle, scale(direction, self.radius))


@dataclass(frozen=True, slots=True)
class Cylinder:
    """A cylinder along z (`order` 0), x (1) or y (2): its coordinates are those of one along z, moved on by `order`."""

    middle: Vector
    round: float
    half: float
    order: int

    @property
    def radius(self) -> float:
        return math.hypot(self.round, self.half)

    def find_support(self, direction: Vector) -> Vector:
        x, y, z = move_on(direction, -self.order)
        width = math.hypot(x, y)
        part = self.round / width if width > 0.0 else 0.0
        return add(self.middle, move_on((x * part, y * part, math.copysign(self.half, z)), self.order))


_ORDER = {"z": 0, "x": 1, "y": 2}


def move_on(vector: Vector, order: int) -> Vector:
    """Each coordinate in the place of the one that is `order` places behind it: (x, y, z) becomes (z, x, y)."""
    shift = order % 3
    if shift == 0:
        return vector
    return (vector[2], vector[0], vector[1]) if shift == 1 else (vector[1], vector[2], vector[0])


def order_of(spec: ZoneShape) -> int:
    """By how many places `move_on` moves the coordinates of one along z."""
    return _ORDER[spec.direction]


def make_shape(spec: ZoneShape) -> Shape:
    """The shape of a body or a region of the fleet file."""
    middle, order = to_vector(spec.at), order_of(spec)
    if spec.box is not None:
        x, y, z = (to_mm(size) / 2 for size in spec.box)
        return _make_hull([(a * x, b * y, c * z) for a, b, c in product((-1.0, 1.0), repeat=3)], middle)
    if spec.cylinder is not None:
        return Cylinder(middle, to_mm(spec.cylinder.radius), to_mm(spec.cylinder.height) / 2, order)
    if spec.sphere is not None:
        return Ball(middle, to_mm(spec.sphere))
    assert spec.polygon is not None, "the shape is valid"
    half = to_mm(spec.polygon.height) / 2
    outline = [(to_mm(first), to_mm(second)) for first, second in spec.polygon.corners]
    return _make_hull([move_on((x, y, z), order) for x, y in outline for z in (-half, half)], middle)


def _make_hull(corners: Sequence[Vector], origin: Vector) -> Hull:
    placed_corners = tuple(add(corner, origin) for corner in corners)
    ends = [(min(values), max(values)) for values in zip(*placed_corners, strict=True)]
    x, y, z = ((low + high) / 2 for low, high in ends)
    radius = max(length((corner[0] - x, corner[1] - y, corner[2] - z)) for corner in placed_corners)
    return Hull(placed_corners, (x, y, z), radius)
