"""The distance of two convex bodies between two bounds, by the algorithm of Gilbert, Johnson and Keerthi (1988).

The lower bound is that of a separating plane, which the supports of both bodies prove by themselves: an inexact result
of the iteration makes it lower, and never wrong. The upper bound is the distance of two points of the bodies.
"""

from collections.abc import Callable, Sequence
from itertools import combinations
from typing import NamedTuple

from orchestrator.model.zone_fields import Vector
from orchestrator.plan.zones.vectors import add, dot, length, scale, subtract

MAX_ROUNDS = 40
NEAR = 1e-10
"""Of the bodies' size: nearer together than that, bounds are the distance."""
ROUNDED = 1e-12
"""Of the bodies' size: supports are rounded by less."""
Support = Callable[[Vector], Vector]


class Separation(NamedTuple):
    """The distance is from `least` to `most`, mm; `direction` of length 1 is that from the second body to the first in
    which `least` was found. Of bodies that overlap both are 0."""

    least: float
    most: float
    direction: Vector


def find_separation(
    first: Support, second: Support, begin: Vector, size: float, enough: float | None = None
) -> Separation:
    """The distance of two bodies. begin: from about the second one to the first. size: of both together, mm. enough: a
    distance; ends as soon as the true one is known to be smaller, or not smaller."""

    def support(direction: Vector) -> Vector:
        """The point of the difference of both bodies that is farthest in a direction."""
        return subtract(first(direction), second(scale(direction, -1.0)))

    width = length(begin)
    direction = scale(begin, 1.0 / width) if width > 0.0 else (1.0, 0.0, 0.0)
    nearest = support(scale(direction, -1.0))
    corners, least, best_direction = [nearest], 0.0, direction
    for _ in range(MAX_ROUNDS):
        most = length(nearest)
        if most <= NEAR * size:
            return Separation(0.0, 0.0, best_direction)
        direction = scale(nearest, 1.0 / most)
        corner = support(scale(direction, -1.0))
        gap = dot(corner, direction) - ROUNDED * size
        if gap > least:
            least, best_direction = gap, direction
        if most - least <= 4 * NEAR * size or (enough is not None and (least >= enough or most < enough)):
            break
        if corner in corners:  # rounding: no corner is nearer
            break
        nearest, corners = _find_nearest([*corners, corner])
    return Separation(least, length(nearest), best_direction)


def _find_nearest(corners: Sequence[Vector]) -> tuple[Vector, list[Vector]]:
    """The point of a simplex that is nearest to the origin, and the corners of the part that it is in."""
    best, best_part = corners[0], [corners[0]]
    best_square = dot(best, best)
    for count in range(1, len(corners) + 1):
        for part in combinations(corners, count):
            point = _project(part)
            if point is not None and (square := dot(point, point)) < best_square:
                best, best_part, best_square = point, list(part), square
    if len(best_part) > 3:
        return (0.0, 0.0, 0.0), best_part
    return best, best_part


def _project(part: Sequence[Vector]) -> Vector | None:
    """The origin projected on the plane, line or point of corners; None where it is not between them."""
    first, corners = part[0], part[1:]
    if not corners:
        return first
    edges = [subtract(corner, first) for corner in corners]
    weights = _solve([[dot(a, b) for b in edges] for a in edges], [-dot(first, edge) for edge in edges])
    if weights is None or any(weight < 0.0 for weight in weights) or sum(weights) > 1.0:
        return None
    point = first
    for edge, weight in zip(edges, weights, strict=True):
        point = add(point, scale(edge, weight))
    return point


def _solve(matrix: Sequence[Sequence[float]], values: Sequence[float]) -> list[float] | None:
    """Solve at most three equations by Cramer's rule; None for corners on one line or plane."""
    if len(values) == 1:
        return None if matrix[0][0] <= 0.0 else [values[0] / matrix[0][0]]
    determinant = _find_determinant(matrix)
    if abs(determinant) <= 1e-14 * _multiply_diagonal(matrix):
        return None
    solutions: list[float] = []
    for column in range(len(values)):
        replaced_matrix = [
            [values[row] if number == column else entry for number, entry in enumerate(entries)]
            for row, entries in enumerate(matrix)
        ]
        solutions.append(_find_determinant(replaced_matrix) / determinant)
    return solutions


def _multiply_diagonal(matrix: Sequence[Sequence[float]]) -> float:
    product = 1.0
    for number, row in enumerate(matrix):
        product *= row[number]
    return product


def _find_determinant(matrix: Sequence[Sequence[float]]) -> float:
    if len(matrix) == 2:
        return matrix[0][0] * matrix[1][1] - matrix[0][1] * matrix[1][0]
    (a, b, c), (d, e, f), (g, h, i) = matrix
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
