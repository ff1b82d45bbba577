"""The coarse motion along a path: piecewise constant acceleration, before its accelerations are smoothed.

Averaged over a time T (`smooth.py`) it keeps a jerk of the largest change of acceleration within T, divided by T. So
between speeding up and slowing down there is a time T of constant speed: then the smoothed motion is the fastest one of
constant limits, with jerk A/T. In valleys of speed `spread_caps` has made that time, on peaks `flatten_peaks` does.
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index

STEADY = 1e-6  # of the largest acceleration: below, a cell is of constant speed
BISECTIONS = 20
MARGIN = 1e-5  # by which plateaus are longer than they must be, because neighbouring jerks would add up
PLATEAU_ROUNDS = 3


@dataclass(frozen=True, slots=True)
class CoarseMotion:
    """Instants, positions and speeds at nodes; acceleration of the cells between them, which is constant."""

    t: Array
    s: Array
    v: Array
    a: Array

    def find_cells(self, t: Array) -> Index:
        """The cell at each instant."""
        return np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.a) - 1)

    def positions_at(self, t: Array) -> Array:
        """The position at each instant; at rest before the start and after the end."""
        t = np.clip(t, self.t[0], self.t[-1])
        cell = self.find_cells(t)
        after = t - self.t[cell]
        return self.s[cell] + after * (self.v[cell] + after * self.a[cell] / 2)

    def speeds_at(self, t: Array) -> Array:
        """The speed at each instant."""
        cell = self.find_cells(t)
        return self.v[cell] + (t - self.t[cell]) * self.a[cell]


def integrate_squares(s: Array, squares: Array, pause_s: Array) -> CoarseMotion:
    """The motion through nodes at squared speeds; `pause_s`: how long it rests in each cell without length."""
    v = np.sqrt(squares)
    h = np.diff(s)
    both = v[:-1] + v[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        dt = np.where(h > 0.0, 2 * h / both, 0.0)
        a = np.where(dt > 0.0, np.diff(v) / dt, 0.0)
    dt += pause_s
    return CoarseMotion(np.concatenate([[0.0], np.cumsum(dt)]), s, v, a)


def insert_peaks(s: Array, squares: Array, caps: Array, acceleration: Array) -> tuple[Array, Array, Index]:
    """Nodes where speeding up and slowing down cross inside a cell, or reach its cap: (s, squares, source), with
    `source` the cell of an old node before each new one."""
    h = np.diff(s)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (np.diff(squares) + 2 * acceleration * h) / (4 * acceleration)
        top = np.minimum(squares[:-1] + 2 * acceleration * crossing, caps)
        rise = (top - squares[:-1]) / (2 * acceleration)
        fall = (top - squares[1:]) / (2 * acceleration)
        found = np.flatnonzero((rise > 1e-9 * h) & (fall > 1e-9 * h) & (h > 0.0))
    flat = found[(h[found] - rise[found] - fall[found]) > 1e-9 * h[found]]
    new_s = np.concatenate([s, s[found] + rise[found], s[flat + 1] - fall[flat]])
    new_squares = np.concatenate([squares, top[found], top[flat]])
    source = np.concatenate([np.arange(len(s)), found, flat])
    rank = np.concatenate([np.zeros(len(s)), np.ones(len(found)), np.full(len(flat), 2.0)])
    order = np.lexsort((rank, source))
    return new_s[order], new_squares[order], source[order]


def flatten_peaks(motion: CoarseMotion, smoothing_s: Array) -> tuple[Array, Array, Index]:
    """Cut peaks of speed until each lasts its `smoothing_s` (per node): (s, squares, source) of nodes.

    The level is where both flanks are as far apart as the plateau then lasts; found by bisection, all peaks at once.
    """
    begin, end = _find_peaks(motion, smoothing_s)
    width = smoothing_s[np.searchsorted(motion.t, begin)] * (1 + MARGIN)
    window = width
    for _ in range(PLATEAU_ROUNDS):
        left, right, level = _find_level(motion, begin, end, window)
        covered = motion.positions_at(right) - motion.positions_at(left)
        # A plateau is slower than the peak, and takes longer.
        window = np.clip(window * width * level / np.maximum(covered, 1e-300), end - begin, width)
    left, right, level = _find_level(motion, begin, end, window)
    return _cut_peaks(motion, left, right, level)


def _find_peaks(motion: CoarseMotion, smoothing_s: Array) -> tuple[Array, Array]:
    """The instants at which speeding up ends and slowing down begins less than the smoothing time later."""
    steep = np.flatnonzero(np.abs(motion.a) > STEADY * np.abs(motion.a).max(initial=0.0))
    rising = motion.a[steep[:-1]] > 0
    falling = motion.a[steep[1:]] < 0
    begin, end = motion.t[steep[:-1] + 1], motion.t[steep[1:]]
    peak = rising & falling & (end - begin < smoothing_s[steep[:-1] + 1] * (1 - 1e-9))
    return begin[peak], end[peak]


def _find_level(motion: CoarseMotion, begin: Array, end: Array, window: Array) -> tuple[Array, Array, Array]:
    """The instants `window` apart with the same speed before and after each peak, and that speed."""
    early, late = end - window, begin.copy()
    for _ in range(BISECTIONS):
        middle = (early + late) / 2
        higher = motion.speeds_at(middle) > motion.speeds_at(middle + window)
        early, late = np.where(higher, early, middle), np.where(higher, middle, late)
    left = (early + late) / 2
    return left, left + window, np.minimum(motion.speeds_at(left), motion.speeds_at(left + window))


def _cut_peaks(motion: CoarseMotion, left: Array, right: Array, level: Array) -> tuple[Array, Array, Index]:
    # Windows may touch where two peaks are close: the later one begins where the earlier one ends.
    right = np.minimum(right, np.append(left[1:], np.inf))
    nodes = len(motion.t)
    inside = np.zeros(nodes + 1, dtype=np.int64)
    np.add.at(inside, np.searchsorted(motion.t, left, side="left"), 1)
    np.add.at(inside, np.searchsorted(motion.t, right, side="right"), -1)
    keep = np.flatnonzero(np.cumsum(inside[:-1]) <= 0)
    instants = np.concatenate([motion.t[keep], left, right])
    s = np.concatenate([motion.s[keep], motion.positions_at(left), motion.positions_at(right)])
    squares = np.concatenate([motion.v[keep] ** 2, level**2, level**2])
    source = np.concatenate([keep, motion.find_cells(left), motion.find_cells(right)])
    order = np.argsort(instants, kind="stable")
    return s[order], squares[order], source[order]
