"""The watchdog on coordinators: each controller follows the heartbeat of the one that has adopted it, and no other."""

from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.model.messages import HEARTBEAT_NS, LeaderHeartbeat

# A coordinator that is silent for this long (five of its heartbeats) is lost. Then armed steps are unloaded, and moving
# axes are stopped by their own ramps.
COORDINATOR_LOST_NS = 500 * NS_PER_MS
SPARE_BEATS = 2  # by which a sequence may be ahead of its pace: a busy bus delivers late, and then several at once

Adopter = tuple[int, str]
"""Epoch and id of a coordinator."""


@dataclass(slots=True)
class _FollowedLeader:
    """The heartbeat of one coordinator. seq, seen_ns: of the last one that counted. lost: reported as lost."""

    seq: int
    seen_ns: int
    lost: bool = False


@dataclass(slots=True)
class LeaderWatch:
    """Which coordinator has adopted which controller of this host, and when each was last received."""

    clock: Clock
    _adopters: dict[str, Adopter] = field(default_factory=dict[str, Adopter])
    _leaders: dict[Adopter, _FollowedLeader] = field(default_factory=dict[Adopter, _FollowedLeader])

    @property
    def epoch(self) -> int | None:
        """The newest epoch in which a controller of this host was adopted; None before the first adoption."""
        return max((epoch for epoch, _ in self._adopters.values()), default=None)

    def follow(self, controller: str, leader: LeaderHeartbeat) -> None:
        """From now on `controller` follows the coordinator that has adopted it: silence counts from here."""
        adopter = (leader.epoch, leader.coordinator)
        self._adopters[controller] = adopter
        followed_leader = self._leaders.setdefault(adopter, _FollowedLeader(leader.seq, self.clock.now_ns()))
        followed_leader.seen_ns, followed_leader.lost = self.clock.now_ns(), False
        for former in self._leaders.keys() - set(self._adopters.values()):
            del self._leaders[former]

    def receive_heartbeat(self, heartbeat: LeaderHeartbeat) -> bool:
        """Take a heartbeat; return whether it counts: it is an adopter's, and its sequence advances at the pace of
        heartbeats. A repeated one, or one that is far ahead, is not the adopter's sign of life."""
        followed_leader = self._leaders.get((heartbeat.epoch, heartbeat.coordinator))
        if followed_leader is None:
            return False
        now_ns = self.clock.now_ns()
        most = followed_leader.seq + SPARE_BEATS + 1 + (now_ns - followed_leader.seen_ns) // HEARTBEAT_NS
        if not followed_leader.seq < heartbeat.seq <= most:
            return False
        followed_leader.seq, followed_leader.seen_ns, followed_leader.lost = heartbeat.seq, now_ns, False
        return True

    def restart_pace(self, heartbeat: LeaderHeartbeat) -> None:
        """A clock has jumped: the pace of an adopter counts from this heartbeat, which is its own answer."""
        followed_leader = self._leaders.get((heartbeat.epoch, heartbeat.coordinator))
        if followed_leader is not None:
            followed_leader.seq, followed_leader.seen_ns, followed_leader.lost = (
                heartbeat.seq,
                self.clock.now_ns(),
                False,
            )

    def find_lost(self) -> dict[str, int]:
        """Controllers whose adopter has become silent since the last call, with the time of its silence, ns."""
        now_ns = self.clock.now_ns()
        silent = {
            adopter: now_ns - followed_leader.seen_ns
            for adopter, followed_leader in self._leaders.items()
            if not followed_leader.lost and now_ns - followed_leader.seen_ns > COORDINATOR_LOST_NS
        }
        for adopter in silent:
            self._leaders[adopter].lost = True
        return {name: silent[adopter] for name, adopter in self._adopters.items() if adopter in silent}
