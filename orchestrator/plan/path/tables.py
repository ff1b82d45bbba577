"""Timed tables: positions at instants, as cubics in time from rest to rest.

The spline is twice continuously differentiable, and begins and ends with neither velocity nor acceleration. That needs
two more coefficients than a clamped spline has: a free knot in the middle of the first and of the last gap (Biagiotti
and Melchiorri, "Trajectory Planning for Automatic Machines and Robots", 2008, section 4.4.4).
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index, LengthTable, find_lengths, measure_curves
from orchestrator.plan.path.errors import PathRefusal
from orchestrator.plan.path.limits import PathLimits
from orchestrator.plan.path.track import Frame

MOST_STRETCH = 1.01
SAME_PLACE = 1e-9  # of the largest coordinate: a table begins where the path is
BISECTIONS = 40


@dataclass(frozen=True, slots=True)
class TimedTable:
    """A table as it is written: the number of its piece from 0, instants in s, rows of coordinates, and where the path
    is before it."""

    piece: int
    t: Array
    rows: Array
    before: Array


@dataclass(frozen=True, slots=True)
class TableRun:
    """A table that holds its limits: knots in s; per gap the cubic of each axis in the time since its knot, shape
    (gaps, 4, axes), and its curve in coordinates by u from 0 to 1 with its lengths; row: the table's row before each
    gap."""

    piece: int
    knots: Array
    cubics: Array
    curves: Array
    lengths: LengthTable
    row: Index

    @property
    def duration_s(self) -> float:
        """From the first row to the last one."""
        return float(self.knots[-1])

    @property
    def length(self) -> float:
        """The length of the way, in coordinates."""
        return float(self.lengths.lengths[:, -1].sum())

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """Positions of the axes and their derivatives by time, each (instants, axes)."""
        gap = np.clip(np.searchsorted(self.knots, t, side="right") - 1, 0, len(self.cubics) - 1)
        x = np.clip(t, 0.0, self.duration_s)[:, None] - self.knots[gap][:, None]
        c0, c1, c2, c3 = (self.cubics[gap, k] for k in range(4))
        is_moving = ((t >= 0.0) & (t < self.duration_s))[:, None]
        q = c0 + x * (c1 + x * (c2 + x * c3))
        return q, is_moving * (c1 + x * (2 * c2 + x * 3 * c3)), is_moving * (2 * c2 + 6 * x * c3), is_moving * (6 * c3)

    def find_positions(self, s: Array) -> Array:
        """The positions of the axes after lengths `s` of the way."""
        ends = np.cumsum(self.lengths.lengths[:, -1])
        gap = np.clip(np.searchsorted(ends, s, side="left"), 0, len(ends) - 1)
        way_inside = s - (ends[gap] - self.lengths.lengths[gap, -1])
        low, high = np.zeros(len(s)), np.ones(len(s))
        for _ in range(BISECTIONS):  # not Newton: speeds are zero at rests
            middle = (low + high) / 2
            is_beyond = find_lengths(self.curves, self.lengths, gap, middle) > way_inside
            low, high = np.where(is_beyond, low, middle), np.where(is_beyond, middle, high)
        steps = np.diff(self.knots)
        return self.evaluate(self.knots[gap] + low * steps[gap])[0]


def plan_table(table: TimedTable, frame: Frame | None, limits: PathLimits, names: list[str]) -> TableRun:
    """Fit a table and check it: stretched in time by 1 % at most. Raises `PathRefusal` naming the row and the axis."""
    _check_start(table)
    knots, row, values = _add_free_knots(table)
    curves_t = _fit_cubics(knots, values)
    cubics = curves_t if frame is None else curves_t @ frame.matrix.T
    if frame is not None:
        cubics[:, 0] += frame.offset
    factor = _find_stretch(table, np.diff(knots), cubics, (limits, names, row))
    powers = factor ** -np.arange(4.0)
    by_u = curves_t * (np.diff(knots)[:, None] ** np.arange(4))[:, :, None]
    curves = np.concatenate([by_u, np.zeros((len(by_u), 2, by_u.shape[2]))], axis=1)
    return TableRun(
        piece=table.piece,
        knots=(knots - knots[0]) * factor,
        cubics=cubics * powers[:, None],
        curves=curves,
        lengths=measure_curves(curves),
        row=row,
    )


def _check_start(table: TimedTable) -> None:
    n = table.piece + 1
    scale = max(1e-3, float(np.abs(table.rows).max()))
    if np.abs(table.rows[0] - table.before).max() > SAME_PLACE * scale:
        first, path_end = (", ".join(f"{x:.9g}" for x in point) for point in (table.rows[0], table.before))
        text = f"piece {n} (table): jumps, its first row is at ({first}), and the path is at ({path_end})"
        raise PathRefusal("table-jump", text, "begin it there, or put a line before it", n)
    if not (np.diff(table.t) > 0.0).all():
        k = int(np.flatnonzero(np.diff(table.t) <= 0.0)[0]) + 2
        text = f"piece {n} (table): goes back in time at row {k} ({table.t[k - 1]:g} s after {table.t[k - 2]:g} s)"
        raise PathRefusal("table-time", text, "instants must grow", n)


def _add_free_knots(table: TimedTable) -> tuple[Array, Index, Array]:
    """(knots, the row before each gap, positions at knots: of the two free ones, not known yet, NaN)."""
    t, rows = table.t, table.rows
    if len(t) == 2:
        extra = t[0] + np.array([1, 2]) / 3 * (t[1] - t[0])
    else:
        extra = np.array([(t[0] + t[1]) / 2, (t[-2] + t[-1]) / 2])
    unknown = np.full((1, rows.shape[1]), np.nan)
    knots = np.concatenate([t[:1], extra[:1], t[1:-1], extra[1:], t[-1:]])
    values = np.concatenate([rows[:1], unknown, rows[1:-1], unknown, rows[-1:]])
    return knots, np.clip(np.searchsorted(t, knots[:-1], side="right"), 1, len(t) - 1), values


def _fit_cubics(knots: Array, values: Array) -> Array:
    """Cubics in time: second derivatives M from the continuity of velocity, with M = 0 and velocity 0 at both ends.

    The free position beside an end is that of the end + M h²/6, which goes into the equations of M.
    """
    h = np.diff(knots)
    n = len(knots)
    lower, upper, diagonal = h[:-1].copy(), h[1:].copy(), 2 * (h[:-1] + h[1:])
    known_values = values.copy()
    known_values[1], known_values[-2] = values[0], values[-1]
    right = 6 * np.diff(np.diff(known_values, axis=0) / h[:, None], axis=0)
    # Equations k = 1 … n-2 stand in rows 0 … n-3.
    diagonal[0] += h[0] + h[0] ** 2 / h[1]
    lower[1] -= h[0] ** 2 / h[1]
    diagonal[-1] += h[-1] + h[-1] ** 2 / h[-2]
    upper[-2] -= h[-1] ** 2 / h[-2]
    second = np.zeros_like(values)
    for k in range(1, n - 2):
        factor = lower[k] / diagonal[k - 1]
        diagonal[k] -= factor * upper[k - 1]
        right[k] -= factor * right[k - 1]
    for k in range(n - 3, -1, -1):
        second[k + 1] = (right[k] - upper[k] * second[k + 2]) / diagonal[k]
    known_values[1] += second[1] * h[0] ** 2 / 6
    known_values[-2] += second[-2] * h[-1] ** 2 / 6
    step = h[:, None]
    slopes = np.diff(known_values, axis=0) / step - step * (2 * second[:-1] + second[1:]) / 6
    return np.stack([known_values[:-1], slopes, second[:-1] / 2, np.diff(second, axis=0) / (6 * step)], axis=1)


def _find_stretch(table: TimedTable, h: Array, cubics: Array, judged: tuple[PathLimits, list[str], Index]) -> float:
    """How much longer the table must take: 1 to `MOST_STRETCH`."""
    limits, names, row = judged
    step = h[:, None]
    c1, c2, c3 = cubics[:, 1], cubics[:, 2], cubics[:, 3]
    end = c1 + step * (2 * c2 + step * 3 * c3)
    with np.errstate(divide="ignore", invalid="ignore"):
        turn = -c2 / (3 * c3)
        top = np.where((turn > 0) & (turn < step), c1 + turn * c2, 0.0)
    velocity = np.maximum(np.maximum(np.abs(c1), np.abs(end)), np.abs(top))
    acceleration = np.maximum(np.abs(2 * c2), np.abs(2 * c2 + 6 * c3 * step))
    jerk = np.abs(6 * c3)
    values = (velocity, acceleration, jerk)
    limit_values = (limits.velocity, limits.acceleration, limits.jerk)
    needed_stretch = np.stack(
        [(f / a) ** (1 / (k + 1)) for k, (f, a) in enumerate(zip(values, limit_values, strict=True))]
    )
    worst = float(needed_stretch.max())
    if worst <= MOST_STRETCH:
        return max(1.0, worst)
    order, gap, axis = np.unravel_index(int(needed_stretch.argmax()), needed_stretch.shape)
    word = ("velocity", "acceleration", "jerk")[order]
    n = table.piece + 1
    text = (
        f"piece {n} (table): between rows {row[gap]} and {row[gap] + 1} {names[axis]} needs a {word} of "
        f"{values[order][gap, axis]:.6g}, and its limit is {limit_values[order][axis]:.6g}"
    )
    raise PathRefusal("table-limit", text, f"give the table {worst:.3g} times its time, or remove the jump there", n)
