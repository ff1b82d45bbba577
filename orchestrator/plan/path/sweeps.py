"""Speeds along a grid under caps and accelerations: passes forward and backward, in closed form and without a loop.

b is the squared speed: along a cell of constant acceleration a and length h it grows by 2 a h. The largest b that keeps
all caps is a running minimum of (cap - sum of 2 a h), in one numpy call for the whole path, once from each side. This
is the phase-plane method of Bobrow, Dubowsky and Gibson (1985) and Shin and McKay (1985) with accelerations fixed ahead.
"""

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index

SHORTEST_S = 1e-4  # a smoothing time below it limits slopes as it does, because sums of steep slopes lose digits


def sweep_squares(caps: Array, acceleration: Array, h: Array) -> Array:
    """The largest squared speeds at nodes: at most `caps`, changing in each cell by 2 `acceleration` `h` at most."""
    rise = np.concatenate([[0.0], np.cumsum(2 * acceleration * h)])
    forward = rise + np.minimum.accumulate(caps - rise)
    # Backwards from the end: the rise still to come.
    ahead = rise[-1] - rise
    backward = ahead + np.minimum.accumulate((forward - ahead)[::-1])[::-1]
    # Sums over a long path lose the last digits: they must not lift a speed above its cap, nor move a rest.
    return np.clip(backward, 0.0, caps)


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


def spread_caps(caps: Array, s: Array, smoothing_s: Array) -> Array:
    """Caps that still hold after speeds are averaged over `smoothing_s`: each holds for half of it on both sides.

    A cap v reaches v T/2 far, which is exactly T/2 at that speed. Its slope is limited to 2/T before, so that reaches
    overlap in order; that concerns speeds below A T/2 only.
    """
    half = smoothing_s / 2
    slope = np.minimum(1.0 / np.maximum(half[:-1], SHORTEST_S), 1.0 / np.maximum(half[1:], SHORTEST_S))
    rise = np.concatenate([[0.0], np.cumsum(slope * np.diff(s))])
    forward = rise + np.minimum.accumulate(caps - rise)
    ahead = -rise
    caps = np.minimum(caps, ahead + np.minimum.accumulate((forward - ahead)[::-1])[::-1])
    tiny = 1e-9 * caps * half
    low = np.searchsorted(np.maximum.accumulate(s + caps * half + tiny), s, side="left")
    begin = np.minimum.accumulate((s - caps * half - tiny)[::-1])[::-1]
    high = np.searchsorted(begin, s, side="right") - 1
    node = np.arange(len(s))
    return find_range_minima(caps, np.minimum(low, node), np.maximum(high, node))


def spread_cells(values: Array, t: Array, reach_s: Array) -> Array:
    """Values of cells, each the least of the cells within `reach_s` of it by the times `t` of the nodes."""
    begin, end = t[:-1], t[1:]
    cell = np.arange(len(values))
    tiny = 1e-6 * reach_s
    low = np.searchsorted(end, begin - reach_s + tiny, side="right")
    high = np.searchsorted(begin, end + reach_s - tiny, side="left") - 1
    return find_range_minima(values, np.minimum(low, cell), np.maximum(high, cell))
