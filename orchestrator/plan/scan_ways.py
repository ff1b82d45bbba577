"""The extremes of a scan and the distances between its points, without going from point to point."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import NamedTuple

from orchestrator.model.steps.points import PointTable
from orchestrator.model.steps.scan import Scan
from orchestrator.model.units import Unit, parse_quantity

Way = tuple[Fraction, Fraction]
"""From one position to another."""


class ScanCorner(NamedTuple):
    """An extreme position of an axis. point: the first there, from 1. positions: of all axes at that point, as far as
    they are known."""

    position: Fraction
    point: int
    positions: Mapping[str, float]


class ScanWays(NamedTuple):
    """Ways between neighbouring points. often: how many. nearest, farthest: by axis, bounds of them; without the axes
    that stand."""

    often: int
    nearest: Mapping[str, Way]
    farthest: Mapping[str, Way]


def find_corners(scan: Scan, units: Sequence[Unit], unknown: Collection[str] = ()) -> dict[str, list[ScanCorner]]:
    """By axis: its first, lowest, highest and last position. unknown: axes that are left out. Raises `UnitError`."""
    names = scan.axis_names
    if scan.points is not None and scan.points.rows is None:
        return {
            column.axis: [
                _make_corner({column.axis: value}, column.axis, point)
                for value, point in (
                    (column.first, 1),
                    (column.least, column.least_at),
                    (column.most, column.most_at),
                    (column.last, scan.point_count),
                )
            ]
            for column in scan.points.columns
        }
    points = _find_extreme_points(scan, units)

    def find_positions(point: int) -> dict[str, Fraction]:
        point_values = zip(names, _find_point(scan, point, units), strict=True)
        return {name: position for name, position in point_values if name not in unknown}

    return {
        name: [_make_corner(find_positions(point), name, point + 1) for point in axis_points]
        for name, axis_points in zip(names, points, strict=True)
        if name not in unknown
    }


def _make_corner(positions: Mapping[str, Fraction | float], axis: str, point: int) -> ScanCorner:
    shown_positions = {name: float(value) for name, value in positions.items()}
    # As it will be sent: the decimal of the nearest double.
    return ScanCorner(Fraction(str(shown_positions[axis])), point, shown_positions)


def _find_point(scan: Scan, point: int, units: Sequence[Unit]) -> list[Fraction]:
    if scan.points is not None and scan.points.rows is not None:
        return [parse_quantity(text, unit) for text, unit in zip(scan.points.rows[point], units, strict=True)]
    return scan.grid.find_position(point, units)


def _find_extreme_points(scan: Scan, units: Sequence[Unit]) -> list[list[int]]:
    """By axis: the numbers of the points at its first, lowest, highest and last position, from 0."""
    points: list[list[int]] = []
    if scan.points is not None and scan.points.rows is not None:
        for column, unit in enumerate(units):
            values = [parse_quantity(row[column], unit) for row in scan.points.rows]
            points.append([0, values.index(min(values)), values.index(max(values)), len(values) - 1])
        return points
    grid = scan.grid
    for axis, unit, count, stride in zip(scan.axes.values(), units, grid.counts, grid.strides, strict=True):
        listed_range = range(count) if axis.values is not None else (0, count - 1)
        values = {index: axis.position(index, unit) for index in listed_range}
        low, high = min(values, key=lambda k: values[k]), max(values, key=lambda k: values[k])
        # In its first pass every axis goes forward.
        points.append([0, low * stride, high * stride, grid.count - 1])
    return points


def iterate_ways(scan: Scan, units: Sequence[Unit]) -> Iterator[ScanWays]:
    """The ways between all neighbouring points, in as few kinds as there are axes. Raises `UnitError`."""
    names, table = scan.axis_names, scan.points
    if table is not None:
        yield _find_table_ways(names, table, units)
        return
    for count, pairs in scan.grid.iterate_ways():
        nearest: dict[str, Way] = {}
        farthest: dict[str, Way] = {}
        for name, axis, unit, pair in zip(names, scan.axes.values(), units, pairs, strict=True):
            ways = [(axis.position(begin, unit), axis.position(end, unit)) for begin, end in pair]
            if ways:
                nearest[name] = min(ways, key=_length)
                farthest[name] = max(ways, key=_length)
        yield ScanWays(count, nearest, farthest)


def _find_table_ways(names: Sequence[str], table: PointTable, units: Sequence[Unit]) -> ScanWays:
    if table.rows is None:
        zero = Fraction(0)
        nearest = {column.axis: (zero, Fraction(str(column.least_step))) for column in table.columns}
        farthest = {column.axis: (zero, Fraction(str(column.most_step))) for column in table.columns}
        return ScanWays(table.count - 1, nearest, farthest)
    nearest, farthest = dict[str, Way](), dict[str, Way]()
    for column, (name, unit) in enumerate(zip(names, units, strict=True)):
        values = [parse_quantity(row[column], unit) for row in table.rows]
        ways = list(pairwise(values))
        if ways:
            nearest[name], farthest[name] = min(ways, key=_length), max(ways, key=_length)
    return ScanWays(len(table.rows) - 1, nearest, farthest)


def _length(way: Way) -> Fraction:
    return abs(way[1] - way[0])
