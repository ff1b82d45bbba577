"""Points in blocks of rows, and the extremes of a table of them, found block by block."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from orchestrator.model.errors import Refusal
from orchestrator.model.steps.points import PointAxis, PointColumn

ROWS_AT_ONCE = 4096  # points in a block

Rows = NDArray[np.float64]
"""A block of points: a row a point, a column an axis."""


class ColumnSummary:
    """Finds the extremes of each column of points."""

    def __init__(self, axes: Sequence[PointAxis]) -> None:
        self._axes = axes
        self.count = 0
        self._least: list[tuple[float, int]] = []
        self._most: list[tuple[float, int]] = []
        self._steps: tuple[Rows, Rows] | None = None
        self._first: Rows | None = None
        self._last: Rows | None = None

    def add_rows(self, rows: Rows) -> None:
        """Add points. Raises `Refusal`, code `not-finite`, naming the point."""
        if not len(rows):
            return
        finite = np.isfinite(rows)
        if not finite.all():
            row, column = (int(index) for index in np.argwhere(~finite)[0])
            axis = self._axes[column].axis
            text = f"point {self.count + row + 1}: the position of {axis} is {rows[row, column]}, which is not finite"
            raise Refusal("not-finite", text, "correct the point")
        low, high = rows.argmin(axis=0), rows.argmax(axis=0)
        least = [(float(rows[row, k]), self.count + int(row) + 1) for k, row in enumerate(low)]
        most = [(float(rows[row, k]), self.count + int(row) + 1) for k, row in enumerate(high)]
        # The first of equal ones: numbers of points grow.
        self._least = [min(pair) for pair in zip(self._least or least, least, strict=True)]
        self._most = [
            max(pair, key=lambda candidate: (candidate[0], -candidate[1]))
            for pair in zip(self._most or most, most, strict=True)
        ]
        joined_rows = rows if self._last is None else np.vstack((self._last, rows))
        if len(joined_rows) > 1:
            steps = np.abs(np.diff(joined_rows, axis=0))
            least_step, most_step = steps.min(axis=0), steps.max(axis=0)
            if self._steps is not None:
                least_step, most_step = np.minimum(self._steps[0], least_step), np.maximum(self._steps[1], most_step)
            self._steps = least_step, most_step
        if self._first is None:
            self._first = rows[0].copy()
        self._last = rows[-1].copy()
        self.count += len(rows)

    def make_columns(self) -> list[PointColumn]:
        """The extremes of the points that were added, at least one."""
        assert self._first is not None and self._last is not None
        zero = np.zeros(len(self._axes))
        least_step, most_step = self._steps or (zero, zero)
        return [
            PointColumn(
                axis=axis.axis,
                unit=axis.unit,
                least=self._least[k][0],
                least_at=self._least[k][1],
                most=self._most[k][0],
                most_at=self._most[k][1],
                first=float(self._first[k]),
                last=float(self._last[k]),
                least_step=float(least_step[k]),
                most_step=float(most_step[k]),
            )
            for k, axis in enumerate(self._axes)
        ]
