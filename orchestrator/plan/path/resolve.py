"""From a path as it is written to its outlines and tables: units, planes, frames."""

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np

from orchestrator.model.frame import FrameSpec
from orchestrator.model.paths.circles import ROUNDING_MM, Precision
from orchestrator.model.paths.pieces import (
    ArcPiece,
    HelixPiece,
    LinePiece,
    Piece,
    SplinePiece,
    TablePiece,
    Within,
)
from orchestrator.model.paths.spec import PathSpec
from orchestrator.model.units import (
    Quantity,
    Unit,
    UnitError,
    convert_units,
    find_dimension,
    parse_quantity,
    parse_rate,
)
from orchestrator.plan.path.arc_length import Array
from orchestrator.plan.path.axes import AlongLimits, PathAxis
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.outline import STOP, Circle, Outline, OutlineBuilder, PieceEnd
from orchestrator.plan.path.tables import TimedTable
from orchestrator.plan.path.track import Frame


@dataclass(frozen=True, slots=True)
class ResolvedPath:
    """A path in numbers: parts that begin and end at rest, in order, the frame, and limits along the path."""

    parts: Sequence[Outline | TimedTable]
    frame: Frame | None
    along: AlongLimits


@dataclass(frozen=True, slots=True)
class _Coordinates:
    """Names and units of the coordinates."""

    names: Sequence[str]
    units: Sequence[Unit]

    def parse_point(self, point: Sequence[Quantity], place: str) -> Array:
        """A point in the coordinates' units."""
        try:
            pairs = zip(point, self.units, self.names, strict=True)
            return np.array([float(parse_quantity(value, unit, name)) for value, unit, name in pairs])
        except UnitError as error:
            raise PathRefusal("bad-unit", f"{place}: {error}", "convert it to the axis's unit") from None

    def find_plane(self, names: Sequence[str] | None, piece: int) -> tuple[int, int]:
        """The numbers of the two coordinates of a plane."""
        if len(self.names) < 2:
            text = f"piece {piece + 1}: an arc needs two axes, and this path has one"
            raise PathRefusal("no-plane", text, "name a second axis, or write a line", piece + 1)
        if names is None:
            return 0, 1
        unknown = [name for name in names if name not in self.names]
        if unknown or names[0] == names[1]:
            text = f"piece {piece + 1}: its plane is {', '.join(names)}, which are not two of {', '.join(self.names)}"
            raise PathRefusal("no-plane", text, "name two different ones", piece + 1)
        return self.names.index(names[0]), self.names.index(names[1])


def resolve_path(spec: PathSpec, axes: Sequence[PathAxis], frame: FrameSpec | None = None) -> ResolvedPath:
    """Resolve a path. axes: those of `spec.axes`, in that order. frame: the one that `spec.frame` names.

    Raises `PathRefusal` naming the piece.
    """
    units = [axis.unit for axis in axes]
    if frame is None:
        coordinates, mapped_frame = _Coordinates(spec.axes, units), None
    else:
        coordinates = _Coordinates(frame.coordinates, [frame.unit] * len(units))
        mapped_frame = Frame(frame.make_matrix(), frame.make_offset(units))
    parts = _Collector(spec, coordinates).collect()
    return ResolvedPath(parts, mapped_frame, parse_along(spec, coordinates.units[0]))


def parse_along(spec: PathSpec, unit: Unit) -> AlongLimits:
    """The limits along a path whose first coordinate has this unit. Raises `PathRefusal`."""
    values = (spec.speed, spec.acceleration, spec.jerk)
    return AlongLimits(*(_parse_limit(value, unit, k + 1, "the path") for k, value in enumerate(values)))


def parse_speed(piece: Piece, unit: Unit, number: int) -> float:
    """The highest speed along a piece; inf: it has none of its own. Raises `PathRefusal`."""
    speed = _parse_limit(piece.speed, unit, 1, f"piece {number + 1}")
    return np.inf if speed is None else speed


