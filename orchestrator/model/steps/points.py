"""The points of a scan: nested axes, or a table; which point comes when, and the form in which they are sent.

Points are counted from 0 here, and from 1 in everything that people read.
"""

import json
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from math import prod
from typing import Annotated, Any, Self

from pydantic import Field, model_validator

from orchestrator.model.base import Int53, Model
from orchestrator.model.names import Target, is_position_name
from orchestrator.model.script import ScriptModel
from orchestrator.model.units import Quantity, Unit, UnitError, parse_quantity, parse_with_unit

MAX_POINTS = 10_000_000  # of one scan
MAX_LISTED = 10_000  # points, or values of an axis, that stand in the job itself
MAX_SCAN_AXES = 32
ROW_TYPE = "<f8"  # of a value in sent and stored points, for numpy: a double, little-endian
VALUE_BYTES = 8
PART_BYTES = 700_000  # of points in one request; some 0.95 MB as text
DIGEST_PATTERN = r"^sha256:[0-9a-f]{64}$"

Finite = Annotated[float, Field(allow_inf_nan=False)]


class ScanAxis(ScriptModel):
    """The positions of one axis of a scan: from one end to the other, or listed."""

    from_: Target | None = Field(
        default=None, alias="from", description="Its first position: a quantity, or the name of a position."
    )
    to: Target | None = Field(default=None, description="Its last position, in the same way.")
    points: int | None = Field(
        default=None, ge=2, le=MAX_POINTS, description="Number of positions, both ends included; with `from` and `to`."
    )
    step: Quantity | None = Field(
        default=None,
        description="Distance of two positions, instead of `points`; it must divide the way, so both ends are "
        "quantities.",
    )
    values: list[Target] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_LISTED,
        description="All positions, instead of `from` and `to`: quantities, or names of positions.",
    )
    bounds: list[Quantity] | None = Field(
        default=None,
        max_length=MAX_LISTED + 1,
        description="With `values`, of an axis that flies along a curve: where it is at the beginning of the window of "
        "the first point, between two windows, and at the end of the last one; one more than `values`.",
    )
    snake: bool = Field(
        default=False, description="Backwards on every second pass of the axes outside it: no way back between passes."
    )

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if self.bounds is not None and len(self.bounds) != len(self.values or []) + 1:
            raise ValueError(f"`bounds` needs `values`, and one more than these; there are {len(self.bounds)}")
        if self.values is not None:
            if (self.from_, self.to, self.points, self.step) != (None,) * 4:
                raise ValueError("has `values`, so `from`, `to`, `points` and `step` have no meaning; remove them")
            return self
        if self.from_ is None or self.to is None:
            raise ValueError("needs `from` and `to`, with `points` or `step`; or `values`")
        if (self.points is None) == (self.step is None):
            raise ValueError("needs either `points`, the number of positions, or `step`, their distance")
        if self.step is not None and (is_position_name(self.from_) or is_position_name(self.to)):
            # The number of points is counted when the job is accepted, and a position may be saved anew after that.
            raise ValueError("`step` needs `from` and `to` as quantities; with the name of a position write `points`")
        if self.step is not None and _count_steps(self.from_, self.to, self.step) >= MAX_POINTS:
            raise ValueError(f"has more than {MAX_POINTS} positions; choose a larger `step`")
        return self

    @property
    def count(self) -> int:
        """The number of positions."""
        if self.values is not None:
            return len(self.values)
        if self.points is not None:
            return self.points
        assert self.from_ is not None and self.to is not None and self.step is not None
        return _count_steps(self.from_, self.to, self.step) + 1

    def position(self, index: int, unit: Unit) -> Fraction:
        """Position number `index` in the axis's unit, exact. Raises `UnitError`, also for a name of a position, which
        is resolved before."""
        if self.values is not None:
            return parse_quantity(self.values[index], unit)
        assert self.from_ is not None and self.to is not None
        first, last = parse_quantity(self.from_, unit), parse_quantity(self.to, unit)
        return first + (last - first) * Fraction(index, max(1, self.count - 1))

    def list_knots(self, unit: Unit) -> list[float]:
        """Its positions on a curve, in its unit: at the beginning of the first window, in its middle, at its end, and
        so on. Raises `UnitError`."""
        values, bounds = (
            [float(parse_quantity(value, unit)) for value in row] for row in (self.values or [], self.bounds or [])
        )
        return [position for pair in zip(bounds, values, strict=False) for position in pair] + bounds[-1:]


def _count_steps(first: float | str, last: float | str, step: float | str) -> int:
    """How many steps lead from `first` to `last`. Raises `ValueError` unless it is a whole number above 0."""
    if len({isinstance(value, str) for value in (first, last, step)}) > 1:
        raise ValueError("give `from`, `to` and `step` either all as numbers or all with a unit")
    try:
        begin, end, size = (_in_step_unit(value, step) for value in (first, last, step))
    except UnitError as error:
        raise ValueError(str(error)) from None
    if size == 0 or (end - begin) / size <= 0:
        raise ValueError("`step` must lead from `from` towards `to`; check its sign")
    steps = (end - begin) / size
    if steps.denominator != 1:
        fitting = float(begin + size * int(steps))
        raise ValueError(f"`step` does not divide the way from `from` to `to`; write `points`, or `to: {fitting:g}`")
    return int(steps)


def _in_step_unit(value: float | str, step: float | str) -> Fraction:
    """The value in the unit of the text `step`; a number as it is."""
    return parse_with_unit(value, step) if isinstance(step, str) else Fraction(str(value))


