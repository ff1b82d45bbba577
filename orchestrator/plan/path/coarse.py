"""The coarse motion along a path: piecewise constant acceleration, before its accelerations are smoothed.

Averaged over a time T (`smooth.py`) it keeps a jerk of the largest change of acceleration within T, divided by T. So
between speeding up and slowing down there is a time T of constant speed: then the smoothed motion is the fastest one of
constant limits, with jerk A/T. In valleys of speed `spread_caps` has made that time, on peaks `flatten_peaks` does.
"""

from dataclasses import dataclass

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.sweeps import sweep_squares

STEADY = 1e-6  # of the largest acceleration: below, a cell is of constant speed
BISECTIONS = 30
CLOSE = 1e-6  # of the smoothing time: as well as an instant of a plateau need be known
BLOCK = 512  # peaks treated at a time: what they look up stays in the processor's cache
MARGIN = 1e-4  # by which plateaus are longer than they must be, because neighbouring jerks would add up
PLATEAU_ROUNDS = 5


@dataclass(frozen=True, slots=True)
class CoarseMotion:
    """Instants, positions and speeds at nodes; acceleration of the cells between them, which is constant."""

    t: Array
    s: Array
    v: Array
    a: Array

    def find_cells(self, t: Array) -> Index:
        """The cell at each instant."""
        return np.searchsorted(self.t[1:-1], t, side="right")

    def positions_at(self, t: Array) -> Array:
        """The position at each instant; at rest before the start and after the end."""
        t = np.clip(t, self.t[0], self.t[-1])
        cell = self.find_cells(t)
        dt = t - self.t[cell]
        return self.s[cell] + dt * (self.v[cell] + dt * self.a[cell] / 2)

    def speeds_at(self, t: Array) -> Array:
        """The speed at each instant."""
        cell = self.find_cells(t)
        return self.v[cell] + (t - self.t[cell]) * self.a[cell]


@dataclass(frozen=True, slots=True)
class Ladder:
    """What speeds are swept on: nodes with caps of the squared speed, cells with acceleration and a cap between nodes,
    and the smoothing time and the section of each node."""

    s: Array
    caps: Array
    acceleration: Array
    cell_caps: Array
    smoothing_s: Array
    section: Index

    def sweep(self) -> Array:
        """The largest squared speeds."""
        return sweep_squares(self.caps, self.acceleration, np.diff(self.s))


def integrate_ladder(ladder: Ladder, s: Array, squares: Array, source: Index) -> tuple[CoarseMotion, Array, Index]:
    """(motion, smoothing times, sections) through nodes of a ladder. Between two sections it rests for half of the
    smoothing time of each."""
    width, section = ladder.smoothing_s[source], ladder.section[source]
    pause = np.where(np.diff(section) > 0, (width[:-1] + width[1:]) / 2, 0.0)
    return integrate_squares(s, squares, pause), width, section


