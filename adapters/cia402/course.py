"""A profile as set-points, one for each SYNC: what a drive that follows positions is told.

With each SYNC the drive goes in a straight line to its set-point and is there one period later (60C2h), when the next
SYNC comes. So the set-point of SYNC n is where the plan is n + 1 periods after its start, and the first one starts it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, isclose

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.profile import Profile

_ROUNDING = 1e-6  # of a period: by so much a plan may be too long for its last one


@dataclass(frozen=True, slots=True)
class Course:
    """The set-points of `profile`, numbered from 0. period_ns: of SYNC."""

    profile: Profile
    period_ns: int

    @property
    def count(self) -> int:
        """Set-points, and periods of motion."""
        return max(1, ceil(self._planned_periods - _ROUNDING))

    @property
    def duration_s(self) -> float:
        """The last one, too, is gone to for a whole period."""
        return self.count * self.period_ns / NS_PER_S

    @property
    def _planned_periods(self) -> float:
        return self.profile.duration_s * NS_PER_S / self.period_ns

    def points(self) -> Callable[[int], int]:
        """The set-point of a SYNC by its number; before the first one the start, after the last one the end.

        The first one is a count from the start at least, and the last but one a count from the end: so what is
        executed begins and ends when the plan does, also where that has not gone a count yet. A straight line between
        places on a curve lies on one side of it: half of that is taken off, so that it lies on both.
        """
        at, last, period_s = self.profile.evaluator(), self.count - 1, self.period_ns / NS_PER_S
        start, end = self.profile.start_counts, self.profile.end_counts
        low, high = (start + 1, end - 1) if end > start else (end + 1, start - 1)

        def point(number: int) -> int:
            if number < 0:
                return start
            if number >= last:
                return end
            there = at((number + 1) * period_s)
            return min(max(start + round(there.position - there.acceleration * period_s**2 / 16), low), high)

        return point

    @property
    def path_error_counts(self) -> float:
        """How far a straight line between set-points, which are whole counts, is from the plan at the most."""
        period_s, profile = self.period_ns / NS_PER_S, self.profile
        # The last term is how much the bow differs within a period, by the jerk.
        jerk = max(map(abs, profile.jerks)) * abs(profile.scale_counts)
        bow = profile.peak_acceleration * period_s**2 / 16 + jerk * period_s**3 / 100
        if not isclose(self._planned_periods, self.count, abs_tol=_ROUNDING):
            # The plan is over within the last period, and the drive at the end of that.
            before = profile.at((self.count - 1) * period_s).position
            bow = max(bow, abs(profile.end_counts - profile.start_counts - before))
        return bow + 1.5
