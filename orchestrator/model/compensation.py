"""Compensation of an axis: the play of its drive, and measured errors of position.

An axis has two positions: where its motor is (counts of the controller, divided by the scale), and where
the axis itself is. A table of errors states the difference at positions of the motor, as ISO 230-2 does: the actual
position minus the commanded one. The map between both is strictly monotone, so that it can be inverted.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from pydantic import BeforeValidator, Field, model_validator

from orchestrator.model.base import Id, Int53, Model, Rational
from orchestrator.model.numbers import Part, UnitNumber
from orchestrator.model.problems import Problem

if TYPE_CHECKING:
    from orchestrator.model.tables.cross_errors import ErrorFunction
    from orchestrator.model.tables.error_table import ErrorTable

MAX_ROWS = 1_000  # of a table
MAX_GRID_ROWS = 5_000  # of one by two axes
MOST_SLOPE = 0.1  # a larger error is one of the scale, or of the unit in the table
ROUNDING = 1e-9  # of a slope
COLUMNS = ("position", "error", "uncertainty")
Approach = Literal["positive", "negative", "none"]
UNREAD = "is in a file, and was not read with the fleet; load the fleet from its file, or write its rows as `points`"


class Backlash(Model):
    """Play between the motor of an axis and the axis itself."""

    amount: UnitNumber = Field(description="How far the motor turns after a reversal until the axis follows.")
    speed: UnitNumber | None = Field(
        default=None, description="Of the motor while it takes up the play, unit/s; default: that of the move."
    )
    approach: Approach = Field(
        default="none",
        description="none: the play is added to a move that reverses; positive, negative: moves end in that direction, "
        "after an overrun where they come from the other side.",
    )
    overrun: UnitNumber | None = Field(
        default=None, description="How far beyond the target such a move turns; default: twice the amount."
    )

    @model_validator(mode="after")
    def _check_overrun(self) -> "Backlash":
        if self.overrun_length < self.amount:
            raise ValueError(
                f"overrun ({self.overrun:g}) is below amount ({self.amount:g}), so that it would not take up the play; "
                "raise it"
            )
        return self

    def count_play(self, scale: Fraction, sign: int) -> "Play":
        """The play in counts of a motor with `scale` counts per unit. sign: of counts in positive direction."""
        counts = round(self.amount * float(scale))
        is_ahead = (self.approach == "negative") != (sign > 0)
        return Play(least=0, most=counts) if is_ahead else Play(least=-counts, most=0)

    @property
    def overrun_length(self) -> float:
        """How far beyond its target a move turns that ends in one direction, in the axis's unit."""
        return self.overrun or 2 * self.amount


class Play(Model):
    """By how many counts an axis is ahead of its motor: an interval, ends included. The axis of a drive with play is
    moved along at one end of its range in motions to higher counts (`least`), at the other one in those to lower."""

    least: Int53
    most: Int53

    @property
    def middle(self) -> Fraction:
        """Its middle, which is off by half its width at most."""
        return Fraction(self.least + self.most, 2)

    def follow(self, by: int, whole: "Play") -> "Play":
        """What is left of it after a motion of the motor by `by` counts in one direction. whole: of the drive."""
        least, most = (min(max(end - by, whole.least), whole.most) for end in (self.least, self.most))
        return Play(least=least, most=most)

    def find_target(self, start: int, target: int, whole: "Play") -> int:
        """Where the motor must go from `start` for the axis to be at `target`, in counts. whole: of the drive."""
        if target < start + self.least:
            return target - whole.most
        if self.least == self.most and target == start + self.least:
            return start
        # Where the play is not known to the count, the motor ends in a motion to higher counts.
        return max(start, target - whole.least)


class TableRow(Model):
    """One row of a table, in the unit of the axis."""

    position: Rational
    error: Rational
    uncertainty: Rational = Fraction(0)