def integrate_squares(s: Array, squares: Array, pause_s: Array) -> CoarseMotion:
    """The motion through nodes at squared speeds; `pause_s`: how long it rests in each cell without length."""
    v = np.sqrt(squares)
    h = np.diff(s)
    speed_sums = v[:-1] + v[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        dt = np.where(h > 0.0, 2 * h / speed_sums, 0.0)
        a = np.where(dt > 0.0, np.diff(v) / dt, 0.0)
    dt += pause_s
    return CoarseMotion(np.concatenate([[0.0], np.cumsum(dt)]), s, v, a)


def widen_valleys(ladder: Ladder, squares: Array) -> Ladder:
    """The ladder with caps that make each valley of `squares` last its smoothing time: so far on both sides that the
    motion, at the valley's speed, needs half of it."""
    change = np.diff(squares)
    slopes = np.flatnonzero(np.abs(change) > STEADY * squares.max(initial=0.0))
    valley = (change[slopes[:-1]] < 0) & (change[slopes[1:]] > 0)
    first, last = slopes[:-1][valley] + 1, slopes[1:][valley]
    level = squares[first]
    want = np.sqrt(level) * ladder.smoothing_s[first] * (1 + MARGIN) - (ladder.s[last] - ladder.s[first])
    short = np.flatnonzero((want > MARGIN / 2 * np.sqrt(level) * ladder.smoothing_s[first]) & (level > 0.0))
    if not len(short):
        return ladder
    low = np.maximum(ladder.s[first[short]] - want[short] / 2, 0.0)
    high = np.minimum(ladder.s[last[short]] + want[short] / 2, ladder.s[-1])
    return _lower_caps(ladder, low, high, level[short])


def cap_pieces(ladder: Ladder, low: Array, high: Array, level: Array) -> Ladder:
    """The ladder with caps of pieces: `level` (squared speed) from `low` to `high`."""
    return _lower_caps(ladder, low, high, level) if len(low) else ladder


def _lower_caps(ladder: Ladder, low: Array, high: Array, level: Array) -> Ladder:
    """Caps of `level` from `low` to `high`, with nodes there."""
    at = np.concatenate([low, high])
    cell = np.clip(np.searchsorted(ladder.s, at, side="right") - 1, 0, len(ladder.s) - 2)
    h = ladder.s[cell + 1] - ladder.s[cell]
    part = (at - ladder.s[cell]) / np.maximum(h, 1e-300)
    caps_between = np.maximum(ladder.cell_caps[cell], (1 - part) * ladder.caps[cell] + part * ladder.caps[cell + 1])
    s = np.concatenate([ladder.s, at])
    source = np.concatenate([np.arange(len(ladder.s)), cell])
    order = np.lexsort((s, source))
    s, source = s[order], source[order]
    caps = np.concatenate([ladder.caps, caps_between])[order]
    cells = source[:-1]
    cell_caps = ladder.cell_caps[cells].copy()
    # Few nodes lie inside one valley: as many rounds as the largest number of them.
    begin, end = np.searchsorted(s, low, side="left"), np.searchsorted(s, high, side="right")
    for k in range(int((end - begin).max())):
        mask = begin + k < end
        np.minimum.at(caps, begin[mask] + k, level[mask])
        inner = begin + k < end - 1
        np.minimum.at(cell_caps, begin[inner] + k, level[inner])
    return Ladder(
        s=s,
        caps=caps,
        acceleration=ladder.acceleration[np.minimum(cells, len(ladder.acceleration) - 1)],
        cell_caps=cell_caps,
        smoothing_s=ladder.smoothing_s[source],
        section=ladder.section[source],
    )


def insert_peaks(ladder: Ladder, squares: Array) -> tuple[Array, Array, Index]:
    """Nodes where speeding up and slowing down cross inside a cell, or reach its cap: (s, squares, source), with
    `source` the cell of an old node before each new one."""
    s, caps, acceleration = ladder.s, ladder.cell_caps, ladder.acceleration
    h = np.diff(s)
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = (np.diff(squares) + 2 * acceleration * h) / (4 * acceleration)
        top = np.minimum(squares[:-1] + 2 * acceleration * crossing, caps)
        rise = (top - squares[:-1]) / (2 * acceleration)
        fall = (top - squares[1:]) / (2 * acceleration)
        level = h - rise - fall
        # Of the cell, or of the way in which its top is reached: at 3 µm/s that is 3 nm, in a cell of 20 mm.
        small = 1e-9 * np.minimum(h, top / (2 * acceleration))
        corners = np.flatnonzero(
            (rise > -small)
            & (fall > -small)
            & (rise + fall > small)
            & ((np.minimum(rise, fall) > small) | (level > small))
        )
    flat = corners[level[corners] > small[corners]]
    new_s = np.concatenate([s, s[corners] + rise[corners], s[flat + 1] - fall[flat]])
    new_squares = np.concatenate([squares, top[corners], top[flat]])
    source = np.concatenate([np.arange(len(s)), corners, flat])
    rank = np.concatenate([np.zeros(len(s)), np.ones(len(corners)), np.full(len(flat), 2.0)])
    order = np.lexsort((rank, source))
    return new_s[order], new_squares[order], source[order]


def flatten_peaks(ladder: Ladder, squares: Array) -> Ladder:
    """The ladder with caps that make each peak of `squares` last its smoothing time.

    The level is where both flanks are as far apart as the plateau then lasts; found by bisection, all peaks at once.
    """
    s, squares, source = insert_peaks(ladder, squares)
    motion, smoothing_s, _ = integrate_ladder(ladder, s, squares, source)
    begin, end, width = _find_peaks(motion, smoothing_s)
    if not len(begin):
        return ladder
    parts = [
        _find_plateaus(motion, begin[k : k + BLOCK], end[k : k + BLOCK], width[k : k + BLOCK])
        for k in range(0, len(begin), BLOCK)
    ]
    return _lower_caps(ladder, *(np.concatenate(part) for part in zip(*parts, strict=True)))


def _find_plateaus(motion: CoarseMotion, begin: Array, end: Array, width: Array) -> tuple[Array, Array, Array]:
    """(begin, end, squared speed) of plateaus, as positions, for peaks in order of time."""
    first, last = np.searchsorted(motion.t, [begin[0] - width.max(), end[-1] + width.max()])
    first = max(int(first) - 1, 0)
    nodes, cells = slice(first, int(last) + 1), slice(first, int(last))
    motion = CoarseMotion(motion.t[nodes], motion.s[nodes], motion.v[nodes], motion.a[cells])
    window = width
    longest = width
    begins = _find_left(motion, (end - window, begin), window)
    for k in range(BISECTIONS):
        # A plateau is slower than the peak, and takes longer.
        level = np.minimum(motion.speeds_at(begins), motion.speeds_at(begins + window))
        # A window that is wider than the whole rise and fall has no level, which would be a stop for ever.
        if k >= PLATEAU_ROUNDS and (level > 0.0).all():
            break
        distances = motion.positions_at(begins + window) - motion.positions_at(begins)
        longest = np.where(level > 0.0, longest, window / 2)
        narrower = np.clip(
            window * width * level / np.maximum(distances, 1e-300), np.minimum(end - begin, longest), longest
        )
        narrower = np.where(level > 0.0, narrower, longest)
        shifts = np.abs(window - narrower)
        bracket = np.maximum(begins - shifts, end - narrower), np.minimum(begins + shifts, begin)
        begins, window = _find_left(motion, bracket, narrower), narrower
    level = np.minimum(motion.speeds_at(begins), motion.speeds_at(begins + window))
    return motion.positions_at(begins), motion.positions_at(begins + window), level**2


def _find_peaks(motion: CoarseMotion, smoothing_s: Array) -> tuple[Array, Array, Array]:
    """(when speeding up ends, when slowing down begins, how long it must last) of peaks that last too short."""
    steep = np.flatnonzero(
        (np.abs(motion.a) > STEADY * np.abs(motion.a).max(initial=0.0))
        & (np.abs(np.diff(motion.v)) > STEADY * motion.v.max(initial=0.0))
    )
    peak = (motion.a[steep[:-1]] > 0) & (motion.a[steep[1:]] < 0)
    first, last = steep[:-1][peak] + 1, steep[1:][peak]
    width = smoothing_s[first] * (1 + MARGIN)
    short = motion.t[last] - motion.t[first] < width * (1 - MARGIN / 2)
    return motion.t[first[short]], motion.t[last[short]], width[short]


def _find_left(motion: CoarseMotion, bracket: tuple[Array, Array], window: Array) -> Array:
    """The instant before each peak at which the speed is that `window` later, by bisection in the bracket."""
    early, late = bracket
    for _ in range(BISECTIONS):
        middle = (early + late) / 2
        higher = motion.speeds_at(middle) > motion.speeds_at(middle + window)
        early, late = np.where(higher, early, middle), np.where(higher, middle, late)
        if float((late - early - CLOSE * window).max(initial=0.0)) <= 0.0:
            break
    return (early + late) / 2
