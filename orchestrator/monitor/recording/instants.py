"""The times of a recording: UTC, derived from fleet time, on one scale for the whole file."""

from collections import deque

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.utc import parse_utc_ns
from orchestrator.model.messages import LeaderHeartbeat

STEP_NS = NS_PER_S // 2  # a wall clock that differs by more from the monotonic one was set
MAX_DELAYS = 64  # of messages with an instant of fleet time, of which the fastest counts


class UtcScale:
    """UTC as the host's clock shows it at one moment, continued by its monotonic clock: setting the wall clock does not
    change it."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._zero_ns = 0
        self.restart()

    def restart(self) -> None:
        """Take over what the wall clock shows now."""
        self._zero_ns = parse_utc_ns(self._clock.utc()) - self._clock.now_ns()

    def utc_ns(self, host_ns: int) -> int:
        """UTC of an instant of the host's monotonic clock, ns since 1970."""
        return self._zero_ns + host_ns

    def find_step_ns(self) -> int:
        """By how much the wall clock was set since `restart`; 0: not by more than clocks drift apart."""
        differs_ns = parse_utc_ns(self._clock.utc()) - self.utc_ns(self._clock.now_ns())
        return differs_ns if abs(differs_ns) > STEP_NS else 0


class FleetScale:
    """Fleet time in the recorder's process, from what the leader and the adapters publish; it sends no query.

    On the leader's kernel it is exact. Elsewhere the fastest of the last messages counts, and fleet time is late by
    that message's way, less than a millisecond on a local network.
    """

    def __init__(self, kernel_id: str) -> None:
        self._kernel_id = kernel_id
        self._scale_id = ""
        self._origin_host_ns: int | None = None
        self._offsets: deque[int] = deque(maxlen=MAX_DELAYS)

    def take_heartbeat(self, heartbeat: LeaderHeartbeat) -> None:
        """Take the scale of the leader."""
        if heartbeat.scale_id != self._scale_id:
            self._scale_id = heartbeat.scale_id
            self._offsets.clear()
        self._origin_host_ns = heartbeat.origin_host_ns if heartbeat.kernel_id == self._kernel_id else None

    def take_message(self, fleet_ns: int, received_ns: int) -> None:
        """Take a message that was published at `fleet_ns`, and received at an instant of this host."""
        if self._origin_host_ns is None:
            self._offsets.append(received_ns - fleet_ns)

    def host_ns(self, fleet_ns: int) -> int | None:
        """The instant of this host at which fleet time was or will be `fleet_ns`; None: not known yet."""
        if self._origin_host_ns is not None:
            return fleet_ns + self._origin_host_ns
        return fleet_ns + min(self._offsets) if self._offsets else None
