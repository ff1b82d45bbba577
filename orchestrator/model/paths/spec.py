"""A continuous path of several axes, as a request or a file gives it."""

from typing import Self

from pydantic import Field, model_validator

from orchestrator.model.base import Id, Model
from orchestrator.model.frame import MAX_COORDINATES
from orchestrator.model.paths.packed import Pieces
from orchestrator.model.paths.pieces import ArcPiece, Corner, Piece, Point, Rate, SplinePiece, TablePiece


class PathSpec(Model):
    """A continuous path of several axes."""

    axes: list[str] = Field(min_length=1, max_length=MAX_COORDINATES, description="Axes `controller.axis`, in order.")
    frame: Id | None = Field(default=None, description="A frame of the fleet file: points are coordinates in it.")
    start: Point = Field(description="Where the path begins, and the axes stand.")
    pieces: Pieces = Field(min_length=1)
    corner: Corner = Field(default="stop", description="At the end of every piece without a `corner` of its own.")
    speed: Rate | None = Field(default=None, description="The highest speed along the path.")
    acceleration: Rate | None = Field(default=None, description="The highest acceleration along the path.")
    jerk: Rate | None = Field(default=None, description="The highest jerk along the path.")

    @model_validator(mode="after")
    def _check_points(self) -> Self:
        if len(set(self.axes)) != len(self.axes):
            raise ValueError("an axis is named twice in `axes`; name each once")
        if self.start:  # a path in a file that was not read yet may have none
            self._check_width("start", self.start)
        for k, piece in enumerate(self.pieces):
            for name, point in _list_points(piece):
                self._check_width(f"pieces.{k}.{name}", point)
        return self

    def _check_width(self, place: str, point: list[int | float | str]) -> None:
        if len(point) != len(self.axes):
            raise ValueError(f"{place} has {len(point)} values for {len(self.axes)} axes; give one for each")


def _list_points(piece: Piece) -> list[tuple[str, list[int | float | str]]]:
    """The points of a piece, by place."""
    if isinstance(piece, SplinePiece):
        return [(f"through.{k}", point) for k, point in enumerate(piece.through)]
    if isinstance(piece, TablePiece):
        return [(f"positions.{k}", point) for k, point in enumerate(piece.positions)]
    points = [("to", piece.to)]
    if isinstance(piece, ArcPiece) and piece.through is not None:
        points.append(("through", piece.through))
    return points
