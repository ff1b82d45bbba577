"""The pieces of a path, and what happens at corners, as a request or a file gives them."""

from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from orchestrator.model.base import Model
from orchestrator.model.frame import MAX_COORDINATES
from orchestrator.model.numbers import split_number
from orchestrator.model.units import Quantity

MAX_PIECES = 100_000
MAX_ROWS = 100_000  # of a table, and points of a spline

Point = Annotated[list[Quantity], Field(min_length=1, max_length=MAX_COORDINATES)]
"""A position: one quantity for each coordinate."""

Pair = Annotated[list[Quantity], Field(min_length=2, max_length=2)]

Rate = Annotated[
    float | Annotated[str, Field(max_length=60)],
    Field(
        description='A number per second (², ³) in the first coordinate\'s unit, or text such as "100 mm/s"; for the '
        'speed of a path also "50 %", of what its axes allow.'
    ),
]


class Within(Model):
    """A corner that is rounded."""

    within: Quantity = Field(description="The greatest distance from the corner.")

    @field_validator("within")
    @classmethod
    def _above_zero(cls, value: int | float | str) -> int | float | str:
        parts = split_number(value) if isinstance(value, str) else (str(value), "")
        if parts is None or not float(parts[0]) > 0.0:
            raise ValueError('a corner is rounded by more than 0; write e.g. "50 um", or `corner: stop`')
        return value


Corner = Literal["stop"] | Within


class PieceBase(Model):
    """Fields of every piece."""

    corner: Corner | None = Field(
        default=None, description="What happens at its end; without it, what the path says. Smooth joints need nothing."
    )
    speed: Quantity | None = Field(
        default=None, description="The highest speed along it, beside that of the path; of two in a corner the lower."
    )


class LinePiece(PieceBase):
    """A straight line."""

    piece: Literal["line"] = "line"
    to: Point


class Turn(PieceBase):
    """Fields of an arc about a centre."""

    plane: list[str] | None = Field(
        default=None,
        min_length=2,
        max_length=2,
        description="The two coordinates (axes without a frame) of its plane; the first two without it.",
    )
    direction: Literal["ccw", "cw"] = Field(
        default="ccw", description="ccw: from the first coordinate of the plane towards the second."
    )


class ArcPiece(Turn):
    """An arc: through a point, or about a centre in a plane. An end at its start is a full circle about its centre."""

    piece: Literal["arc"] = "arc"
    to: Point
    through: Point | None = Field(default=None, description="A point on the arc, in any plane.")
    centre: Pair | None = Field(default=None, description="The centre, in the plane.")

    @model_validator(mode="after")
    def _one_form(self) -> Self:
        if (self.through is None) == (self.centre is None):
            raise ValueError("needs either `through`, a point on the arc, or `centre`")
        if self.through is not None and (self.plane, self.direction) != (None, "ccw"):
            raise ValueError("has `through`, so `plane` and `direction` have no meaning; remove them")
        return self


class HelixPiece(Turn):
    """An arc about a centre in a plane, while the other coordinates go evenly to their ends."""

    piece: Literal["helix"] = "helix"
    to: Point
    centre: Pair
    turns: int = Field(default=0, ge=0, le=10_000, description="Full turns in addition to the arc to its end.")


class SplinePiece(PieceBase):
    """A cubic spline through points, without jumps of curvature; straight at both ends."""

    piece: Literal["spline"] = "spline"
    through: list[Point] = Field(min_length=1, max_length=MAX_ROWS, description="Points, the last one its end.")


class TablePiece(PieceBase):
    """Positions at instants, from rest to rest: the time law is the table's, and it is only checked."""

    piece: Literal["table"] = "table"
    t: list[float] = Field(min_length=2, max_length=MAX_ROWS, description="Seconds, growing.")
    positions: list[Point] = Field(min_length=2, max_length=MAX_ROWS, description="One row for each instant.")

    @model_validator(mode="after")
    def _growing(self) -> Self:
        if len(self.t) != len(self.positions):
            raise ValueError(f"has {len(self.t)} instants and {len(self.positions)} positions; give as many of both")
        if self.corner is not None and self.corner != "stop":
            raise ValueError("a table ends at rest; its corner can only be `stop`")
        if self.speed is not None:
            raise ValueError("a table has the speeds of its instants; remove `speed`")
        for k in range(1, len(self.t)):
            if not self.t[k] > self.t[k - 1]:
                raise ValueError(
                    f"goes back in time: row {k + 1} is at {self.t[k]:g} s, after row {k} at {self.t[k - 1]:g} s; "
                    "instants must grow"
                )
        return self


Piece = Annotated[LinePiece | ArcPiece | HelixPiece | SplinePiece | TablePiece, Field(discriminator="piece")]
