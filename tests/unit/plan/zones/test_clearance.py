"""Bodies on axes: what bounds say of a box of positions, against many positions in it."""

import math
import random
from collections.abc import Mapping

from orchestrator.model.zone_fields import Vector, ZoneShape
from orchestrator.plan.zones.chain import Body, Box, Joint, LinearPart
from orchestrator.plan.zones.clearance import ROUNDING, PairClearance, Search, find_middle, find_violation
from orchestrator.plan.zones.shapes import make_shape
from orchestrator.plan.zones.vectors import dot, subtract

SHAPES = [
    make_shape(ZoneShape.model_validate(fields))
    for fields in (
        {"box": [4, 9, 2], "at": [3, 0, 1]},
        {"sphere": 3},
        {"cylinder": {"radius": 2, "height": 12}, "direction": "y", "at": [0, 5, 0]},
        {"polygon": {"corners": [[0, 0], [8, 1], [3, 6]], "height": 4}},
    )
]
AXES = ["a.x", "a.y", "b.u", "b.phi"]


def draw_direction(draw: random.Random) -> Vector:
    x, y, z = draw.gauss(0, 1), draw.gauss(0, 1), draw.gauss(0, 1)
    length = math.hypot(x, y, z)
    return x / length, y / length, z / length


def draw_body(draw: random.Random) -> Body:
    """A body on up to four joints, whose ways may each follow two axes, like those of virtual ones."""
    joints: list[Joint] = []
    for _ in range(draw.randrange(1, 5)):
        axes = draw.sample(AXES, draw.randrange(1, 3))
        turns = draw.random() < 0.5
        way = LinearPart(
            tuple((axis, draw.uniform(-1, 1) * (0.05 if turns else 1.0)) for axis in axes), draw.uniform(-1, 1)
        )
        through = (draw.uniform(-9, 9), draw.uniform(-9, 9), draw.uniform(-9, 9)) if turns else None
        joints.append(Joint(way, draw_direction(draw), through))
    return Body("body", draw.choice(SHAPES), tuple(joints))


def draw_box(draw: random.Random, size: float) -> Box:
    box: dict[str, tuple[float, float]] = {}
    for axis in AXES:
        low = draw.uniform(-30, 30)
        box[axis] = low, low + draw.uniform(0, size)
    return box


def draw_positions(draw: random.Random, box: Box) -> Mapping[str, float]:
    """Positions in a box, often at its ends."""
    return {axis: draw.choice([low, high, draw.uniform(low, high)]) for axis, (low, high) in box.items()}


def test_no_point_moves_farther_than_its_rates_say() -> None:
    draw, worst = random.Random(573), 0.0
    for _ in range(300):
        body, box = draw_body(draw), draw_box(draw, draw.choice([0.1, 5.0, 40.0]))
        middle, rates = find_middle(box), body.find_rates(box)
        begin = body.place_at(middle)
        for _ in range(20):
            positions, direction, point = draw_positions(draw, box), draw_direction(draw), draw_direction(draw)
            corner = body.shape.find_support(point)
            moved = subtract(body.place_at(positions).pose.place(corner), begin.pose.place(corner))
            bound = sum(
                (abs(dot(rates.along.get(axis, (0.0, 0.0, 0.0)), direction)) + rates.beside.get(axis, 0.0))
                * abs(positions[axis] - middle[axis])
                for axis in AXES
            )
            way = dot(moved, direction)
            assert way <= bound + 1e-9
            worst = max(worst, way / bound if bound > 1e-9 else 0.0)
    assert worst > 0.9, "the bounds are not so wide that they say nothing"


def test_a_box_that_is_said_to_be_clear_has_no_place_that_is_not() -> None:
    draw = random.Random(574)
    counts = {True: 0, False: 0}
    for _ in range(60):
        pair = PairClearance(draw_body(draw), draw_body(draw), draw.uniform(1, 20))
        box = draw_box(draw, draw.choice([1.0, 10.0]))
        positions = find_violation(Search(100_000), pair, box)
        counts[positions is None] += 1
        if positions is None:
            for _ in range(60):
                assert pair.find_distance(draw_positions(draw, box))[1] >= pair.distance - ROUNDING
        else:
            # A place that is refused is too near, but for what a box is not divided for.
            assert all(box[axis][0] <= position <= box[axis][1] for axis, position in positions.items())
            assert pair.find_distance(positions)[0] < pair.distance + 1e-3
    assert min(counts.values()) > 10


def test_what_carries_both_moves_neither_against_the_other() -> None:
    carrier = Joint(LinearPart((("a.x", 1.0),), 0.0), (1.0, 0.0, 0.0))
    turning = Joint(LinearPart((("b.phi", 0.1),), 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    slide = Joint(LinearPart((("a.y", 1.0),), 0.0), (0.0, 1.0, 0.0))
    pair = PairClearance(
        Body("one", SHAPES[0], (carrier, turning)), Body("two", SHAPES[1], (carrier, turning, slide)), 1
    )
    assert pair.axes == ["a.y"]


def test_motion_along_a_wall_is_clear_at_one_look() -> None:
    """The distance does not change by it: a bound by lengths of ways alone would divide its box many times."""
    slide = Joint(LinearPart((("a.x", 1.0),), 0.0), (1.0, 0.0, 0.0))
    wall = Body("wall", make_shape(ZoneShape.model_validate({"box": [1000, 1, 50], "at": [0, 10, 0]})))
    search, pair = Search(), PairClearance(Body("ball", SHAPES[1], (slide,)), wall, 6.5)
    assert find_violation(search, pair, {"a.x": (-400.0, 400.0)}) is None and search.looks == 1
    pair.distance = 6.6
    assert find_violation(search, pair, {"a.x": (-400.0, 400.0)}) is not None
