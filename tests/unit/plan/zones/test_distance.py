"""Distances of convex bodies, against formulas and against many points of both."""

import math
import random
from itertools import product

import pytest

from orchestrator.model.zone_fields import Vector, ZoneShape
from orchestrator.plan.zones.chain import PlacedShape, Pose
from orchestrator.plan.zones.distance import Separation, find_separation
from orchestrator.plan.zones.shapes import Shape, make_shape
from orchestrator.plan.zones.vectors import dot, make_rotation, subtract


def separate(first: PlacedShape, second: PlacedShape) -> Separation:
    size = 2 * (first.shape.radius + second.shape.radius)
    return find_separation(first.find_support, second.find_support, subtract(first.middle, second.middle), size)


def shape(**fields: object) -> Shape:
    return make_shape(ZoneShape.model_validate(fields))


def at(body: Shape, place: Vector, axis: Vector = (0.0, 0.0, 1.0), angle: float = 0.0) -> PlacedShape:
    return PlacedShape(body, Pose(make_rotation(axis, angle), place))


BOX = shape(box=[2, 4, 6])
ROD = shape(cylinder={"radius": 1, "height": 10}, direction="x")
BALL = shape(sphere=3)
TRIANGLE = shape(polygon={"corners": [[0, 0], [4, 0], [0, 3]], "height": 2})


@pytest.mark.parametrize(
    ("first", "second", "distance"),
    [
        (at(BALL, (0, 0, 0)), at(BALL, (10, 0, 0)), 4.0),
        (at(BALL, (0, 0, 0)), at(BALL, (3, 4, 12)), 7.0),
        (at(BOX, (0, 0, 0)), at(BOX, (5, 0, 0)), 3.0),  # face to face
        (at(BOX, (0, 0, 0)), at(BOX, (5, 8, 0)), 5.0),  # edge to edge: 3 and 4
        (at(BOX, (0, 0, 0)), at(BOX, (3, 6, 8)), 3.0),  # corner to corner: 1, 2 and 2
        (at(BOX, (0, 0, 0)), at(BALL, (8, 0, 0)), 4.0),
        (at(ROD, (0, 0, 0)), at(BALL, (0, 0, 7)), 3.0),
        (at(ROD, (0, 0, 0)), at(BALL, (12, 0, 0)), 4.0),
        (at(ROD, (0, 0, 0)), at(ROD, (0, 0, 9), (0, 0, 1), math.pi / 2), 7.0),  # crossed
        (at(BOX, (0, 0, 0)), at(BOX, (6, 0, 0), (0, 0, 1), math.pi / 4), 5 - 3 / math.sqrt(2)),  # an edge to a face
        (at(TRIANGLE, (0, 0, 0)), at(BALL, (4, 3, 0)), 0.0),  # 2.4 from the long side: inside the ball
        (at(TRIANGLE, (0, 0, 0)), at(shape(sphere=1), (4, 3, 0)), 2.4 - 1),
        (at(BOX, (0, 0, 0)), at(BOX, (1, 1, 1)), 0.0),
        (at(BALL, (0, 0, 0)), at(BALL, (0, 0, 0)), 0.0),
    ],
)
def test_the_distance_is_that_of_the_formula(first: PlacedShape, second: PlacedShape, distance: float) -> None:
    for result in (separate(first, second), separate(second, first)):
        assert result.least <= distance + 1e-12 and result.most >= distance - 1e-12
        assert result.most - result.least < 1e-5 and math.hypot(*result.direction) == pytest.approx(1.0)


def test_bounds_hold_for_random_bodies() -> None:
    """The lower bound is below the distance of all points of both; the upper one is that of two of them, so that bounds
    that are near to each other are right."""
    draw = random.Random(571)
    shapes = [BOX, ROD, BALL, TRIANGLE, shape(cylinder={"radius": 4, "height": 1}, direction="y")]
    apart = 0
    for _ in range(400):
        first, second = (
            at(draw.choice(shapes), _draw_vector(draw, 9.0), _draw_direction(draw), draw.uniform(-3, 3))
            for _ in range(2)
        )
        result = separate(first, second)
        apart += result.least > 0
        assert 0.0 <= result.most - result.least < 1e-4
        gap = dot(subtract(_lowest(first, result.direction), _highest(second, result.direction)), result.direction)
        assert result.least <= max(gap, 0.0) + 1e-12
        for direction in [_draw_direction(draw) for _ in range(20)]:
            # No plane has both bodies farther apart than they are.
            assert (
                dot(subtract(_lowest(first, direction), _highest(second, direction)), direction) <= result.most + 1e-9
            )
    assert 100 < apart < 400


def test_supports_are_the_farthest_corners() -> None:
    draw = random.Random(572)
    corners = [(x, y, z) for x, y, z in product((-1.0, 1.0), (-2.0, 2.0), (-3.0, 3.0))]
    for _ in range(50):
        direction = _draw_direction(draw)
        assert dot(BOX.find_support(direction), direction) == max(dot(corner, direction) for corner in corners)
        along = abs(direction[0]) * 5 + math.hypot(direction[1], direction[2])
        assert dot(ROD.find_support(direction), direction) == pytest.approx(along)


def test_corners_of_a_polygon_follow_its_direction() -> None:
    """[x, y] along z, [y, z] along x, [z, x] along y."""
    corners = [[0, 0], [7, 0], [7, 3], [0, 3]]
    for direction, sizes in (("z", (7, 3, 1)), ("x", (1, 7, 3)), ("y", (3, 1, 7))):
        plate = shape(polygon={"corners": corners, "height": 2}, direction=direction)
        assert [max(c) for c in zip(*(plate.find_support(e) for e in AXES), strict=True)] == list(sizes)


AXES: list[Vector] = [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)]


def _lowest(body: PlacedShape, direction: Vector) -> Vector:
    x, y, z = direction
    return body.find_support((-x, -y, -z))


def _highest(body: PlacedShape, direction: Vector) -> Vector:
    return body.find_support(direction)


def _draw_vector(draw: random.Random, size: float) -> Vector:
    return draw.uniform(-size, size), draw.uniform(-size, size), draw.uniform(-size, size)


def _draw_direction(draw: random.Random) -> Vector:
    x, y, z = draw.gauss(0, 1), draw.gauss(0, 1), draw.gauss(0, 1)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length
