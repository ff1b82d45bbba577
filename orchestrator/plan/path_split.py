"""A path with members that move from rest to rest only, as paths one after the other.

Such a member takes part in lines that begin and end at rest: each of them is a path of its own, on one trapezoid of all
members. The pieces between, in which none of these members moves, stay together.
"""

from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.frame import FrameSpec
from orchestrator.model.names import controller_of
from orchestrator.model.paths.packed import pack_pieces
from orchestrator.model.paths.pieces import ArcPiece, HelixPiece, LinePiece, Piece, SplinePiece, TablePiece, Within
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import Unit, UnitError, parse_quantity

Point = Sequence[int | float | str]


def split_path(
    step: FollowPath, rest_only: Collection[str], units: Mapping[str, Unit], frames: Mapping[str, FrameSpec]
) -> list[FollowPath]:
    """The paths that a path becomes. rest_only: the axes of members that move from rest to rest only; units: of all
    axes. Raises `Refusal`, code `path-class`, for a piece that hinders."""
    mover = _Mover(step, rest_only, units, frames)
    begin: Point = step.start
    parts: list[tuple[Point, list[Piece]]] = []
    is_alone = True  # the piece before is a line by itself, or there is none
    for number, piece in enumerate(step.pieces):
        moved_axes = mover.find_moved(begin, piece)
        if moved_axes:
            _require_rest(step, number, moved_axes)
        if moved_axes or is_alone:
            parts.append((begin, []))
        parts[-1][1].append(piece)
        begin, is_alone = _find_end(piece), bool(moved_axes)
    paths: list[FollowPath] = []
    first = 0
    for start, pieces in parts:
        source = None if step.source is None else step.source.cut(first, len(pieces))
        paths.append(step.model_copy(update={"start": list(start), "pieces": pack_pieces(pieces), "source": source}))
        first += len(pieces)
    return paths


def _require_rest(step: FollowPath, number: int, moved: list[str]) -> None:
    """Raise `Refusal` for a piece that is no line from rest to rest."""
    piece, hindrance = step.pieces[number], ""
    if not isinstance(piece, LinePiece):
        hindrance = f"is {'an' if piece.piece == 'arc' else 'a'} {piece.piece}"
    elif number and _is_rounded(step, number - 1):
        hindrance = f"begins in the rounded corner behind piece {number}"
    elif number < len(step.pieces) - 1 and _is_rounded(step, number):
        hindrance = "ends in a rounded corner"
    if hindrance:
        raise Refusal(
            "path-class",
            f"piece {number + 1} moves axis {moved[0]}, whose controller executes moves from rest to rest only, and it "
            f"{hindrance}",
            "write lines with `corner: stop` at both ends where this axis moves, or leave it out; if its make can "
            "follow positions (CiA 402, SMC-4000, SMC-2000), add `jerk` to its limits",
            controller_of(moved[0]),
        )


def _is_rounded(step: FollowPath, number: int) -> bool:
    """Whether the corner behind a piece is rounded."""
    corner = step.pieces[number].corner
    return isinstance(step.corner if corner is None else corner, Within)


def _find_end(piece: Piece) -> Point:
    if isinstance(piece, SplinePiece):
        return piece.through[-1]
    return piece.positions[-1] if isinstance(piece, TablePiece) else piece.to


class _Mover:
    """Finds which axes of rest-to-rest members a piece moves."""

    def __init__(
        self,
        step: FollowPath,
        rest_only: Collection[str],
        units: Mapping[str, Unit],
        frames: Mapping[str, FrameSpec],
    ) -> None:
        self._step = step
        self._rest_only = [axis for axis in step.axes if axis in rest_only]
        frame = None if step.frame is None else frames.get(step.frame)
        self._units = [units[axis] for axis in step.axes] if frame is None else [frame.unit] * len(step.axes)
        self._names = step.axes if frame is None else frame.coordinates
        influences: Any = np.eye(len(step.axes)) if frame is None else frame.find_influences()
        # By axis, the coordinates that it follows.
        self._follows = {axis: row > 0.0 for axis, row in zip(step.axes, influences, strict=True)}

    def find_moved(self, begin: Point, piece: Piece) -> list[str]:
        """Those axes that the piece moves."""
        points: list[Point] = [_find_end(piece)]
        curved_axes: list[str] = []
        if isinstance(piece, SplinePiece):
            points = list(piece.through)
        elif isinstance(piece, TablePiece):
            points = list(piece.positions)
        elif isinstance(piece, ArcPiece) and piece.through is not None:
            points.append(piece.through)
        elif isinstance(piece, ArcPiece | HelixPiece):
            curved_axes = piece.plane or self._names[:2]
        changes = np.array([name in curved_axes for name in self._names])
        at = self._parse(begin)
        for point in points:
            changes |= self._parse(point) != at
        return [axis for axis in self._rest_only if (changes & self._follows[axis]).any()]

    def _parse(self, point: Point) -> Any:
        try:
            return np.array([float(parse_quantity(text, unit)) for text, unit in zip(point, self._units, strict=True)])
        except UnitError as error:
            raise Refusal("bad-unit", str(error), "correct the unit") from None
