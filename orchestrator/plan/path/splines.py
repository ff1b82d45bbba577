"""Cubic splines through points: twice continuously differentiable, as polynomials with u from 0 to 1."""

import numpy as np

from orchestrator.plan.path.arc_length import Array


def fit_spline(points: Array, steps: Array) -> Array:
    """Cubics through `points` (n, coordinates), `steps` (n - 1) of the parameter apart: shape (n - 1, 6, coordinates).

    The second derivative is zero at both ends (a natural spline), so that it continues a straight line without a jump
    of curvature. With chord lengths as steps a spline does not overshoot between points of uneven distance.
    """
    return _make_cubics(points, _find_second_derivatives(points, steps), steps)


def _find_second_derivatives(points: Array, steps: Array) -> Array:
    """Solve the tridiagonal equations of a natural spline (the Thomas algorithm)."""
    n = len(points)
    second = np.zeros_like(points)
    if n == 2:
        return second
    slopes = np.diff(points, axis=0) / steps[:, None]
    right = 6.0 * np.diff(slopes, axis=0)
    diagonal = 2.0 * (steps[:-1] + steps[1:])
    for k in range(1, n - 2):
        factor = steps[k] / diagonal[k - 1]
        diagonal[k] -= factor * steps[k]
        right[k] -= factor * right[k - 1]
    for k in range(n - 2, 0, -1):
        second[k] = (right[k - 1] - steps[k] * second[k + 1]) / diagonal[k - 1]
    return second


def _make_cubics(points: Array, second: Array, steps: Array) -> Array:
    cubics = np.zeros((len(steps), 6, points.shape[1]))
    square = (steps**2)[:, None]
    cubics[:, 0] = points[:-1]
    cubics[:, 1] = np.diff(points, axis=0) - square * (2 * second[:-1] + second[1:]) / 6
    cubics[:, 2] = square * second[:-1] / 2
    cubics[:, 3] = square * (second[1:] - second[:-1]) / 6
    return cubics
