"""When the axis that flies was at a place of its flight, by the evidence of its start and the bound of its clock."""

from collections.abc import Callable
from math import ceil, floor

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.jobs.run.flown_rows import find_error
from orchestrator.coordinator.motion.path_proof import narrow_start
from orchestrator.coordinator.motion.step import PlannedMotion
from orchestrator.model.names import controller_of
from orchestrator.model.state import TimeInterval
from orchestrator.plan.flying.lines import FlownLines

LEAST_RATE = 0.01
"""Of the planned speed: an axis that is slower passes no place at an instant that is known."""


def make_interval_finder(motion: PlannedMotion, lines: FlownLines) -> Callable[[float, float], TimeInterval]:
    """A function that tells when the axis was where its plan has it so long after T0 (s), at a rate of its planned
    speed."""
    agreement, first = motion.agreement, motion.agreement.first
    assert first is not None and agreement.path is not None
    t0_ns, member = motion.start.state.t0_fleet_ns, controller_of(lines.axis)
    early_ns, late_ns = narrow_start(agreement, member, motion.watch.reports[member], t0_ns)
    most_age_s, clock_rate = first.most_s + first.load_s, agreement.proposals[member].clock_ppm * 1e-6
    error_s = find_error(agreement.path, lines) / lines.speed

    def find_interval(at_s: float, rate: float) -> TimeInterval:
        beside_s = clock_rate * min(at_s, most_age_s) + error_s / max(rate, LEAST_RATE)
        planned_ns, beside_ns = t0_ns + at_s * NS_PER_S, beside_s * NS_PER_S
        return TimeInterval(
            earliest_ns=floor(planned_ns + early_ns - beside_ns), latest_ns=ceil(planned_ns + late_ns + beside_ns)
        )

    return find_interval
