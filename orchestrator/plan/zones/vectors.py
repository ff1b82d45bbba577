"""Vectors and rotations of three numbers, without arrays: of so few numbers a tuple is quicker."""

import math

from orchestrator.model.zone_fields import Vector

Rotation = tuple[Vector, Vector, Vector]
"""Rows of a rotation matrix."""
NO_TURN: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
ORIGIN: Vector = (0.0, 0.0, 0.0)


def add(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


def subtract(a: Vector, b: Vector) -> Vector:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def scale(a: Vector, factor: float) -> Vector:
    return a[0] * factor, a[1] * factor, a[2] * factor


def dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


def length(a: Vector) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


def turn(rotation: Rotation, a: Vector) -> Vector:
    """The vector, turned."""
    return dot(rotation[0], a), dot(rotation[1], a), dot(rotation[2], a)


def turn_back(rotation: Rotation, a: Vector) -> Vector:
    """The vector, turned by the inverse."""
    (x, y, z), (u, v, w), (p, q, r) = rotation
    return x * a[0] + u * a[1] + p * a[2], y * a[0] + v * a[1] + q * a[2], z * a[0] + w * a[1] + r * a[2]


def chain(first: Rotation, second: Rotation) -> Rotation:
    """The rotation that turns by `second`, and then by `first`."""
    columns = tuple(zip(*second, strict=True))
    x, y, z = ((dot(row, columns[0]), dot(row, columns[1]), dot(row, columns[2])) for row in first)
    return x, y, z


def make_rotation(axis: Vector, angle: float) -> Rotation:
    """The right-handed rotation about a direction of length 1, rad (Rodrigues)."""
    cosine, sine = math.cos(angle), math.sin(angle)
    x, y, z = axis
    complement = 1.0 - cosine
    return (
        (cosine + x * x * complement, x * y * complement - z * sine, x * z * complement + y * sine),
        (y * x * complement + z * sine, cosine + y * y * complement, y * z * complement - x * sine),
        (z * x * complement - y * sine, z * y * complement + x * sine, cosine + z * z * complement),
    )
