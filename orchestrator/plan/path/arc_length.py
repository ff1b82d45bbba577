"""Arc length of polynomial curves, and its inverse.

A curve is x(u) = sum of c_k u^k, u from 0 to 1, of degree 5 at most. Its length is integrated cell by cell: `CELLS`
equal cells in u, five-point Gauss-Legendre in each. A row of coefficients has the shape (6, coordinates).
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Flags = NDArray[np.bool_]

CELLS = 16
DEGREE = 5
KNOTS: Array = np.linspace(0.0, 1.0, CELLS + 1)
# The error of a five-point rule falls by 2^10 where cells are halved: this one between 8 and 16 cells leaves 1e-10.
COARSE_ERROR = 1e-7
NEWTON_ROUNDS = 3
BLOCK = 128  # curves measured at a time: their derivatives stay in the processor's cache

_RULE = np.polynomial.legendre.leggauss(5)
POINTS: Array = (_RULE[0] + 1.0) / 2.0
WEIGHTS: Array = _RULE[1] / 2.0


def _list_powers(u: Array) -> Array:
    """The factors of c_0 … c_5 in x'(u), one row per u."""
    powers = np.zeros((len(u), DEGREE + 1))
    for k in range(1, DEGREE + 1):
        powers[:, k] = k * u ** (k - 1)
    return powers


_FINE = _list_powers(((np.arange(CELLS)[:, None] + POINTS) / CELLS).ravel())
_COARSE = _list_powers(((np.arange(CELLS // 2)[:, None] + POINTS) / (CELLS // 2)).ravel())
_AT_KNOTS = _list_powers(KNOTS)


class LengthTable(NamedTuple):
    """Lengths from u = 0 to each knot, and |x'(u)| there; one row per curve. error: of each whole length, relative,
    as estimated from half as many cells; slowest: the smallest |x'(u)|."""

    lengths: Array
    speeds: Array
    error: Array
    slowest: Array


def measure_curves(coefficients: Array) -> LengthTable:
    """Measure curves of shape (n, 6, coordinates)."""
    if len(coefficients) <= BLOCK:
        return _measure_block(coefficients)
    parts = [_measure_block(coefficients[k : k + BLOCK]) for k in range(0, len(coefficients), BLOCK)]
    return LengthTable(*(np.concatenate(part) for part in zip(*parts, strict=True)))


def _measure_block(coefficients: Array) -> LengthTable:
    n = len(coefficients)
    fine = np.linalg.norm(_FINE @ coefficients, axis=2)
    lengths = np.zeros((n, CELLS + 1))
    np.cumsum(fine.reshape(n, CELLS, 5) @ WEIGHTS / CELLS, axis=1, out=lengths[:, 1:])
    coarse = (np.linalg.norm(_COARSE @ coefficients, axis=2).reshape(n, CELLS // 2, 5) @ WEIGHTS).sum(axis=1)
    totals = lengths[:, -1]
    error = np.abs(coarse / (CELLS // 2) - totals) / np.maximum(totals, 1e-300)
    speeds = np.linalg.norm(_AT_KNOTS @ coefficients, axis=2)
    return LengthTable(lengths, speeds, error, np.minimum(fine.min(axis=1), speeds.min(axis=1)))


def split_curves(coefficients: Array) -> Array:
    """Each curve as two, both with u from 0 to 1: shape (n, 2, 6, coordinates)."""
    first = coefficients * (0.5 ** np.arange(DEGREE + 1))[:, None]
    second = np.zeros_like(first)
    # x(1/2 + u/2): the binomial expansion of (1 + u)^k on the scaled coefficients.
    for k in range(DEGREE + 1):
        row = 1
        for j in range(k + 1):
            second[:, j] += row * first[:, k]
            row = row * (k - j) // (j + 1)
    return np.stack([first, second], axis=1)


def find_parameters(coefficients: Array, table: LengthTable, row: Index, length: Array, rounds: int) -> Array:
    """The u at which each curve `row` has gone `length`.

    A cubic Hermite interpolation of u by length (1e-6 on the curves of blends), then `rounds` of Newton on the
    integrated length.
    """
    knots, speeds = table.lengths[row], table.speeds[row]
    cell = np.clip((knots[:, 1:-1] <= length[:, None]).sum(axis=1), 0, CELLS - 1)
    at = np.arange(len(row))
    begin = knots[at, cell]
    span = knots[at, cell + 1] - begin
    x = np.clip((length - begin) / span, 0.0, 1.0)
    slope_0, slope_1 = span / speeds[at, cell], span / speeds[at, cell + 1]
    rise = 1.0 / CELLS
    u = cell / CELLS + x * (slope_0 + x * (3 * rise - 2 * slope_0 - slope_1 + x * (slope_0 + slope_1 - 2 * rise)))
    for _ in range(rounds):
        from_knot = cell / CELLS
        width = u - from_knot
        parameters = (from_knot[:, None] + width[:, None] * POINTS).ravel()
        rows = np.repeat(row, len(POINTS))
        speed = np.linalg.norm(evaluate_slopes(coefficients, rows, parameters), axis=1).reshape(-1, len(POINTS))
        missing_length = length - begin - width * (speed @ WEIGHTS)
        u += missing_length / np.linalg.norm(evaluate_slopes(coefficients, row, u), axis=1)
    return np.clip(u, 0.0, 1.0)


def evaluate_slopes(coefficients: Array, row: Index, u: Array) -> Array:
    """x'(u) of the curves `row`."""
    c = coefficients[row]
    w = u[:, None]
    return c[:, 1] + w * (2 * c[:, 2] + w * (3 * c[:, 3] + w * (4 * c[:, 4] + w * (5 * c[:, 5]))))


def find_lengths(coefficients: Array, table: LengthTable, row: Index, u: Array) -> Array:
    """The length of each curve `row` from its start to `u`."""
    cell = np.clip((u * CELLS).astype(np.int64), 0, CELLS - 1)
    from_knot = cell / CELLS
    width = u - from_knot
    parameters = (from_knot[:, None] + width[:, None] * POINTS).ravel()
    slopes = evaluate_slopes(coefficients, np.repeat(row, len(POINTS)), parameters)
    speed = np.linalg.norm(slopes, axis=1).reshape(-1, len(POINTS))
    return table.lengths[row, cell] + width * (speed @ WEIGHTS)