def _read_rows(rows: Any) -> Any:
    """Rows as lists, as they stand in a file: position, error, and perhaps its uncertainty."""
    if not isinstance(rows, list):
        return rows
    return [_read_row(row) for row in cast(list[Any], rows)]


def _read_row(row: Any) -> Any:
    plain = cast(list[Any], row)
    is_row = isinstance(row, list) and 2 <= len(plain) <= len(COLUMNS)
    return dict(zip(COLUMNS, plain, strict=False)) if is_row else plain


class TableOptions(Model):
    """What all tables of errors state: in a CSV file beside the fleet file, or with their rows."""

    file: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="A CSV file: a line of names with units, e.g. `position mm, error um, uncertainty um`, then rows.",
    )
    interpolation: Literal["linear", "cubic"] = Field(
        default="linear", description="Between rows: straight lines, or a monotone cubic without steps of the slope."
    )
    max_slope: Part = Field(
        default=0.01, le=MOST_SLOPE, description="The steepest change of the error that is accepted, by position."
    )

    def describe_slope(self, error: Rational, position: str, slope: float, of: str = "") -> str:
        """That a row is too steep, and what to do. of: the interpolation, in words."""
        return (
            f"error {float(error):g} at {position}: the slope{of} from the row before is {slope:.3g}, above max_slope "
            f"{self.max_slope:g}; check the units and the sign, or raise max_slope, at most to {MOST_SLOPE:g}"
        )

    def is_steep(self, slope: float) -> bool:
        """Whether a slope is above the accepted one."""
        return abs(slope) > self.max_slope + ROUNDING


class Correction(TableOptions):
    """A table of errors of position by the position of the axis itself."""

    points: Annotated[list[TableRow], BeforeValidator(_read_rows)] = Field(
        default=[],
        max_length=MAX_ROWS,
        description="The rows, instead of `file`: `[position, error]` or `[position, error, uncertainty]`, in the unit "
        "of the axis; error: where the axis is, minus where its motor is.",
    )

    @cached_property
    def table(self) -> "ErrorTable":
        """The table as a function."""
        from orchestrator.model.tables.error_table import ErrorTable  # numpy, which reading a file does not need

        return ErrorTable(
            [row.position for row in self.points],
            [row.error for row in self.points],
            [row.uncertainty for row in self.points],
            is_cubic=self.interpolation == "cubic",
        )

    def find_problems(self, limits: Sequence[Fraction] | None, unit: str, *, wraps: bool) -> list[Problem]:
        """What is wrong with the table of an axis, its rows by their numbers. limits: the soft limits of the axis, in
        its unit."""
        if wraps:
            return [Problem((), "an axis that wraps cannot have a table yet; remove `wrap` or `correction`")]
        if limits is None:
            return [Problem((), "needs soft_limits, which the table must cover; add them")]
        if self.file is not None:
            return [] if not self.points else [Problem(("file",), "`points` has the rows already; remove one of both")]
        if len(self.points) < 2:
            return [Problem(("points",), f"has {len(self.points)} rows; a table needs at least 2")]
        problems = self.find_row_problems()
        return problems or list(self._find_short_ends(limits[0], limits[1], unit))

    def find_row_problems(self) -> list[Problem]:
        """Rows that are out of order, too steep, or with an uncertainty below 0."""
        problems = list(self._find_row_problems())
        if not problems and self.interpolation == "cubic":
            problems = list(self._find_steep_curves())
        return problems

    def _find_short_ends(self, low: Fraction, high: Fraction, unit: str) -> Iterator[Problem]:
        first, last, number = self.points[0], self.points[-1], len(self.points) - 1
        for row, at, end, is_short in (
            (first, 0, low, first.position + first.error > low),
            (last, number, high, last.position + last.error < high),
        ):
            if is_short:
                text = (
                    f"the table ends at {float(row.position):g} {unit}, and the soft limits reach to {float(end):g} "
                    f"{unit}; measure the rest, or narrow soft_limits"
                )
                yield Problem(("points", at), text)

    def _find_row_problems(self) -> Iterator[Problem]:
        for number, row in enumerate(self.points):
            if row.uncertainty < 0:
                yield Problem(
                    ("points", number), f"uncertainty {float(row.uncertainty):g} is below 0; write it without sign"
                )
            if number == 0:
                continue
            first = self.points[number - 1]
            if row.position <= first.position:
                yield Problem(
                    ("points", number),
                    f"position {float(row.position):g} is not above the one before it, {float(first.position):g}; sort "
                    "the rows by position, and keep one for each",
                )
                continue
            slope = float((row.error - first.error) / (row.position - first.position))
            if self.is_steep(slope):
                yield Problem(("points", number), self._describe_slope(row, slope))

    def _find_steep_curves(self) -> Iterator[Problem]:
        for number, slope in enumerate(self.table.find_slopes()):
            if self.is_steep(slope):
                row = self.points[number + 1]
                yield Problem(("points", number + 1), self._describe_slope(row, slope, " of the cubic"))

    def _describe_slope(self, row: TableRow, slope: float, of: str = "") -> str:
        return self.describe_slope(row.error, f"{float(row.position):g}", slope, of)


