"""Positions, and the interval of fleet time in which they were read."""

from collections.abc import Mapping

from adapters.contract import ControllerReading, HostInterval
from orchestrator.clock.fleet import FleetScale
from orchestrator.model.state import AxisState, ReadPosition, TimeInterval
from orchestrator.model.units import Unit


def fleet_interval(span: HostInterval, scale: FleetScale) -> TimeInterval:
    """Convert an interval of host time to fleet time."""
    earliest_ns, latest_ns = scale.to_fleet_span(span.earliest_ns, span.latest_ns)
    return TimeInterval(earliest_ns=earliest_ns, latest_ns=latest_ns)


def read_interval(reading: ControllerReading | None, scale: FleetScale | None) -> TimeInterval | None:
    """Return when the positions of a reading were sampled; None without a reading, or without fleet time."""
    if reading is None or reading.sampled is None or scale is None:
        return None
    return fleet_interval(reading.sampled, scale)


def rest_positions(axes: Mapping[str, AxisState], interval: TimeInterval) -> dict[str, ReadPosition]:
    """Return the positions of those axes that are at rest. interval: in which they were read."""
    return {
        name: ReadPosition(position=axis.position, unit=Unit(axis.unit), read=interval)
        for name, axis in axes.items()
        if not axis.moving
    }
