"""Fleet time: the scale on which start instants are agreed, integer nanoseconds from 0, tied to the coordinator's
clock."""

from dataclasses import dataclass

from orchestrator.clock.base import Clock
from orchestrator.model.messages import LeaderHeartbeat


@dataclass(frozen=True, slots=True)
class FleetScale:
    """Fleet time as estimated on one host: fleet_ns = host_ns - origin_host_ns, with an error of at most `bound_ns`."""

    scale_id: str
    origin_host_ns: int
    bound_ns: int = 0

    def to_fleet_ns(self, host_ns: int) -> int:
        return host_ns - self.origin_host_ns

    def to_host_ns(self, fleet_ns: int) -> int:
        return fleet_ns + self.origin_host_ns


@dataclass(frozen=True, slots=True)
class TimeExchange:
    """One request for fleet time: host instants of request and reply, and the fleet time in the reply."""

    sent_ns: int
    received_ns: int
    fleet_ns: int


def exact_scale(heartbeat: LeaderHeartbeat, clock: Clock) -> FleetScale | None:
    """Return the exact scale of a coordinator on the same kernel; None when it runs on another."""
    if heartbeat.kernel_id != clock.kernel_id:
        return None
    return FleetScale(heartbeat.scale_id, heartbeat.origin_host_ns)


def estimate_scale(scale_id: str, exchanges: list[TimeExchange]) -> FleetScale:
    """Estimate the scale from requests over the bus: the smallest round trip decides, half of it is the bound.

    Accurate enough for the seconds between adoption and a start; crystals of hosts differ by some 10 ppm.
    """
    best = min(exchanges, key=lambda each: each.received_ns - each.sent_ns)
    middle_ns = (best.sent_ns + best.received_ns) // 2
    return FleetScale(scale_id, middle_ns - best.fleet_ns, (best.received_ns - best.sent_ns + 1) // 2)
