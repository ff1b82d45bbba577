"""Compensation of an axis: the play of its drive, and measured errors of position.

An axis has two positions: where its motor is (counts of the controller, divided by the scale), and where
the axis itself is. A table of errors states the difference at positions of the motor, as ISO 230-2 does: the actual
position minus the commanded one. The map between both is strictly monotone, so that it can be inverted.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, cast

from pydantic import BeforeValidator, Field, model_validator

from orchestrator.model.base import Int53, Model, Rational
from orchestrator.model.numbers import Part, UnitNumber
from orchestrator.model.problems import Problem

if TYPE_CHECKING:
    from orchestrator.model.tables.error_table import ErrorTable

MAX_ROWS = 1_000  # of a table
MOST_SLOPE = 0.1  # a larger error is one of the scale, or of the unit in the table
ROUNDING = 1e-9  # of a slope
Approach = Literal["positive", "negative", "none"]


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
    names = ("position", "error", "uncertainty")
    plain = cast(list[Any], row)
    is_row = isinstance(row, list) and 2 <= len(plain) <= len(names)
    return dict(zip(names, plain, strict=False)) if is_row else plain


class Correction(Model):
    """A table of errors of position: in a CSV file beside the fleet file, or listed."""

    file: str | None = Field(
        default=None,
        min_length=1,
        max_length=4096,
        description="A CSV file: a line of names with units, e.g. `position mm, error um, uncertainty um`, then rows.",
    )
    points: Annotated[list[TableRow], BeforeValidator(_read_rows)] = Field(
        default=[],
        max_length=MAX_ROWS,
        description="The rows, instead of `file`: `[position, error]` or `[position, error, uncertainty]`, in the unit "
        "of the axis; error: where the axis is, minus where its motor is.",
    )
    interpolation: Literal["linear", "cubic"] = Field(
        default="linear", description="Between rows: straight lines, or a monotone cubic without steps of the slope."
    )
    max_slope: Part = Field(
        default=0.01, le=MOST_SLOPE, description="The steepest change of the error that is accepted, by position."
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
        problems = list(self._find_row_problems())
        if not problems and self.interpolation == "cubic":
            problems = list(self._find_steep_curves())
        return problems or list(self._find_short_ends(limits[0], limits[1], unit))

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
            if abs(slope) > self.max_slope + ROUNDING:
                yield Problem(("points", number), self._describe_slope(row, slope))

    def _find_steep_curves(self) -> Iterator[Problem]:
        for number, slope in enumerate(self.table.find_slopes()):
            if abs(slope) > self.max_slope + ROUNDING:
                row = self.points[number + 1]
                yield Problem(("points", number + 1), self._describe_slope(row, slope, " of the cubic"))

    def _describe_slope(self, row: TableRow, slope: float, of: str = "") -> str:
        return (
            f"error {float(row.error):g} at {float(row.position):g}: the slope{of} from the row before is {slope:.3g}, "
            f"above max_slope {self.max_slope:g}; check the units and the sign, or raise max_slope, at most to "
            f"{MOST_SLOPE:g}"
        )
