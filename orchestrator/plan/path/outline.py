"""The outline of a path: its pieces as curves, with sharp corners.

Positions are numbers in one unit of length per coordinate. A piece becomes one span, a spline one for each gap.
"""

from dataclasses import dataclass, field
from math import pi

import numpy as np

from orchestrator.model.paths.circles import EXACT, SHORTEST, Precision, fit_arc
from orchestrator.plan.path.arc_length import COARSE_ERROR, Array, Index, measure_curves, split_curves
from orchestrator.plan.path.curves import ARC, LINE, POLY, Arcs, Lines, Polys, Shapes
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.splines import fit_spline

STRAIGHT = 1e-9  # sine of the angle between two chords of an arc that has no circle
CUSP = 1e-5  # of the mean |x'(u)|: below, a curve stops and turns on the spot
SPLITS = 12  # halvings of a curve whose length does not converge; beyond, it has a cusp
STOP, SMOOTH = 0.0, np.inf


class _Rows(list[Array]):
    """Rows of one field of all curves of a kind."""

    def stack(self, shape: tuple[int, ...]) -> Array:
        return np.array(self) if self else np.zeros((0, *shape))


@dataclass(frozen=True, slots=True)
class Outline:
    """Spans in order: `kind` and `row` of each curve in `shapes`, its length, the number of its piece from 0.

    tolerance: of the corner at the end of each span: a length, `STOP`, or `SMOOTH` inside a piece. speed: the highest
    one along each span (inf: none).
    """

    shapes: Shapes
    kind: Index
    row: Index
    length: Array
    piece: Index
    tolerance: Array
    speed: Array


@dataclass(frozen=True, slots=True)
class PieceEnd:
    """The number of a piece, from 0, the tolerance of the corner at its end (`STOP` or a length), and the highest speed
    along it."""

    piece: int
    tolerance: float = STOP
    speed: float = np.inf


@dataclass(frozen=True, slots=True)
class Circle:
    """An arc's or a helix's plane (two coordinates), its centre there, and its sense: ccw turns the first towards the
    second. turns: full ones in addition. precision: of its ends."""

    plane: tuple[int, int]
    centre: tuple[float, float]
    ccw: bool
    turns: int = 0
    precision: Precision = EXACT


