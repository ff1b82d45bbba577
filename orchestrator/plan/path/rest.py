"""Where on a path its axes stood, and the rest of it from there."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi
from typing import Any

import numpy as np

from orchestrator.model.paths.circles import ROUNDING_MM
from orchestrator.model.paths.packed import pack_pieces
from orchestrator.model.paths.pieces import ArcPiece, HelixPiece, LinePiece, Piece
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.units import Unit
from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.curves import ARC
from orchestrator.plan.path.outline import Outline
from orchestrator.plan.path.resolve import ResolvedPath
from orchestrator.plan.path.traces import PathTrace

NEAR = 1e-3  # of the largest distance in the path: as near as that is as near
LEAST_ARC = 20 * ROUNDING_MM  # of an arc that is cut; a shorter one may be taken for a full circle
DIGITS = 10
MAX_SAMPLES = 300  # of a motion, with the last one


class TraceFollower:
    """Follows positions along the points of a trace; it does not go back: a path that comes by several times is
    followed in time.

    distance: of the last position from the trace; segment: the point behind it, and part: how far on the way there.
    """

    def __init__(self, points: Array) -> None:
        self._begin, self._end = points[:-1].copy(), points[1:]
        self._margin = NEAR * max(1e-9, float(np.ptp(points, axis=0).max()))
        self.segment, self.part, self.distance = 0, 0.0, 0.0
        self._done = 0.0  # of the present segment

    def follow(self, position: Array) -> None:
        """Go on to the place next to a position."""
        begin, end = self._begin[self.segment :], self._end[self.segment :]
        way = end - begin
        size = np.maximum((way**2).sum(axis=1), 1e-30)
        part = np.clip(((position - begin) * way).sum(axis=1) / size, 0.0, 1.0)
        distance = np.linalg.norm(begin + part[:, None] * way - position, axis=1)
        offset = int(np.argmax(distance <= distance.min() + self._margin))
        if offset:
            self._done = 0.0
        self.segment += offset
        self._done += (1.0 - self._done) * float(part[offset])
        self.part, self.distance = self._done, float(distance[offset])
        self._begin[self.segment] += part[offset] * way[offset]


@dataclass(frozen=True, slots=True)
class PathPlace:
    """A place on a path. piece: from 0; along: how far on it, in its unit, 0: its start; position: in coordinates."""

    piece: int
    along: float
    position: Array


def find_place(path: ResolvedPath, trace: PathTrace, axes_at: Sequence[Array], tolerance: float) -> PathPlace | None:
    """Where on a path axes stood that were at these positions, one after the other: at the last one that is within its
    tolerance. None: they were nowhere near it."""
    points = trace.points if path.frame is None else trace.points @ path.frame.matrix.T + path.frame.offset
    follower = TraceFollower(points)
    found_place: tuple[int, float] | None = None
    for position in axes_at:
        follower.follow(position)
        if follower.distance <= tolerance:
            found_place = follower.segment, follower.part
    if found_place is None:
        return None
    end_point = found_place[0] + 1
    begin_point = found_place[0] if trace.span[found_place[0]] == trace.span[end_point] else end_point
    along = float(trace.along[begin_point] + (trace.along[end_point] - trace.along[begin_point]) * found_place[1])
    return _choose_cut(path, trace, end_point, along, tolerance)


def _choose_cut(path: ResolvedPath, trace: PathTrace, point: int, along: float, margin: float) -> PathPlace:
    """The place at which a piece is cut: a little of it is left before and behind. Splines and tables are not cut, as
    their rest would be another curve, or have other times: they begin at their start again."""
    piece = int(trace.piece[point])
    first = int(np.argmax(trace.piece == piece))
    start = PathPlace(piece, 0.0, trace.points[first])
    part, span = path.parts[int(trace.part[point])], int(trace.span[point])
    if not isinstance(part, Outline) or part.kind[span] not in (0, ARC):
        return start
    length = float(part.length[span])
    if part.kind[span] == ARC:
        margin = max(margin, LEAST_ARC)
    if along < margin or length < 2 * margin:
        return start
    along = min(along, length - margin)
    (position,) = part.shapes.evaluate(part.kind[[span]], part.row[[span]], np.array([along])).q
    return PathPlace(piece, along, position)


def thin_out(count: int) -> Index:
    """The numbers of some of so many samples, evenly chosen, with the last one."""
    return np.unique(np.linspace(0, count - 1, min(count, MAX_SAMPLES)).astype(np.int64))


def cut_path(step: FollowPath, path: ResolvedPath, place: PathPlace, units: Sequence[Unit]) -> FollowPath:
    """The rest of a path from a place on it. units: of its coordinates."""
    pieces = [step.pieces[number] for number in range(place.piece, len(step.pieces))]
    if place.along > 0.0:
        pieces[0] = _cut_piece(pieces[0], path, place, units)
    source = None if step.source is None else step.source.cut(place.piece, len(pieces))
    changes = {"start": write_point(place.position, units), "pieces": pack_pieces(pieces), "source": source}
    return step.model_copy(update=changes)


def write_point(point: Array, units: Sequence[Unit]) -> list[str]:
    """A point as a job file has it."""
    return [f"{value:.{DIGITS}g} {unit}" for value, unit in zip(point.tolist(), units, strict=True)]


def _cut_piece(piece: Piece, path: ResolvedPath, place: PathPlace, units: Sequence[Unit]) -> Piece:
    """The rest of a line, an arc or a helix. All of it but where it begins is as it was."""
    if isinstance(piece, LinePiece):
        return piece
    part, span = _find_span(path, place.piece)
    changes: dict[str, Any] = {}
    left_length = float(part.length[span]) - place.along
    if isinstance(piece, HelixPiece):
        angle = float(part.shapes.arcs.turn[part.row[span]]) * left_length
        changes = {"turns": max(0, ceil(angle / (2 * pi)) - 1)}
    elif isinstance(piece, ArcPiece) and piece.through is not None:
        middle = np.array([place.along + left_length / 2])
        (through,) = part.shapes.evaluate(part.kind[[span]], part.row[[span]], middle).q
        changes = {"through": write_point(through, units)}
    return piece.model_copy(update=changes)


def _find_span(path: ResolvedPath, piece: int) -> tuple[Outline, int]:
    """The span of a piece that is one."""
    for part in path.parts:
        if isinstance(part, Outline) and (spans := np.flatnonzero(part.piece == piece)).size:
            return part, int(spans[0])
    raise AssertionError(f"piece {piece + 1} has no span")
