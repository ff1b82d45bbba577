"""Where an axis may be while a step moves it: the counts of its profiles, and no others."""

from dataclasses import dataclass

from orchestrator.model.profile import Profile

ROUNDING_COUNTS = 2  # of a commanded position


@dataclass(frozen=True, slots=True)
class AxisWay:
    """The way of one axis in a step, in counts of its controller.

    start, end: where it begins and ends. low, high: how far it goes, with all chunks and other targets up to now.
    error: by how much a commanded position may differ from the plan."""

    start: int
    end: int
    low: float
    high: float
    error: float

    @classmethod
    def from_profile(cls, profile: Profile, path_error: float) -> "AxisWay":
        """The way of a profile whose lowered form is off it by up to `path_error` counts."""
        low, high = profile.extent_counts
        return cls(profile.start_counts, profile.end_counts, low, high, ROUNDING_COUNTS + path_error)

    def widen(self, profile: Profile, path_error: float) -> "AxisWay":
        """The way that may go on by another profile from somewhere on it."""
        low, high = profile.extent_counts
        error = max(self.error, ROUNDING_COUNTS + path_error)
        return AxisWay(self.start, self.end, min(self.low, low), max(self.high, high), error)

    def is_off_start(self, counts: float) -> bool:
        """Whether a commanded position is not that of the beginning."""
        return abs(counts - self.start) > self.error

    def is_off_end(self, counts: float) -> bool:
        """Whether a commanded position is not that of the end."""
        return abs(counts - self.end) > self.error

    def is_outside(self, counts: float) -> bool:
        """Whether a commanded position is one to which the step brings the axis at no time."""
        return not self.low - self.error <= counts <= self.high + self.error
