"""A table of errors of position as a function of the position of a motor, and its inverse."""

import math
from bisect import bisect_right
from collections.abc import Sequence
from fractions import Fraction
from functools import cached_property
from typing import TypeVar

import numpy as np

from orchestrator.model.tables.cubic import Array, find_cubic_slopes

FIXED_POINT_STEPS = 16  # each makes the distance smaller by the slope of the table
HALVINGS = 60  # of the interval of a row, which leave no more than the rounding of a double


class ErrorTable:
    """The error as a function of position. Beyond its ends it stays as it is there."""

    def __init__(
        self,
        positions: Sequence[Fraction],
        errors: Sequence[Fraction],
        uncertainties: Sequence[Fraction],
        *,
        is_cubic: bool = False,
    ) -> None:
        """Rows in the unit of the axis, sorted by position; the error is the actual position minus that of the
        motor."""
        self._positions, self._errors, self._uncertainties = positions, errors, uncertainties
        self._actual = [position + error for position, error in zip(positions, errors, strict=True)]
        self._x, self._e = (np.array([float(value) for value in values]) for values in (self._positions, self._errors))
        self._slopes = find_cubic_slopes(self._x, self._e) if is_cubic else None
        self._rows = [*zip(self._x.tolist(), self._e.tolist(), strict=True)]

    @cached_property
    def slope(self) -> float:
        """The steepest change of the error, without its sign."""
        return max(map(abs, self.find_slopes()))

    @cached_property
    def most_uncertainty(self) -> float:
        """The largest uncertainty of a row."""
        return float(max(self._uncertainties))

    def find_error(self, position: Fraction) -> Fraction:
        """The error at a position: exact between straight lines, else to the rounding of a double."""
        number = bisect_right(self._positions, position)
        if number == 0 or number == len(self._positions):
            return self._errors[0 if number == 0 else -1]
        begin, end = self._positions[number - 1], self._positions[number]
        if self._slopes is None:
            share = (position - begin) / (end - begin)
            return self._errors[number - 1] + share * (self._errors[number] - self._errors[number - 1])
        return Fraction(float(self.evaluate(np.array([float(position)]))[0]))

    def evaluate(self, positions: Array) -> Array:
        """The errors at positions, as doubles."""
        if self._slopes is None:
            return np.interp(positions, self._x, self._e)
        x = np.clip(positions, self._x[0], self._x[-1])
        k = np.clip(np.searchsorted(self._x, x, side="right") - 1, 0, len(self._x) - 2)
        length = self._x[k + 1] - self._x[k]
        u, ends = (x - self._x[k]) / length, (self._e[k], self._e[k + 1])
        return _find_cubic(u, length, ends, (self._slopes[k], self._slopes[k + 1]))

    def find_at(self, position: float) -> tuple[float, float]:
        """The error at one position, and how fast it changes there: `evaluate` and `find_slopes_at` without arrays."""
        x = min(max(position, self._rows[0][0]), self._rows[-1][0])
        k = min(bisect_right(self._rows, (x, math.inf)), len(self._rows) - 1) - 1
        (begin, begin_error), (end, end_error) = self._rows[k], self._rows[k + 1]
        length, is_inside = end - begin, x == position
        u, secant = (x - begin) / length, (end_error - begin_error) / length
        if self._slopes is None:
            return begin_error + u * (end_error - begin_error), secant * is_inside
        slopes = float(self._slopes[k]), float(self._slopes[k + 1])
        error = _find_cubic(u, length, (begin_error, end_error), slopes)
        return error, _find_cubic_slope(u, secant, slopes) * is_inside

    def invert_all(self, actual: Array) -> tuple[Array, Array]:
        """Positions of the motor at which the axis is at `actual`, and how fast it turns there, by the speed of the
        axis."""
        motors = actual
        for _ in range(FIXED_POINT_STEPS):
            motors = actual - self.evaluate(motors)
        return motors, 1 / (1 + self.find_slopes_at(motors))

    def find_slopes_at(self, positions: Array) -> Array:
        """How fast the error changes at positions, by position; 0 beyond the ends."""
        k = np.clip(np.searchsorted(self._x, positions, side="right") - 1, 0, len(self._x) - 2)
        length = self._x[k + 1] - self._x[k]
        secants = (self._e[k + 1] - self._e[k]) / length
        is_inside = (positions >= self._x[0]) & (positions <= self._x[-1])
        if self._slopes is None:
            return secants * is_inside
        u = (positions - self._x[k]) / length
        return _find_cubic_slope(u, secants, (self._slopes[k], self._slopes[k + 1])) * is_inside

    def find_range(self, low: float, high: float) -> tuple[float, float]:
        """The smallest and the largest error between two positions: a curve has them at its rows, or at both ends."""
        inner = self._e[(self._x > low) & (self._x < high)]
        errors = np.append(inner, self.evaluate(np.array([low, high])))
        return float(errors.min()), float(errors.max())

    def list_extremes(self, low: float, high: float) -> list[float]:
        """Where between two positions the error is smallest and largest."""
        positions = np.array([low, high, *self._x[(self._x > low) & (self._x < high)]])
        errors = self.evaluate(positions)
        return sorted({float(positions[errors.argmin()]), float(positions[errors.argmax()])})

    @property
    def span(self) -> float:
        """Between the smallest and the largest error."""
        return float(self._e.max() - self._e.min())

    def find_slopes(self) -> list[float]:
        """The steepest change of the error between each two rows, with its sign."""
        secants = np.diff(self._e) / np.diff(self._x)
        if self._slopes is None:
            return secants.tolist()
        first, last = self._slopes[:-1], self._slopes[1:]
        # The slope of the cubic is a parabola: its largest value is at an end, or at its vertex.
        curvature = 3 * (first + last - 2 * secants)
        linear = 2 * (3 * secants - 2 * first - last)
        vertex = np.divide(-linear, 2 * curvature, out=np.zeros_like(linear), where=curvature != 0).clip(0, 1)
        candidates = np.stack([first, last, first + vertex * (linear + vertex * curvature)])
        return candidates[np.abs(candidates).argmax(axis=0), np.arange(len(secants))].tolist()

    def invert(self, actual: Fraction) -> Fraction:
        """The position of the motor at which the axis is at `actual`."""
        number = bisect_right(self._actual, actual)
        if number == 0 or number == len(self._actual):
            return actual - self._errors[0 if number == 0 else -1]
        begin, end = self._positions[number - 1], self._positions[number]
        actual_begin, actual_end = self._actual[number - 1], self._actual[number]
        if self._slopes is None:
            return begin + (actual - actual_begin) * (end - begin) / (actual_end - actual_begin)
        low, high = float(begin), float(end)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            if middle + float(self.evaluate(np.array([middle]))[0]) < actual:
                low = middle
            else:
                high = middle
        return Fraction(low)


Number = TypeVar("Number", float, Array)


def _find_cubic(u: Number, length: Number, errors: tuple[Number, Number], slopes: tuple[Number, Number]) -> Number:
    """A cubic between two rows at their share `u`. errors, slopes: at both."""
    bend = (1 - u) ** 2 * u * length * slopes[0] - (1 - u) * u * u * length * slopes[1]
    return errors[0] + (3 - 2 * u) * u * u * (errors[1] - errors[0]) + bend


def _find_cubic_slope(u: Number, secant: Number, slopes: tuple[Number, Number]) -> Number:
    return 6 * u * (1 - u) * secant + (1 - u) * (1 - 3 * u) * slopes[0] + u * (3 * u - 2) * slopes[1]
