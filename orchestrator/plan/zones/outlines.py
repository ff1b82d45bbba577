"""Drawings of bodies: the corners and edges of each shape, placed by the axes that carry it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations, product

from orchestrator.model.zone_fields import Vector, ZoneShape, to_mm, to_vector
from orchestrator.plan.zones.chain import Body
from orchestrator.plan.zones.shapes import move_on, order_of
from orchestrator.plan.zones.vectors import add

ROUND_CORNERS = 24
"""Of the polygon that a cylinder is drawn as."""


@dataclass(frozen=True, slots=True)
class Wire:
    """A convex shape in its own coordinates, mm. radius: around its one corner, of a sphere."""

    corners: list[Vector]
    edges: list[tuple[int, int]]
    radius: float = 0.0

    def place(self, body: Body, positions: Mapping[str, float]) -> "Wire":
        """The same in the machine's frame, with the axes that carry a body at positions."""
        pose = body.place_at(positions).pose
        return Wire([pose.place(corner) for corner in self.corners], self.edges, self.radius)


def make_wire(spec: ZoneShape) -> Wire:
    """The drawing of a body or a region of the fleet file."""
    middle = to_vector(spec.at)
    if spec.sphere is not None:
        return Wire([middle], [], to_mm(spec.sphere))
    if spec.box is not None:
        return _make_box([to_mm(size) / 2 for size in spec.box], middle)
    order = order_of(spec)
    if spec.cylinder is not None:
        outline, half = _make_round(to_mm(spec.cylinder.radius)), to_mm(spec.cylinder.height) / 2
    else:
        assert spec.polygon is not None, "the shape is valid"
        outline = [(to_mm(first), to_mm(second)) for first, second in spec.polygon.corners]
        half = to_mm(spec.polygon.height) / 2
    count = len(outline)
    corners = [add(move_on((x, y, z), order), middle) for z in (-half, half) for x, y in outline]
    edges = [(start + number, start + (number + 1) % count) for start in (0, count) for number in range(count)]
    if spec.polygon is not None:  # a cylinder has no edges between its ends: its outline is that of the hull
        edges += [(number, count + number) for number in range(count)]
    return Wire(corners, edges)


def _make_box(halves: Sequence[float], middle: Vector) -> Wire:
    """Its edges are between corners that differ along one axis."""
    x, y, z = halves
    signs = list(product((-1.0, 1.0), repeat=3))
    edges = [
        (first, second)
        for first, second in combinations(range(8), 2)
        if sum(a != b for a, b in zip(signs[first], signs[second], strict=True)) == 1
    ]
    return Wire([add((a * x, b * y, c * z), middle) for a, b, c in signs], edges)


def _make_round(radius: float) -> list[tuple[float, float]]:
    angles = [2 * math.pi * number / ROUND_CORNERS for number in range(ROUND_CORNERS)]
    return [(radius * math.cos(angle), radius * math.sin(angle)) for angle in angles]
