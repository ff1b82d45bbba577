"""Set-point trajectory: a profile as one set-point per SYNC, for a drive that follows positions.

With each SYNC the drive moves linearly to its set-point and reaches it one period later (60C2h), when the next SYNC
comes. So the set-point of SYNC n is the plan's position n + 1 periods after its start, and the first one starts the
motion.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, isclose

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.profile import Profile

_ROUNDING = 1e-6  # of a period: tolerance for a plan that slightly exceeds its last period


@dataclass(frozen=True, slots=True)
class SetpointTrajectory:
    """The set-points of `profile`, numbered from 0. period_ns: period of SYNC. begin_s: when the profile begins, after
    the motion did; is_chunk: it is a part of a path. peak_acceleration, peak_jerk: of the whole path.
    """

    profile: Profile
    period_ns: int
    begin_s: float = 0.0
    is_chunk: bool = False
    peak_acceleration: float = 0.0
    peak_jerk: float = 0.0

    @property
    def point_count(self) -> int:
        """Return the number of set-points, which is the number of periods of motion."""
        return max(1, ceil(self._planned_periods - _ROUNDING))

    @property
    def duration_s(self) -> float:
        """Return the duration; the last set-point, too, takes a whole period."""
        return self.point_count * self.period_ns / NS_PER_S

    @property
    def _planned_periods(self) -> float:
        return (self.begin_s + self.profile.duration_s) * NS_PER_S / self.period_ns

    def setpoint_function(self) -> Callable[[int], int]:
        """Return the function of set-points by SYNC number; before the first one the start, after the last one the end.

        The first set-point is at least one count from the start, and the last but one a count from the end: so the
        executed motion begins and ends with the plan, also where the plan has not moved a count yet. An axis that turns
        back, as on a path, may be beyond both, and has no such first and last count. A linear segment between points of
        a curve lies on one side of it: half of that deviation is subtracted, so that it lies on both sides.
        """
        at, last, period_s = self.profile.make_evaluator(), self.point_count - 1, self.period_ns / NS_PER_S
        start, end = self.profile.start_counts, self.profile.end_counts
        low, high = (start + 1, end - 1) if end > start else (end + 1, start - 1)
        keeps_ends, begin_s = not self.is_chunk and self.profile.stays_between_ends, self.begin_s

        def setpoint_at(number: int) -> int:
            if number < 0:
                return start
            if number >= last:
                return end
            next_state = at((number + 1) * period_s - begin_s)
            counts = start + round(next_state.position - next_state.acceleration * period_s**2 / 16)
            return min(max(counts, low), high) if keeps_ends else counts

        return setpoint_at

    @property
    def still_periods(self) -> tuple[int, int]:
        """Return how many periods it stands before its first count, and after its last one: on a path an axis may begin
        late, or slowly, and so may it end."""
        at, last = self.setpoint_function(), self.point_count - 1
        start, end = at(-1), at(last)
        still_before = next((number for number in range(last + 1) if at(number) != start), last)
        still_after = next((back_number for back_number in range(last + 1) if at(last - 1 - back_number) != end), last)
        return still_before, still_after

    @property
    def path_error_counts(self) -> float:
        """Return the largest distance between the plan and linear segments between set-points in whole counts."""
        period_s, profile = self.period_ns / NS_PER_S, self.profile
        # The last term is the variation of the deviation within a period, by the jerk.
        jerk = max(max(map(abs, profile.jerks)) * abs(profile.scale_counts), self.peak_jerk)
        acceleration = max(profile.peak_acceleration, self.peak_acceleration)
        bow = acceleration * period_s**2 / 16 + jerk * period_s**3 / 100
        if self.is_chunk:
            # The path, or a stopping tail, may end anywhere within a period.
            return max(bow, min(acceleration * period_s**2 / 2, jerk * period_s**3 / 6)) + 1.5
        if not isclose(self._planned_periods, self.point_count, abs_tol=_ROUNDING):
            # The plan ends within the last period, and the drive at the end of that period.
            last_position = profile.state_at((self.point_count - 1) * period_s - self.begin_s).position
            bow = max(bow, abs(profile.end_counts - profile.start_counts - last_position))
        return bow + 1.5
