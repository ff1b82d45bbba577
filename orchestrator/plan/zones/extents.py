"""Between which positions and speeds a profile is in a span of time; quick for those with thousands of segments."""

from bisect import bisect_right
from collections.abc import Callable
from functools import cached_property

import numpy as np

from orchestrator.model.profile import MotionState, Profile, Segment, find_turning_points
from orchestrator.plan.path_profiles import Array

FEW = 16
"""Segments that are looked at one by one."""


class ProfileExtents:
    """Extents of one profile, in counts from its start."""

    def __init__(self, profile: Profile) -> None:
        self._profile = profile
        self._segments = profile.segments
        self._starts = [segment.start_s for segment in self._segments]

    def find_range(self, begin_s: float, end_s: float) -> tuple[float, float]:
        """Its least and its largest position from one instant to another."""
        ends = [self._at(begin_s).position, self._at(end_s).position]
        first, last = self._find_span(begin_s, end_s)
        if last - first > FEW:  # those between the first and the last one are whole
            ends += [float(self._lows[first + 1 : last].min()), float(self._highs[first + 1 : last].max())]
            cut_segments = [self._segments[first], self._segments[last]]
        else:
            cut_segments = self._segments[first : last + 1]
        for segment in cut_segments:
            for turn_s in find_turning_points(segment.velocity, segment.acceleration, segment.jerk):
                if 0.0 < turn_s < segment.duration_s and begin_s < segment.start_s + turn_s < end_s:
                    ends.append(segment.state_at(turn_s).position)
        return min(ends), max(ends)

    def find_speeds(self, begin_s: float, end_s: float) -> tuple[float, float]:
        """Bounds of its velocity from one instant to another, counts/s: of whole segments."""
        first, last = self._find_span(begin_s, end_s)
        return float(self._slowest[first : last + 1].min()), float(self._fastest[first : last + 1].max())

    def _find_span(self, begin_s: float, end_s: float) -> tuple[int, int]:
        """The first and the last segment that a span of time touches."""
        first = max(bisect_right(self._starts, begin_s) - 1, 0)
        return first, max(bisect_right(self._starts, end_s) - 1, first)

    @cached_property
    def _at(self) -> Callable[[float], MotionState]:
        return self._profile.make_evaluator()

    # Of whole segments

    @cached_property
    def _rows(self) -> Array:
        """Duration, position, velocity, acceleration and jerk of each segment, by columns."""
        return np.array([Segment(*segment)[1:] for segment in self._segments]).T

    @cached_property
    def _positions(self) -> tuple[Array, Array]:
        """The least and the largest position of each segment, at its ends or where its velocity is 0."""
        t, p, v, a, j = self._rows
        ends = [p, p + t * (v + t * (a / 2 + t * j / 6))]
        root = np.sqrt(np.maximum(a * a - 2 * j * v, 0.0))
        with np.errstate(divide="ignore", invalid="ignore"):
            straight = np.where(a != 0.0, -v / a, 0.0)
            turns = [np.where(j != 0.0, (-a + sign * root) / j, straight) for sign in (-1.0, 1.0)]
        for turn in turns:
            at = np.clip(np.nan_to_num(turn), 0.0, t)
            ends.append(p + at * (v + at * (a / 2 + at * j / 6)))
        return np.min(ends, axis=0), np.max(ends, axis=0)

    @property
    def _lows(self) -> Array:
        return self._positions[0]

    @property
    def _highs(self) -> Array:
        return self._positions[1]

    @cached_property
    def _velocities(self) -> tuple[Array, Array]:
        """The least and the largest velocity of each segment, at its ends or where its acceleration is 0."""
        t, _, v, a, j = self._rows
        with np.errstate(divide="ignore", invalid="ignore"):
            at = np.clip(np.nan_to_num(np.where(j != 0.0, -a / j, 0.0)), 0.0, t)
        ends = [v, v + t * (a + t * j / 2), v + at * (a + at * j / 2)]
        return np.min(ends, axis=0), np.max(ends, axis=0)

    @property
    def _slowest(self) -> Array:
        return self._velocities[0]

    @property
    def _fastest(self) -> Array:
        return self._velocities[1]