class PointAxis(Model):
    """A column of points: an axis, and the unit of its values."""

    axis: str
    unit: Unit


def make_header(axes: Sequence[PointAxis]) -> bytes:
    """The line before the rows of sent points; it belongs to the digest: points fit only these axes and units."""
    return json.dumps([axis.to_plain() for axis in axes], separators=(",", ":")).encode() + b"\n"


def find_row_bytes(axes: Sequence["PointAxis | PointColumn"]) -> int:
    """The bytes of one sent or stored point."""
    return len(axes) * VALUE_BYTES


class PointColumn(Model):
    """One axis of stored points, in its unit. …_at: the number of a point there, from 1. least_step, most_step: the
    smallest and the largest distance of two neighbouring points."""

    axis: str
    unit: Unit
    least: Finite
    least_at: Int53
    most: Finite
    most_at: Int53
    first: Finite
    last: Finite
    least_step: Finite = 0.0
    most_step: Finite = 0.0


class PointTable(ScriptModel):
    """The points of a scan as a table: listed here, in a CSV file, or stored by the coordinator.

    A job that is submitted names stored points: the client reads the file, and sends the points before.
    """

    file: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="A CSV file beside the job file: a line of axis names, then one line a point.",
    )
    axes: list[str] | None = Field(default=None, min_length=1, max_length=MAX_SCAN_AXES, description="With `rows`.")
    rows: list[list[Target]] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_LISTED,
        description="One row a point, in the order of `axes`: quantities, or names of positions.",
    )
    digest: str | None = Field(default=None, pattern=DIGEST_PATTERN, description="Of points that are stored already.")
    count: int = Field(default=0, ge=0, le=MAX_POINTS, description="With `digest`: their number.")
    columns: list[PointColumn] = Field(
        default=[],
        max_length=MAX_SCAN_AXES,
        description="With `digest`: axes and extremes; the coordinator finds them itself.",
    )

    @model_validator(mode="after")
    def _one_source(self) -> Self:
        if sum(file is not None for file in (self.file, self.rows, self.digest)) != 1:
            raise ValueError("needs one of `file`, `rows` (with `axes`) and `digest`")
        if (self.rows is None) != (self.axes is None):
            raise ValueError("`axes` names the columns of `rows`; give both or neither")
        if self.digest is not None and (not self.count or not self.columns):
            raise ValueError("`digest` needs `count` and `columns`; write `file`, and the client finds them")
        names = self.axis_names
        if len(set(names)) < len(names):
            raise ValueError("an axis is named twice")
        for number, row in enumerate(self.rows or [], 1):
            if len(row) != len(names):
                raise ValueError(f"point {number} has {len(row)} values for {len(names)} axes")
        return self

    @property
    def axis_names(self) -> list[str]:
        """The axes; none while they are in a file that was not read yet."""
        return list(self.axes or []) if self.digest is None else [column.axis for column in self.columns]

    @property
    def point_count(self) -> int:
        """The number of points; 0 while they are in a file that was not read yet."""
        return self.count if self.rows is None else len(self.rows)


class GridPoints:
    """The points of nested axes, the outermost first: the last axis moves fastest."""

    def __init__(self, axes: Mapping[str, ScanAxis], joint: int = 1) -> None:
        """joint: how many of the last axes are one level, and move together; they have as many positions each."""
        self.axes = axes
        self.counts = [axis.count for axis in axes.values()]
        self._levels = self.counts[: len(self.counts) - joint + 1]
        strides = [prod(self._levels[number + 1 :]) for number in range(len(self._levels))]
        self.strides = [*strides, *strides[-1:] * (joint - 1)]
        self.count = prod(self._levels)

    def find_indices(self, point: int) -> list[int]:
        """The number of the position of each axis at a point."""
        indices: list[int] = []
        for axis, count, stride in zip(self.axes.values(), self.counts, self.strides, strict=True):
            passes, index = divmod(point // stride, count)
            indices.append(count - 1 - index if axis.snake and passes % 2 else index)
        return indices

    def find_position(self, point: int, units: Sequence[Unit]) -> list[Fraction]:
        """The position of each axis at a point, in `units`."""
        indices = self.find_indices(point)
        return [
            axis.position(index, unit) for axis, index, unit in zip(self.axes.values(), indices, units, strict=True)
        ]

    def iterate_ways(self) -> Iterator[tuple[int, list[list[tuple[int, int]]]]]:
        """The kinds of ways between neighbouring points: how often each occurs, and by axis the pairs of positions
        between which it can lead; none for an axis that stands."""
        rounds, last = 1, len(self._levels) - 1
        for moving_level, count in enumerate(self._levels):
            often = rounds * (count - 1)
            rounds *= count
            if not often:
                continue
            moving_end = len(self.axes) if moving_level == last else moving_level + 1
            pairs: list[list[tuple[int, int]]] = [[] for _ in self.axes]
            for number, axis in enumerate(self.axes.values()):
                if moving_level <= number < moving_end:
                    pairs[number] = [(k, k + 1) for k in range(count - 1 if axis.values is not None else 1)]
                elif number >= moving_end and not axis.snake and self.counts[number] > 1:
                    pairs[number] = [(self.counts[number] - 1, 0)]
            yield often, pairs


ScanSpec = Annotated[
    dict[str, Any],
    Field(min_length=1, description="A scan in the JSON form of scanspec 1.x; needs the extra `tutti[scanspec]`."),
]