@dataclass(slots=True)
class OutlineBuilder:
    """Collects pieces from `position` on. Raises `PathRefusal` naming the piece."""

    position: Array
    _spans: list[tuple[int, int, float, int, float, float]] = field(default_factory=list)
    _lines: tuple[_Rows, _Rows] = field(default_factory=lambda: (_Rows(), _Rows()))
    _arcs: tuple[_Rows, ...] = field(default_factory=lambda: tuple(_Rows() for _ in range(5)))
    _polys: _Rows = field(default_factory=_Rows)

    def add_line(self, end: PieceEnd, to: Array) -> None:
        """Add a straight line."""
        way = to - self.position
        length = float(np.sqrt(way @ way))
        self._check_length(end, "line", length)
        self._spans.append((LINE, len(self._lines[0]), length, end.piece, end.tolerance, end.speed))
        self._lines[0].append(self.position)
        self._lines[1].append(way / length)
        self.position = to

    def add_arc_through(self, end: PieceEnd, through: Array, to: Array) -> None:
        """Add the arc from here through a point to an end, in any plane."""
        a, b = through - self.position, to - self.position
        for name, chord in (("start and `through`", a), ("start and `to`", b), ("`through` and `to`", b - a)):
            if np.linalg.norm(chord) <= SHORTEST * self._scale(to):
                text = f"piece {end.piece + 1} (arc): {name} are the same point"
                raise PathRefusal(
                    "doubled-point",
                    text,
                    "give three different points; for a full circle give its centre",
                    end.piece + 1,
                )
        aa, ab, bb = float(a @ a), float(a @ b), float(b @ b)
        area = aa * bb - ab * ab
        if area <= STRAIGHT**2 * aa * bb:
            text = f"piece {end.piece + 1} (arc): its three points lie on a straight line"
            raise PathRefusal("collinear", text, "write a line, or move `through` off it", end.piece + 1)
        centre = self.position + (bb * (aa - ab) * a + aa * (bb - ab) * b) / (2 * area)
        first = self.position - centre
        radius = float(np.linalg.norm(first))
        side = a - first * (a @ first) / radius**2  # at right angles to the radius, towards `through`
        # On the side of `through` if the chord to it turns less than that to the end.
        second = side / np.linalg.norm(side) * radius
        angles = [float(np.arctan2(p @ second, p @ first)) % (2 * pi) for p in (through - centre, to - centre)]
        if angles[0] > angles[1]:
            second, angles[1] = -second, 2 * pi - angles[1]
        self._append_arc(end, (centre, first, second), angles[1], np.zeros_like(to))
        self.position = to

    def add_arc(self, end: PieceEnd, circle: Circle, to: Array) -> None:
        """Add an arc about a centre in a plane; other coordinates go evenly to their end (a helix). An end above or
        at the start is a full turn."""
        i, j = circle.plane
        plane = [i, j]
        begin, finish = self.position[plane], to[plane]
        centre, angle = self._fit_circle(end, circle, begin, finish)
        radial = begin - centre
        sense = 1.0 if circle.ccw else -1.0
        across = sense * np.array([-radial[1], radial[0]])
        angle += 2 * pi * circle.turns
        first, second, middle = np.zeros_like(to), np.zeros_like(to), self.position.copy()
        first[plane], second[plane], middle[plane] = radial, across, centre
        rise = to - self.position
        rise[plane] = 0.0
        self._append_arc(end, (middle, first, second), angle, rise)
        self.position = to

    def _fit_circle(self, end: PieceEnd, circle: Circle, begin: Array, finish: Array) -> tuple[Array, float]:
        """The centre and the angle of an arc. Raises `PathRefusal`."""
        radii = (float(np.linalg.norm(point - np.array(circle.centre))) for point in (begin, finish))
        self._check_length(end, "arc", min(radii))
        points = [(float(point[0]), float(point[1])) for point in (begin, finish)]
        remedy = "correct `centre` or `to`: both distances are the radius"
        try:
            arc = fit_arc(points[0], points[1], circle.centre, ccw=circle.ccw, precision=circle.precision)
            is_open = arc.is_full and float(np.linalg.norm(finish - begin)) > SHORTEST * self._scale(finish)
        except ValueError as error:
            raise PathRefusal("no-circle", f"piece {end.piece + 1} (arc): {error}", remedy, end.piece + 1) from None
        if is_open:
            text = f"piece {end.piece + 1} (arc): it is a full circle that does not end at its start"
            raise PathRefusal("no-circle", text, "write its start as `to`", end.piece + 1)
        return np.array(arc.centre), arc.angle

    def _append_arc(self, end: PieceEnd, circle: tuple[Array, Array, Array], angle: float, rise: Array) -> None:
        """Append a helix that goes `rise` in all."""
        centre, first, second = circle
        length = float(np.hypot(angle * np.linalg.norm(first), np.linalg.norm(rise)))
        self._check_length(end, "arc", length)
        self._spans.append((ARC, len(self._arcs[0]), length, end.piece, end.tolerance, end.speed))
        for rows, value in zip(
            self._arcs, (centre, first, second, rise / length, np.array(angle / length)), strict=True
        ):
            rows.append(value)

    def add_spline(self, end: PieceEnd, through: Array) -> None:
        """Add a spline from here through all points (n, coordinates)."""
        points = np.vstack([self.position, through])
        steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
        doubled_points = np.flatnonzero(steps <= SHORTEST * self._scale(points))
        if len(doubled_points):
            k = int(doubled_points[0]) + 1
            point_text = f"point {k - 1}" if k > 1 else "the start"
            text = f"piece {end.piece + 1} (spline): point {k} is the same as {point_text}"
            raise PathRefusal("doubled-point", text, "remove it", end.piece + 1)
        self.add_polys(end, fit_spline(points, steps), "spline")
        self.position = points[-1]

    def add_polys(self, end: PieceEnd, curves: Array, word: str) -> None:
        """Add curves (n, 6, coordinates) that continue each other smoothly, halved until their lengths converge."""
        curves = split_until_measured(curves, f"piece {end.piece + 1} ({word})", end.piece + 1)
        lengths = measure_curves(curves).lengths[:, -1].tolist()
        last = len(lengths) - 1
        for k, length in enumerate(lengths):
            tolerance = end.tolerance if k == last else SMOOTH
            self._spans.append((POLY, len(self._polys), length, end.piece, tolerance, end.speed))
            self._polys.append(curves[k])

    def build(self) -> Outline:
        """The outline of all pieces added so far."""
        width = (len(self.position),)
        polys = self._polys.stack((6, *width))
        shapes = Shapes(
            Lines(*(rows.stack(width) for rows in self._lines)),
            Arcs(*(rows.stack(shape) for rows, shape in zip(self._arcs, (*[width] * 4, ()), strict=True))),
            Polys(polys, measure_curves(polys)),
        )
        table = np.array(self._spans, dtype=np.float64).reshape(-1, 6)
        kind, row, piece = (table[:, k].astype(np.int64) for k in (0, 1, 3))
        return Outline(
            shapes=shapes, kind=kind, row=row, length=table[:, 2], piece=piece, tolerance=table[:, 4], speed=table[:, 5]
        )

    def _scale(self, *points: Array) -> float:
        return max(1e-3, float(np.abs(self.position).max()), *(float(np.abs(point).max()) for point in points))

    def _check_length(self, end: PieceEnd, word: str, length: float) -> None:
        if not length > SHORTEST * self._scale():
            text = f"piece {end.piece + 1} ({word}): has no length, it ends where it begins"
            raise PathRefusal("zero-length", text, "remove it, or correct its end", end.piece + 1)


def split_until_measured(curves: Array, name: str, piece: int) -> Array:
    """Halve those curves whose length is not known to 1e-9. Raises `PathRefusal` if that does not help: a cusp."""
    for _ in range(SPLITS):
        table = measure_curves(curves)
        wanting = table.error > COARSE_ERROR
        if (table.slowest < CUSP * table.lengths[:, -1]).any():
            break
        if not wanting.any():
            return curves
        parts = np.where(wanting[:, None, None, None], split_curves(curves), curves[:, None])
        keep = np.ones(parts.shape[:2], dtype=bool)
        keep[~wanting, 1] = False
        curves = parts[keep]
    text = f"{name}: has a cusp, a point at which it turns on the spot"
    raise PathRefusal("cusp", text, "move or add points near it, or end the piece there", piece)
