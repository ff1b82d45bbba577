"""Linear maps of positions, with exact rationals."""

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING

from orchestrator.model.errors import TuttiError
from orchestrator.model.names import split_name

if TYPE_CHECKING:  # numpy, which reading a file does not need
    from orchestrator.model.tables.cross_errors import Box, CrossErrors
    from orchestrator.model.tables.cubic import Array

STEPS = 20  # to the inverse of a map with errors, whose slopes are at most 0.1: as near as doubles are
Matrix = tuple[tuple[Fraction, ...], ...]


@dataclass(frozen=True)
class LinearMap:
    """virtual = matrix x real + offset, in the units of the axes, with rationals: nothing is rounded.

    real, virtual: names of axes in order. inverse: of the matrix.
    """

    real: tuple[str, ...]
    virtual: tuple[str, ...]
    matrix: Matrix
    inverse: Matrix
    offset: tuple[Fraction, ...]

    def to_virtual(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Virtual positions of real ones, in order."""
        return tuple(part + offset for part, offset in zip(_multiply(self.matrix, positions), self.offset, strict=True))

    def to_real(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Real positions of virtual ones, in order."""
        distances = [position - offset for position, offset in zip(positions, self.offset, strict=True)]
        return _multiply(self.inverse, distances)

    def observe(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Virtual positions of real ones, in order, for states: rounded."""
        rows = zip(self.rows, self._offsets, strict=True)
        return tuple(sum(map(float.__mul__, row, positions), offset) for row, offset in rows)

    def find_rows(self, positions: Sequence[float]) -> "Rows":
        """How much each virtual axis moves per unit of each real one: everywhere the same."""
        del positions
        return self.rows

    @property
    def origin(self) -> tuple[Fraction, ...]:
        """Where the real axes are with all virtual ones at 0, without errors."""
        return _multiply(self.inverse, [-offset for offset in self.offset])

    @cached_property
    def rows(self) -> "Rows":
        """The matrix, rounded."""
        return tuple(tuple(map(float, row)) for row in self.matrix)

    @cached_property
    def inverse_rows(self) -> "Rows":
        """The inverse, rounded: a row for each real axis."""
        return tuple(tuple(map(float, row)) for row in self.inverse)

    @cached_property
    def sweeps(self) -> "Rows":
        """How far the parts of the real axes alone would move each virtual axis while one moves by 1 and the others
        stay: a row for the one, a number for each."""
        columns = tuple(zip(*self.inverse_rows, strict=True))
        return tuple(
            tuple(sum(abs(factor * rate) for factor, rate in zip(row, rates, strict=True)) for row in self.rows)
            for rates in columns
        )

    @cached_property
    def _offsets(self) -> tuple[float, ...]:
        return tuple(map(float, self.offset))


@dataclass(frozen=True)
class CorrectedMap(LinearMap):
    """A linear map, near to one that changes nothing, and small errors: virtual = matrix x real + errors(real).

    errors: by tables. box: where its real axes may be, in their units.
    """

    errors: "CrossErrors"
    box: "Box"

    def to_virtual(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Virtual positions of real ones, in order: exact but for the errors, which are rounded to doubles."""
        errors, _ = self.errors.find_at([float(position) for position in positions])
        return tuple(map(Fraction.__add__, super().to_virtual(positions), map(Fraction, errors)))

    def to_real(self, positions: Sequence[Fraction]) -> tuple[Fraction, ...]:
        """Real positions of virtual ones, in order: each step brings them nearer by the slope of the tables."""
        real, errors = super().to_real(positions), list[float]()
        for _ in range(STEPS):
            next_errors, _ = self.errors.find_at([float(position) for position in real])
            if next_errors == errors:
                break
            errors = next_errors
            real = super().to_real(list(map(Fraction.__sub__, positions, map(Fraction, errors))))
        return real

    def observe(self, positions: Sequence[float]) -> tuple[float, ...]:
        """Virtual positions of real ones, in order, for states: rounded."""
        return tuple(map(float.__add__, super().observe(positions), self.errors.find_at(positions)[0]))

    def find_rows(self, positions: Sequence[float]) -> "Rows":
        """How much each virtual axis moves per unit of each real one, at real positions."""
        _, slopes = self.errors.find_at(positions)
        return tuple(tuple(map(float.__add__, row, more)) for row, more in zip(self.rows, slopes, strict=True))

    def explain_offset(self, name: str, offset: Fraction) -> str | None:
        """Why the errors are not known while a real axis has a user offset; None without one."""
        if not offset:
            return None
        group = split_name(self.virtual[0])[0]
        return f"axis {name} has a user offset of {float(offset):g}, and the errors of {group} count from its reference"

    def turn(self, straight: "Array") -> "Array":
        """Where the real axes are, for where they would be without errors: (points, axes)."""
        import numpy as np

        return self.errors.find_real(straight, np.array(self.inverse_rows))

    def straighten(self, positions: "Array") -> "Array":
        """Where the real axes would be without errors, for where they are: the inverse of `turn`."""
        import numpy as np

        return positions + self.errors.evaluate(positions) @ np.array(self.inverse_rows).T

    @cached_property
    def sweeps(self) -> "Rows":
        """Zeros: a jog moves one real axis, and the errors of the others are in `spans`."""
        return ((0.0,) * len(self.real),) * len(self.real)

    @cached_property
    def steepest(self) -> "Rows":
        """How much each virtual axis moves per unit of each real one beside its own, at most: without signs."""
        slopes: list[list[float]] = self.errors.steepest.tolist()
        return tuple(
            tuple(abs(factor - (number == column)) + slope for column, (factor, slope) in enumerate(pairs))
            for number, pairs in enumerate(
                zip(row, more, strict=True) for row, more in zip(self.rows, slopes, strict=True)
            )
        )

    @cached_property
    def factors(self) -> "Rows":
        """How much each virtual axis moves per unit of each real one at most, without signs."""
        return tuple(
            tuple(factor + (number == column) for column, factor in enumerate(row))
            for number, row in enumerate(self.steepest)
        )

    @cached_property
    def spans(self) -> list[float]:
        """How far each virtual axis may be from its position while its own real axis stands, and others move
        anywhere."""
        return self.find_spans(self.box, range(len(self.real)))

    def find_spans(self, box: "Box", moved: Collection[int]) -> list[float]:
        """Between the smallest and the largest difference of each virtual axis from its real one in a box. moved: the
        real axes, by number, that move; the others stand anywhere in it."""
        spans = self.errors.find_spans(box, moved)
        for number, row in enumerate(self.rows):
            for column in moved:
                low, high = box[column]
                spans[number] += abs(row[column] - (number == column)) * (high - low)
        return spans


def chain_maps(outer: LinearMap, inner: Sequence[LinearMap]) -> LinearMap:
    """The map to the real axes of `inner`, for whose virtual axes `outer` counts as real; what is none of them is
    real."""
    owned_names = {name for part in inner for name in part.virtual}
    real = [name for name in outer.real if name not in owned_names]
    positions = {name: number for number, name in enumerate(outer.real)}
    columns = [*real, *(name for part in inner for name in part.real)]
    # The inner map, in the order of the outer one's axes: a row for each of these.
    matrix = [[Fraction(0)] * len(columns) for _ in outer.real]
    offsets = [Fraction(0)] * len(outer.real)
    for name in real:
        matrix[positions[name]][columns.index(name)] = Fraction(1)
    for part in inner:
        for name, row, offset in zip(part.virtual, part.matrix, part.offset, strict=True):
            offsets[positions[name]] = offset
            for axis, factor in zip(part.real, row, strict=True):
                matrix[positions[name]][columns.index(axis)] = factor
    chained_matrix = tuple(tuple(_dot(row, column) for column in zip(*matrix, strict=True)) for row in outer.matrix)
    return LinearMap(tuple(columns), outer.virtual, chained_matrix, invert(chained_matrix), outer.to_virtual(offsets))


def _dot(first: Sequence[Fraction], second: Sequence[Fraction]) -> Fraction:
    return sum((factor * value for factor, value in zip(first, second, strict=True)), Fraction(0))


Rows = tuple[tuple[float, ...], ...]
"""A row for each virtual axis, a number for each real one."""


class MapError(TuttiError, ValueError):
    """Positions that a map of virtual axes has no answer for, or a map that cannot be used."""


class SingularMap(MapError):
    """A matrix that has no useful inverse."""


def find_condition(matrix: "Matrix | Rows") -> float:
    """The condition number with rows and columns of one size, so that units do not count; infinite if singular."""
    import numpy as np

    table = np.array([[float(factor) for factor in row] for row in matrix])
    for axis in (1, 0):
        size = np.abs(table).max(axis=axis, keepdims=True)
        if not size.all():
            return math.inf
        table = table / size
    return float(np.linalg.cond(table))


def invert(matrix: Matrix) -> Matrix:
    """The exact inverse, by Gauss and Jordan. Raises `SingularMap`."""
    size = len(matrix)
    rows = [[*row, *(Fraction(int(i == j)) for j in range(size))] for i, row in enumerate(matrix)]
    for column in range(size):
        pivot = next((i for i in range(column, size) if rows[i][column]), None)
        if pivot is None:
            raise SingularMap("its matrix has no inverse")
        rows[column], rows[pivot] = rows[pivot], rows[column]
        factor = rows[column][column]
        rows[column] = [value / factor for value in rows[column]]
        for i in range(size):
            if i != column and (factor := rows[i][column]):
                rows[i] = [value - factor * top for value, top in zip(rows[i], rows[column], strict=True)]
    return tuple(tuple(row[size:]) for row in rows)


def _multiply(matrix: Matrix, values: Sequence[Fraction]) -> tuple[Fraction, ...]:
    return tuple(_dot(row, values) for row in matrix)
