"""A table of errors of position over a plane, bilinear between its rows."""

from bisect import bisect_right
from collections.abc import Sequence

import numpy as np

from orchestrator.model.tables.cubic import Array

Index = np.ndarray[tuple[int], np.dtype[np.intp]]


class ErrorGrid:
    """The error as a function of two positions, at the corners of a rectangular grid. Beyond its edges it stays as it
    is there."""

    def __init__(self, first: Array, second: Array, errors: Array, uncertainties: Array) -> None:
        """first, second: the lines of the grid, sorted. errors, uncertainties: (first, second)."""
        self._lines = first, second
        self._errors, self._uncertainties = errors, uncertainties
        self._lists, self._rows = [lines.tolist() for lines in self._lines], errors.tolist()

    @property
    def most_uncertainty(self) -> float:
        """The largest uncertainty of a row."""
        return float(self._uncertainties.max())

    @property
    def steepest(self) -> tuple[float, float]:
        """The steepest change of the error along both positions, without its sign: along a line of the grid, because
        between two of them the slope is one between theirs."""
        first, second = (np.diff(lines) for lines in self._lines)
        along_first = np.abs(np.diff(self._errors, axis=0) / first[:, None]).max()
        along_second = np.abs(np.diff(self._errors, axis=1) / second[None, :]).max()
        return float(along_first), float(along_second)

    def evaluate(self, points: Array) -> Array:
        """The errors at points (points, 2)."""
        (k, u, _), (m, v, _) = (self._locate(column, points[:, column]) for column in (0, 1))
        low = self._errors[k, m] * (1 - v) + self._errors[k, m + 1] * v
        high = self._errors[k + 1, m] * (1 - v) + self._errors[k + 1, m + 1] * v
        return low * (1 - u) + high * u

    def find_slopes_at(self, points: Array) -> Array:
        """How fast the error changes along both positions at points; 0 along one beyond its edge."""
        (k, u, in_first), (m, v, in_second) = (self._locate(column, points[:, column]) for column in (0, 1))
        e = self._errors
        along_first = (e[k + 1, m] - e[k, m]) * (1 - v) + (e[k + 1, m + 1] - e[k, m + 1]) * v
        along_second = (e[k, m + 1] - e[k, m]) * (1 - u) + (e[k + 1, m + 1] - e[k + 1, m]) * u
        first, second = np.diff(self._lines[0])[k], np.diff(self._lines[1])[m]
        return np.stack([along_first / first * in_first, along_second / second * in_second], axis=1)

    def find_at(self, point: Sequence[float]) -> tuple[float, tuple[float, float]]:
        """The error at one point, and how fast it changes along both positions: `evaluate` and `find_slopes_at` without
        arrays."""
        (k, u, first), (m, v, second) = (_locate_one(*pair) for pair in zip(self._lists, point, strict=True))
        low, high = self._rows[k], self._rows[k + 1]
        first_change = (high[m] - low[m]) * (1 - v) + (high[m + 1] - low[m + 1]) * v
        second_change = (low[m + 1] - low[m]) * (1 - u) + (high[m + 1] - high[m]) * u
        error = (low[m] * (1 - v) + low[m + 1] * v) + u * first_change
        return error, (first_change * first, second_change * second)

    def find_range(self, box: Sequence[tuple[float, float]]) -> tuple[float, float]:
        """The smallest and the largest error in a box: where it is cut by the lines of the grid, or at its corners."""
        errors = self.evaluate(self._list_crossings(box))
        return float(errors.min()), float(errors.max())

    def list_extremes(self, box: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
        """Where in a box the error is smallest and largest."""
        points = self._list_crossings(box)
        errors = self.evaluate(points)
        return sorted({(float(x), float(y)) for x, y in points[[errors.argmin(), errors.argmax()]]})

    def _list_crossings(self, box: Sequence[tuple[float, float]]) -> Array:
        """The points of a box at which the error may be extreme."""
        spans: list[Array] = []
        for lines, (low, high) in zip(self._lines, box, strict=True):
            spans.append(np.unique(np.array([low, high, *lines[(lines > low) & (lines < high)].tolist()])))
        return np.stack([part.ravel() for part in np.meshgrid(*spans, indexing="ij")], axis=1)

    def _locate(self, axis: int, positions: Array) -> tuple[Index, Array, Array]:
        """The cells in which positions are, where in these (0 to 1), and whether they are on the grid at all."""
        lines = self._lines[axis]
        x = np.clip(positions, lines[0], lines[-1])
        k = np.clip(np.searchsorted(lines, x, side="right") - 1, 0, len(lines) - 2)
        return k, (x - lines[k]) / (lines[k + 1] - lines[k]), x == positions


def _locate_one(lines: Sequence[float], position: float) -> tuple[int, float, float]:
    """The cell in which a position is, where in it (0 to 1), and the steepness of the share by position; 0 beyond the
    edge."""
    x = min(max(position, lines[0]), lines[-1])
    k = min(bisect_right(lines, x), len(lines) - 1) - 1
    length = lines[k + 1] - lines[k]
    return k, (x - lines[k]) / length, (x == position) / length
