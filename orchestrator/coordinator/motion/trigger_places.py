"""Where the axes of a step were at edges of an output: what their plans make of the intervals of the edges, and of the
evidence of their starts."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.path_feed import PathFeed
from orchestrator.model.profile import Profile
from orchestrator.model.report import AxisPlace, MemberReport
from orchestrator.model.state import TimeInterval
from orchestrator.plan.path_profiles import Array
from orchestrator.plan.triggers import make_range_finder

FindPlaces = Callable[[Sequence[TimeInterval]], list[dict[str, AxisPlace]]]
"""The places of all axes at each of some intervals of fleet time."""


def know_no_places(spans: Sequence[TimeInterval]) -> list[dict[str, AxisPlace]]:
    """Of a step that was not done as planned nothing is claimed."""
    return [{} for _ in spans]


class PlaceFinder:
    """The places of the axes of one motion.

    whole: the profiles of all of the motion; of a path in chunks they are over the time of the path, which `feed` tells
    of an instant.
    """

    def __init__(
        self, view: FleetView, agreement: StartAgreement, whole: Mapping[str, Profile], feed: PathFeed | None
    ) -> None:
        self._view = view
        self._agreement = agreement
        self._whole = whole
        self._feed = feed

    def make_finder(self, members: Mapping[str, MemberReport]) -> FindPlaces:
        """A function that finds them by the evidence of their starts. members: their reports."""
        finders = {
            f"{member}.{name}": self._make_axis_finder(member, name, evidence.start_for_verdict)
            for member, report in members.items()
            for name, evidence in report.evidence.items()
        }

        def find_places(spans: Sequence[TimeInterval]) -> list[dict[str, AxisPlace]]:
            columns = {axis: find(spans) for axis, find in finders.items()}
            return [{axis: places[row] for axis, places in columns.items()} for row in range(len(spans))]

        return find_places

    def _make_axis_finder(
        self, member: str, name: str, start: TimeInterval
    ) -> Callable[[Sequence[TimeInterval]], list[AxisPlace]]:
        proposal, axis = self._agreement.proposals[member], f"{member}.{name}"
        error_counts = proposal.path_error_counts.get(name, 0.0) + 1.0  # a count of rounding
        scale = float(self._view.fleet.axis(axis).counts_per_unit)
        find_range = make_range_finder(self._whole[axis])

        def find(spans: Sequence[TimeInterval]) -> list[AxisPlace]:
            early_s = np.array([max(0, span.earliest_ns - start.latest_ns) for span in spans]) / NS_PER_S
            late_s = np.array([max(0, span.latest_ns - start.earliest_ns) for span in spans]) / NS_PER_S
            early_s -= self._find_drift_s(member, early_s)
            late_s += self._find_drift_s(member, late_s)
            if self._feed is not None:
                clock = self._feed.chunk.clock
                early_s, late_s = (clock.evaluate(times_s).path_s for times_s in (early_s, late_s))
            places: list[AxisPlace] = []
            for early, late in zip(early_s.tolist(), late_s.tolist(), strict=True):
                low, high = find_range(early, late)
                ends = sorted(count / scale for count in (low - error_counts, high + error_counts))
                places.append(AxisPlace(least=ends[0], most=ends[1]))
            return places

        return find

    def _find_drift_s(self, member: str, times_s: Array) -> Array:
        """By how much the clock of a member may be off at instants of the motion; that of one which loads a path in
        chunks is fitted anew with each."""
        first, rate = self._agreement.first, self._agreement.proposals[member].clock_ppm * 1e-6
        if first is None or member not in first.members:
            return times_s * rate
        return np.minimum(times_s, first.most_s + first.load_s) * rate
