"""The time of a path in the time of its motion: how fast the planned motion is played, with holds and overrides.

A motion that is planned as positions over path time follows the same path at any rate. The rate changes by smooth ramps
only (3u² - 2u³), so that the velocity of every axis stays smooth: a ramp to 0 brakes along the path.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from orchestrator.plan.path_profiles import Array

MOST_RATE = 1.2
"""The highest rate that users may ask for (feed override)."""
HALVINGS = 50  # of a ramp, in which an instant is


class RateRamp(NamedTuple):
    """From `begin_s` of the motion on, at `path_s` of the path, the rate goes from `before` to `after` within `ramp_s`,
    and stays there."""

    begin_s: float
    path_s: float
    before: float
    after: float
    ramp_s: float

    @property
    def end_s(self) -> float:
        """When the rate has become `after`."""
        return self.begin_s + self.ramp_s

    @property
    def end_path_s(self) -> float:
        """The path time then."""
        return self.path_s + (self.before + self.after) / 2 * self.ramp_s


class PathTimes(NamedTuple):
    """Path time at instants of the motion, and its first three derivatives: the rate, its change, and the change of
    that."""

    path_s: Array
    rates: Array
    changes: Array
    jerks: Array


@dataclass(frozen=True, slots=True)
class PathClock:
    """Path time over the time of the motion. ramps: in their order; each begins after the one before it has ended."""

    ramps: tuple[RateRamp, ...]

    @classmethod
    def from_rest(cls, path_s: float, ramp_s: float, rate: float = 1.0) -> "PathClock":
        """The clock of a motion that begins at `path_s` of the path: with `rate` at once (`ramp_s` 0: the path itself
        is at rest there), or from rest."""
        return cls((RateRamp(0.0, path_s, 0.0 if ramp_s else rate, rate, ramp_s),))

    @property
    def rate(self) -> float:
        """The rate after the last ramp."""
        return self.ramps[-1].after

    def change_rate(self, begin_s: float, rate: float, ramp_s: float) -> "PathClock":
        """The clock with another rate from `begin_s` of the motion on, which is no earlier than the end of its last
        ramp."""
        path_s = float(self.evaluate(np.array([begin_s])).path_s[0])
        return PathClock((*self.ramps, RateRamp(begin_s, path_s, self.rate, rate, ramp_s)))

    def find_path_s(self, at_s: float) -> float:
        """The path time at an instant of the motion."""
        return float(self.evaluate(np.array([at_s])).path_s[0])

    def evaluate(self, times_s: Array) -> PathTimes:
        """Path times at instants of the motion."""
        starts = np.array([ramp.begin_s for ramp in self.ramps])
        path_s, rate_before, rate_after, width = np.array([ramp[1:] for ramp in self.ramps]).T
        k = np.clip(np.searchsorted(starts, times_s, side="right") - 1, 0, len(starts) - 1)
        t, step = times_s - starts[k], (rate_after - rate_before)[k]
        length = np.where(width[k] > 0.0, width[k], 1.0)
        is_inside = (t < width[k]) & (width[k] > 0.0)
        u = np.where(is_inside, t / length, 1.0)
        risen = width[k] * (rate_before[k] * u + step * u**3 * (1 - u / 2))
        return PathTimes(
            path_s[k] + risen + np.where(is_inside, 0.0, (t - width[k]) * rate_after[k]),
            rate_before[k] + step * u**2 * (3 - 2 * u),
            np.where(is_inside, step * 6 * u * (1 - u) / length, 0.0),
            np.where(is_inside, step * (6 - 12 * u) / length**2, 0.0),
        )

    def find_instants(self, places_s: Array) -> Array:
        """When the motion reaches places of the path, all of which it does reach."""
        begins = np.array([ramp.path_s for ramp in self.ramps])
        k = np.clip(np.searchsorted(begins, places_s, side="right") - 1, 0, len(begins) - 1)
        ends = np.array([ramp.end_path_s for ramp in self.ramps])[k]
        begin_s, _, rate_before, rate_after, width = np.array(self.ramps)[k].T
        is_inside = (places_s < ends) | (rate_after <= 0.0)
        # Behind a ramp the rate is constant; in one the path time is a polynomial of the motion's.
        constant = np.where(rate_after > 0.0, rate_after, 1.0)
        instants: Array = begin_s + width + (places_s - ends) / constant
        low, high = np.zeros(len(places_s)), np.ones(len(places_s))
        for _ in range(HALVINGS):
            u = (low + high) / 2
            risen = width * (rate_before * u + (rate_after - rate_before) * u**3 * (1 - u / 2))
            is_before = begins[k] + risen < places_s
            low, high = np.where(is_before, u, low), np.where(is_before, high, u)
        instants[is_inside] = (begin_s + width * high)[is_inside]
        return instants

    def find_instant(self, path_s: float) -> float:
        """When the motion reaches `path_s` of the path, which lies behind the last ramp; infinite at rate 0."""
        last = self.ramps[-1]
        return last.end_s + (path_s - last.end_path_s) / last.after if last.after > 0.0 else float("inf")
