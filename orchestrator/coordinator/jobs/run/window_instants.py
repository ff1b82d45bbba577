"""When the axes that fly were at a place of their flight, by the evidence of their starts and the bounds of their
clocks."""

from collections.abc import Callable
from math import ceil, floor

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.jobs.run.flown_rows import find_error, join_intervals
from orchestrator.coordinator.motion.path_proof import narrow_start
from orchestrator.coordinator.motion.step import PlannedMotion
from orchestrator.model.names import controller_of
from orchestrator.model.state import TimeInterval
from orchestrator.plan.flying.lines import FlownLines

LEAST_RATE = 0.01
"""Of the planned speed: an axis that is slower passes no place at an instant that is known."""


def make_interval_finder(motion: PlannedMotion, lines: FlownLines) -> Callable[[float, float], TimeInterval]:
    """A function that tells when the axes were where their plan has them so long after T0 (s), at a rate of their
    planned speed."""
    agreement, first = motion.agreement, motion.agreement.first
    assert first is not None and agreement.path is not None
    t0_ns, members = motion.start.state.t0_fleet_ns, {controller_of(name) for name in lines.scan.flown_axes}
    starts = {name: narrow_start(agreement, name, motion.watch.reports[name], t0_ns) for name in members}
    most_age_s, error_s = first.most_s + first.load_s, find_error(agreement.path, lines) / lines.slowest

    def find_member_interval(member: str, at_s: float, rate: float) -> TimeInterval:
        clock_rate = agreement.proposals[member].clock_ppm * 1e-6
        beside_s = clock_rate * min(at_s, most_age_s) + error_s / max(rate, LEAST_RATE)
        planned_ns, beside_ns = t0_ns + at_s * NS_PER_S, beside_s * NS_PER_S
        early_ns, late_ns = starts[member]
        return TimeInterval(
            earliest_ns=floor(planned_ns + early_ns - beside_ns), latest_ns=ceil(planned_ns + late_ns + beside_ns)
        )

    return lambda at_s, rate: join_intervals([find_member_interval(name, at_s, rate) for name in members])