def _parse_limit(value: float | str | None, unit: Unit, order: int, place: str) -> float | None:
    """A limit along the path, or a piece of it."""
    if value is None:
        return None
    name = ("speed", "acceleration", "jerk")[order - 1]
    try:
        number = parse_rate(value, unit, order) if isinstance(value, str) else float(value)
    except UnitError as error:
        raise PathRefusal("bad-unit", f"`{name}` of {place}: {error}", "correct its unit") from None
    if not number > 0.0:
        raise PathRefusal("bad-limit", f"`{name}` of {place} is {number:g}", "choose a value above 0")
    return number


class _Collector:
    """Collects the pieces of a path; a table divides it."""

    def __init__(self, spec: PathSpec, coordinates: _Coordinates) -> None:
        self._spec = spec
        self._coordinates = coordinates
        self._parts: list[Outline | TimedTable] = []
        self._builder = OutlineBuilder(coordinates.parse_point(spec.start, "start"))

    def collect(self) -> list[Outline | TimedTable]:
        """All parts."""
        for number, piece in enumerate(self._spec.pieces):
            if isinstance(piece, TablePiece):
                self._add_table(number, piece)
            else:
                speed = parse_speed(piece, self._coordinates.units[0], number)
                self._add_piece(PieceEnd(number, self._find_tolerance(piece), speed), piece)
        self._end_outline(self._builder.position)
        return self._parts

    def _end_outline(self, position: Array) -> None:
        outline = self._builder.build()
        if len(outline.kind):
            self._parts.append(outline)
        self._builder = OutlineBuilder(position)

    def _find_tolerance(self, piece: Piece) -> float:
        corner = piece.corner if piece.corner is not None else self._spec.corner
        if not isinstance(corner, Within):
            return STOP
        try:
            return float(parse_quantity(corner.within, self._coordinates.units[0], "the path"))
        except UnitError as error:
            raise PathRefusal(
                "bad-unit", f"`within` of a corner: {error}", "give a length in the path's unit"
            ) from None

    def _add_piece(self, end: PieceEnd, piece: Piece) -> None:
        location = f"piece {end.piece + 1} ({piece.piece})"
        if isinstance(piece, SplinePiece):
            points = [self._coordinates.parse_point(point, location) for point in piece.through]
            self._builder.add_spline(end, np.array(points))
            return
        assert not isinstance(piece, TablePiece)
        to = self._coordinates.parse_point(piece.to, location)
        if isinstance(piece, LinePiece):
            self._builder.add_line(end, to)
        elif isinstance(piece, ArcPiece) and piece.through is not None:
            self._builder.add_arc_through(end, self._coordinates.parse_point(piece.through, location), to)
        else:
            self._add_arc(end, piece, to, location)

    def _add_arc(self, end: PieceEnd, piece: ArcPiece | HelixPiece, to: Array, place: str) -> None:
        plane = self._coordinates.find_plane(piece.plane, end.piece)
        assert piece.centre is not None
        across = _Coordinates([self._coordinates.names[k] for k in plane], [self._coordinates.units[k] for k in plane])
        centre = across.parse_point(piece.centre, place)
        offsets = np.delete(to - self._builder.position, plane)
        if isinstance(piece, ArcPiece) and offsets.any():
            text = f"{place}: leaves its plane {' and '.join(across.names)}"
            raise PathRefusal("no-plane", text, "write `piece: helix`, or choose its `plane`", end.piece + 1)
        turns = piece.turns if isinstance(piece, HelixPiece) else 0
        unit = across.units[0]
        is_length = find_dimension(unit) == "length"
        rounding = float(convert_units(Fraction(ROUNDING_MM), Unit.MM, unit)) if is_length else 0.0
        precision = Precision(rounding, unit)
        circle = Circle(plane, (float(centre[0]), float(centre[1])), piece.direction == "ccw", turns, precision)
        self._builder.add_arc(end, circle, to)

    def _add_table(self, number: int, piece: TablePiece) -> None:
        location = f"piece {number + 1} (table)"
        rows = np.array([self._coordinates.parse_point(point, location) for point in piece.positions])
        position_before = self._builder.position
        self._end_outline(rows[-1])
        self._parts.append(TimedTable(number, np.array(piece.t, dtype=np.float64), rows, position_before))
