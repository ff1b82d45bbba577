"""Speeds along a grid under caps and accelerations: passes forward and backward, in closed form and without a loop.

b is the squared speed: along a cell of constant acceleration a and length h it grows by 2 a h. The largest b that keeps
all caps is a running minimum of (cap - sum of 2 a h), in one numpy call for the whole path, once from each side. This
is the phase-plane method of Bobrow, Dubowsky and Gibson (1985) and Shin and McKay (1985), with accelerations fixed
ahead.
"""

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index


def sweep_squares(caps: Array, acceleration: Array, h: Array) -> Array:
    """The largest squared speeds at nodes: at most `caps`, changing in each cell by 2 `acceleration` `h` at most."""
    rise = np.concatenate([[0.0], np.cumsum(2 * acceleration * h)])
    forward = rise + np.minimum.accumulate(caps - rise)
    # Backwards from the end: the rise still to come.
    rise_ahead = rise[-1] - rise
    backward = rise_ahead + np.minimum.accumulate((forward - rise_ahead)[::-1])[::-1]
    # Sums over a long path lose the last digits: they must not lift a speed above its cap, nor move a rest, nor lower
    # a speed whose square is smaller than they are.
    rounding = 4 * np.finfo(np.float64).eps * rise[-1]
    return np.where(backward > caps - rounding, caps, np.maximum(backward, 0.0))


def find_range_minima(values: Array, low: Index, high: Index) -> Array:
    """The least of values[low : high + 1] for many ranges: a sparse table, built as far as the longest range."""
    levels = [values]
    longest = int((high - low).max(initial=0)) + 1
    width = 1
    while 2 * width <= longest:
        last = levels[-1]
        levels.append(np.minimum(last[:-width], last[width:]))
        width *= 2
    level = np.frexp((high - low + 1).astype(np.float64))[1] - 1
    out = np.empty(len(low))
    for k, table in enumerate(levels):
        at = np.flatnonzero(level == k)
        out[at] = np.minimum(table[low[at]], table[high[at] - 2**k + 1])
    return out


def spread_cells(values: Array, t: Array, reach_s: Array) -> Array:
    """Values of cells, each the least of the cells within `reach_s` of it by the times `t` of the nodes."""
    begin, end = t[:-1], t[1:]
    cell = np.arange(len(values))
    tiny = 1e-6 * reach_s
    low = np.searchsorted(end, begin - reach_s + tiny, side="right")
    high = np.searchsorted(begin, end + reach_s - tiny, side="left") - 1
    return find_range_minima(values, np.minimum(low, cell), np.maximum(high, cell))
