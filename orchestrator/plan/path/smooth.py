"""Smoothing of a coarse motion: its speeds averaged over a time T, which makes jerk finite and changes no limit kept.

The average of a piecewise constant acceleration is piecewise linear: every jump of it becomes a jerk over T. Positions
are the averages of positions: they arrive at the same end, T/2 later. T may differ between stretches from rest to rest.
"""

from dataclasses import dataclass, replace

import numpy as np

from orchestrator.plan.path.arc_length import Array, Index
from orchestrator.plan.path.coarse import CoarseMotion

MERGED = 1e-5  # of the smoothing time (at least 1 ns): shorter segments are left out


@dataclass(frozen=True, slots=True)
class PathMotion:
    """The motion s(t) along a path: segments of constant jerk. Entries: instant, position, speed, acceleration at the
    start of each segment, its jerk, and the number of the stretch from rest to rest that it belongs to; `duration_s` is
    the end of the last one, `length` its position."""

    t: Array
    s: Array
    v: Array
    a: Array
    j: Array
    section: Index
    duration_s: float
    length: float

    @property
    def ends_s(self) -> Array:
        """The end of each segment."""
        return np.append(self.t[1:], self.duration_s)

    def find_segments(self, t: Array) -> Index:
        """The segment at each instant."""
        return np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, len(self.t) - 1)

    def evaluate(self, t: Array) -> tuple[Array, Array, Array, Array]:
        """(position, speed, acceleration, jerk) at instants; at rest before the start and from the end on."""
        k = self.find_segments(t)
        x = np.clip(t, 0.0, self.duration_s) - self.t[k]
        s = self.s[k] + x * (self.v[k] + x * (self.a[k] / 2 + x * self.j[k] / 6))
        v = self.v[k] + x * (self.a[k] + x * self.j[k] / 2)
        is_moving = (t >= 0.0) & (t < self.duration_s)
        s = np.where(t >= self.duration_s, self.length, np.clip(s, 0.0, self.length))
        return (
            s,
            np.where(is_moving, v, 0.0),
            np.where(is_moving, self.a[k] + x * self.j[k], 0.0),
            self.j[k] * is_moving,
        )

    def find_instants(self, s: Array) -> Array:
        """The instant at which the motion reaches each position, to a millionth of its segment."""
        k = np.clip(np.searchsorted(self.s, s, side="right") - 1, 0, len(self.s) - 1)
        v, a, j, distance = self.v[k], self.a[k] / 2, self.j[k] / 6, s - self.s[k]
        low, high = np.zeros(len(s)), self.ends_s[k] - self.t[k]
        for _ in range(BISECTIONS):
            x = (low + high) / 2
            is_beyond = x * (v + x * (a + x * j)) > distance
            low, high = np.where(is_beyond, low, x), np.where(is_beyond, x, high)
        return self.t[k] + (low + high) / 2

    def stretch_sections(self, factors: Array) -> "PathMotion":
        """The same motion with each section in `factors` times its time: speeds, accelerations and jerks fall by its
        powers."""
        f = factors[self.section]
        t = np.concatenate([[0.0], np.cumsum((self.ends_s - self.t) * f)])
        return replace(self, t=t[:-1], v=self.v / f, a=self.a / f**2, j=self.j / f**3, duration_s=float(t[-1]))


BISECTIONS = 20


def smooth_motion(coarse: CoarseMotion, smoothing_s: Array, section: Index) -> PathMotion:
    """Average over `smoothing_s` (per node of `coarse`, as its section is; it rests between two sections for half of
    the smoothing time of each)."""
    half = smoothing_s / 2
    knots = np.sort(np.concatenate([coarse.t - half, coarse.t + half]))
    first_knots = np.flatnonzero(np.concatenate([[True], np.diff(knots) > max(1e-9, MERGED * smoothing_s.min())]))
    # A segment has the acceleration behind the last of the knots that are merged into its first: a long one would
    # multiply the difference.
    settled_knots = knots[np.append(first_knots[1:] - 1, len(knots) - 1)][:-1]
    knots = knots[first_knots]
    # Inside a segment nothing changes, so its middle tells its smoothing time and accelerations.
    middle = (knots[:-1] + knots[1:]) / 2
    cell = coarse.find_cells(middle)
    # Only a pause has two smoothing times: half of each, one after the other.
    early = middle - coarse.t[cell] < smoothing_s[cell] / 2
    width = np.where(early, smoothing_s[cell], smoothing_s[cell + 1])
    number = np.where(early, section[cell], section[cell + 1])
    sharp = width <= 0.0
    width = np.where(sharp, 1.0, width)
    half = np.where(sharp, 0.0, width / 2)
    # What a neighbouring section does is not averaged: to this one it stands still before its start and after its end.
    first = np.flatnonzero(np.diff(section, prepend=section[0] - 1))
    number -= section[0]
    window = coarse.t[first][number], coarse.t[np.append(first[1:], len(section)) - 1][number]
    begin, dt = knots[:-1], np.diff(knots)
    late, soon_window = _Window(coarse, *window, settled_knots + half), _Window(coarse, *window, settled_knots - half)
    window_ahead, window_behind = _Window(coarse, *window, middle + half), _Window(coarse, *window, middle - half)
    j = np.where(sharp, 0.0, (window_ahead.accelerations - window_behind.accelerations) / width)
    v = np.where(sharp, late.speeds, np.maximum(late.positions - soon_window.positions, 0.0) / width)
    a = np.where(sharp, window_ahead.accelerations, (late.speeds - soon_window.speeds) / width)
    s = _sum_sections(dt * (v + dt * (a / 2 + dt * j / 6)), number, coarse.s[np.append(first, len(section) - 1)])
    return PathMotion(
        t=begin - knots[0],
        s=s,
        v=v,
        a=a,
        j=j,
        section=number,
        duration_s=float(knots[-1] - knots[0]),
        length=float(coarse.s[-1]),
    )


def _sum_sections(steps: Array, number: Index, ends: Array) -> Array:
    """Positions before each step. Sums have rounding of their own: a section begins and ends exactly at its `ends`."""
    first = np.flatnonzero(np.diff(number, prepend=-1))
    total = np.concatenate([[0.0], np.cumsum(steps)])
    begin = total[first]
    lengths = total[np.append(first[1:], len(steps))] - begin
    return ends[number] + (total[:-1] - begin[number]) * (np.diff(ends) / lengths)[number]


class _Window:
    """The coarse motion of sections, from `first` to `last`, at instants; outside of them it is at rest."""

    def __init__(self, coarse: CoarseMotion, first: Array, last: Array, t: Array) -> None:
        is_inside = (t > first) & (t < last)
        t = np.clip(t, first, last)
        cell = coarse.find_cells(t)
        dt = t - coarse.t[cell]
        a, v = coarse.a[cell], coarse.v[cell]
        self.positions = coarse.s[cell] + dt * (v + dt * a / 2)
        self.speeds = np.where(is_inside, v + dt * a, 0.0)
        self.accelerations = np.where(is_inside, a, 0.0)
