"""Errors of axes by the positions of others: straightness, squareness, flatness of a plane."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from orchestrator.model.tables.cubic import Array
from orchestrator.model.tables.error_grid import ErrorGrid
from orchestrator.model.tables.error_table import FIXED_POINT_STEPS, ErrorTable

Box = Sequence[tuple[float, float]]
"""Lowest and highest position along each axis."""


class ErrorFunction(Protocol):
    """An error by one position or by two: points are (points, positions)."""

    @property
    def most_uncertainty(self) -> float: ...

    @property
    def steepest(self) -> Sequence[float]: ...

    def evaluate(self, points: Array, /) -> Array: ...

    def find_slopes_at(self, points: Array, /) -> Array: ...

    def find_at(self, point: Sequence[float], /) -> tuple[float, Sequence[float]]: ...

    def find_range(self, box: Box, /) -> tuple[float, float]: ...

    def list_extremes(self, box: Box, /) -> Sequence[Sequence[float]]: ...


@dataclass(frozen=True)
class ErrorLine:
    """A table by one position as such a function."""

    table: ErrorTable

    @property
    def most_uncertainty(self) -> float:
        """The largest uncertainty of a row."""
        return self.table.most_uncertainty

    @property
    def steepest(self) -> Sequence[float]:
        """The steepest change of the error, without its sign."""
        return (self.table.slope,)

    def evaluate(self, points: Array) -> Array:
        """The errors at points (points, 1)."""
        return self.table.evaluate(points[:, 0])

    def find_slopes_at(self, points: Array) -> Array:
        """How fast the error changes at points."""
        return self.table.find_slopes_at(points[:, 0])[:, None]

    def find_at(self, point: Sequence[float]) -> tuple[float, Sequence[float]]:
        """The error at one point, and how fast it changes there."""
        error, slope = self.table.find_at(point[0])
        return error, (slope,)

    def find_range(self, box: Box) -> tuple[float, float]:
        """The smallest and the largest error between two positions."""
        return self.table.find_range(*box[0])

    def list_extremes(self, box: Box) -> Sequence[Sequence[float]]:
        """Where between two positions the error is smallest and largest."""
        return [[position] for position in self.table.list_extremes(*box[0])]


def make_grid(rows: Sequence[Sequence[float]]) -> ErrorGrid:
    """The function of a rectangular grid, sorted: position, position, error, and perhaps its uncertainty."""
    table = np.array(rows)
    lines, columns = np.unique(table[:, 0]), np.unique(table[:, 1])
    errors = table[:, 2].reshape(len(lines), len(columns))
    uncertainties = table[:, 3].reshape(errors.shape) if table.shape[1] > 3 else np.zeros_like(errors)
    return ErrorGrid(lines, columns, errors, uncertainties)


@dataclass(frozen=True)
class AxisErrors:
    """One table of a group: the errors of axis number `row` by the positions of the axes `columns`."""

    row: int
    columns: tuple[int, ...]
    function: ErrorFunction

    def cut(self, box: Box) -> Box:
        """The part of a box of all axes that counts."""
        return [box[column] for column in self.columns]


@dataclass(frozen=True)
class CrossErrors:
    """The errors of the axes of a group, in their unit: of each the sum of its tables. size: how many axes."""

    size: int
    parts: tuple[AxisErrors, ...]

    def evaluate(self, positions: Array) -> Array:
        """The errors of all axes at positions of all of them, both (points, axes)."""
        errors = np.zeros_like(positions)
        for part in self.parts:
            errors[:, part.row] += part.function.evaluate(positions[:, part.columns])
        return errors

    def find_slopes_at(self, positions: Array) -> Array:
        """How fast the error of each axis changes by the position of each: (points, axes, axes)."""
        slopes = np.zeros((*positions.shape, self.size))
        for part in self.parts:
            slopes[:, part.row, part.columns] += part.function.find_slopes_at(positions[:, part.columns])
        return slopes

    def find_at(self, positions: Sequence[float]) -> tuple[list[float], list[list[float]]]:
        """The errors of all axes at one place, and how fast each changes by the position of each: `evaluate` and
        `find_slopes_at` without arrays."""
        errors, slopes = [0.0] * self.size, [[0.0] * self.size for _ in range(self.size)]
        for part in self.parts:
            error, changes = part.function.find_at([positions[column] for column in part.columns])
            errors[part.row] += error
            for column, change in zip(part.columns, changes, strict=True):
                slopes[part.row][column] += change
        return errors, slopes

    @cached_property
    def steepest(self) -> Array:
        """The steepest change of the error of each axis by the position of each, without signs: (axes, axes)."""
        slopes = np.zeros((self.size, self.size))
        for part in self.parts:
            slopes[part.row, part.columns] += part.function.steepest
        return slopes

    @cached_property
    def uncertainties(self) -> list[float]:
        """The largest uncertainty of the error of each axis."""
        sums = [0.0] * self.size
        for part in self.parts:
            sums[part.row] += part.function.most_uncertainty
        return sums

    def find_ranges(self, box: Box) -> list[tuple[float, float]]:
        """The smallest and the largest error of each axis in a box of the positions of all."""
        ranges = [(0.0, 0.0)] * self.size
        for part in self.parts:
            low, high = part.function.find_range(part.cut(box))
            ranges[part.row] = ranges[part.row][0] + low, ranges[part.row][1] + high
        return ranges

    def find_spans(self, box: Box, moved: Collection[int]) -> list[float]:
        """Between the smallest and the largest error of each axis in a box, by the tables that axes of `moved` move
        through; the others stand anywhere in it."""
        spans = [0.0] * self.size
        for part in self.parts:
            if not set(moved).isdisjoint(part.columns):
                low, high = part.function.find_range(part.cut(box))
                spans[part.row] += high - low
        return spans

    def list_extremes(self, column: int, box: Box) -> list[float]:
        """Where in a box, along the axis `column`, the error of a table is smallest or largest."""
        positions: set[float] = set()
        for part in self.parts:
            if column in part.columns:
                points = part.function.list_extremes(part.cut(box))
                positions.update(point[part.columns.index(column)] for point in points)
        return sorted(positions)

    def find_real(self, straight: Array, inverse: Array) -> Array:
        """The real positions whose errors, through the inverse of the group's matrix, lead to where a map without them
        has its real axes at `straight`: (points, axes)."""
        real = straight
        for _ in range(FIXED_POINT_STEPS if self.parts else 0):
            next_real = straight - self.evaluate(real) @ inverse.T
            if np.array_equal(next_real, real):
                break
            real = next_real
        return real