def _read_names(names: Any) -> Any:
    """One name, or a list of names."""
    return [names] if isinstance(names, str) else names


class CrossTable(TableOptions):
    """A table of errors of one axis of a group by the position of another one, or of two: straightness, a plane.

    All in the unit of the group, at positions of its real axes; error: where the axis is, minus where its own real axis
    has it.
    """

    axis: Id = Field(description="The axis of the group that has the errors.")
    by: Annotated[list[Id], BeforeValidator(_read_names)] = Field(
        min_length=1, max_length=2, description="The axis by whose position, or two: `[x, y]`."
    )
    points: list[list[Rational]] = Field(
        default=[],
        max_length=MAX_GRID_ROWS,
        description="The rows, instead of `file`: `[position, error]`, by two axes `[position, position, error]`, and "
        "perhaps the uncertainty behind. By two axes: a rectangular grid, sorted, between which it is bilinear.",
    )

    @model_validator(mode="after")
    def _check_axes(self) -> "CrossTable":
        if len(set(self.by)) < len(self.by):
            raise ValueError(f"`by` names {self.by[0]} twice; name two axes")
        if self.by == [self.axis]:
            raise ValueError(
                f"errors of {self.axis} by its own position are the `correction` of its real axis; move the table there"
            )
        if len(self.by) > 1 and self.interpolation == "cubic":
            raise ValueError("a table by two axes is bilinear; leave out `interpolation`")
        return self

    @cached_property
    def function(self) -> "ErrorFunction":
        """The error as a function of the positions of `by`. The rows have no problems."""
        from orchestrator.model.tables.cross_errors import ErrorLine, make_grid

        if len(self.by) == 1:
            return ErrorLine(self._line.table)
        return make_grid([list(map(float, row)) for row in self.points])

    @property
    def _line(self) -> Correction:
        """A table by one position as such a table."""
        rows = [dict(zip(COLUMNS, row, strict=False)) for row in self.points]
        options = {"interpolation": self.interpolation, "max_slope": self.max_slope}
        return Correction.model_validate({"points": rows, **options})

    def find_problems(self, limits: Sequence[Sequence[Fraction] | None], unit: str) -> list[Problem]:
        """What is wrong with the table, its rows by their numbers. limits: the soft limits of the real axes of `by`, in
        `unit`, that of the group."""
        if self.file is not None:
            text = "`points` has the rows already; remove one of both" if self.points else UNREAD
            return [Problem(("file",), text)]
        for name, ends in zip(self.by, limits, strict=True):
            if ends is None:
                return [Problem((), f"the real axis of {name} needs soft_limits, which the table must cover; add them")]
        problems = list(self._find_wrong_rows())
        if not problems:
            problems = self._line.find_row_problems() if len(self.by) == 1 else list(self._find_wrong_grid())
        return problems or list(self._find_short_ends(limits, unit))

    def _find_wrong_rows(self) -> Iterator[Problem]:
        count = len(self.by)
        if len(self.points) < 2:
            yield Problem(("points",), f"has {len(self.points)} rows; a table needs at least 2")
        for number, row in enumerate(self.points):
            if not count + 1 <= len(row) <= count + 2:
                names = ", ".join([*self.by, "error"])
                yield Problem(("points", number), f"has {len(row)} numbers; write {names}, and perhaps its uncertainty")
            elif len(row) != len(self.points[0]):
                text = f"has {len(row)} numbers, and the first row {len(self.points[0])}; write as many in all rows"
                yield Problem(("points", number), text)
            elif count > 1 and len(row) > count + 1 and row[-1] < 0:
                yield Problem(("points", number), f"uncertainty {float(row[-1]):g} is below 0; write it without sign")

    def _find_wrong_grid(self) -> Iterator[Problem]:
        """A row by two positions that is not at the next corner of a rectangular grid, or one that is too steep."""
        lines = list(dict.fromkeys(row[0] for row in self.points))
        columns = [row[1] for row in self.points if row[0] == lines[0]]
        for name, values in zip(self.by, (lines, columns), strict=True):
            if len(values) < 2 or any(second <= first for first, second in pairwise(values)):
                text = f"the grid needs two or more rising values of {name}; sort the rows by {self.by[0]}, then by "
                yield Problem(("points", 0), text + self.by[1])
                return
        corners = [(first, second) for first in lines for second in columns]
        for number, row in enumerate(self.points):
            corner = corners[number] if number < len(corners) else None
            if corner is None or (row[0], row[1]) != corner:
                yield Problem(("points", number), self._describe_corner(row, corner))
                return
        if len(self.points) < len(corners):
            yield Problem(("points", len(self.points) - 1), self._describe_corner(None, corners[len(self.points)]))
            return
        yield from self._find_steep_cells(len(columns))

    def _describe_corner(self, row: Sequence[Fraction] | None, corner: tuple[Fraction, Fraction] | None) -> str:
        names = " and ".join(self.by)
        given_text = "the rows end" if row is None else f"{names} {float(row[0]):g}, {float(row[1]):g}"
        next_text = "" if corner is None else f", where {float(corner[0]):g}, {float(corner[1]):g} would be next"
        return (
            f"{given_text}{next_text}: the grid is not rectangular; give a row for each {self.by[1]} of each "
            f"{self.by[0]}, sorted"
        )

    def _find_steep_cells(self, width: int) -> Iterator[Problem]:
        for number, row in enumerate(self.points):
            neighbours = [(number - width, 0)] if number >= width else []
            neighbours += [(number - 1, 1)] if number % width else []
            for neighbour, column in neighbours:
                distance = row[column] - self.points[neighbour][column]
                slope = float((row[2] - self.points[neighbour][2]) / distance)
                if self.is_steep(slope):
                    corner = f"{float(row[0]):g}, {float(row[1]):g}"
                    text = self.describe_slope(row[2], corner, slope, f" along {self.by[column]}")
                    yield Problem(("points", number), text)

    def _find_short_ends(self, limits: Sequence[Sequence[Fraction] | None], unit: str) -> Iterator[Problem]:
        for column, (name, ends) in enumerate(zip(self.by, limits, strict=True)):
            assert ends is not None
            first, last = (row[column] for row in (self.points[0], self.points[-1]))
            number = len(self.points) - 1
            for position, end, at, is_short in (
                (first, ends[0], 0, first > ends[0]),
                (last, ends[1], number, last < ends[1]),
            ):
                if is_short:
                    text = (
                        f"the table ends at {name} {float(position):g} {unit}, and the soft limits of its real axis "
                        f"reach to {float(end):g} {unit}; measure the rest, or narrow soft_limits"
                    )
                    yield Problem(("points", at), text)
