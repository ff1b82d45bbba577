"""The router that all sessions of the in-memory bus go through, when it fails."""

from orchestrator.bus.memory.bus import LEASE_NS, RECONNECT_NS, MemoryNet


class MemoryRouter:
    """The router of a net. One fault of it at a time."""

    def __init__(self, net: MemoryNet) -> None:
        self._net = net

    def hang(self) -> None:
        """Hang as at SIGSTOP: nothing passes between any two processes, new ones included; they count each other as
        gone after the lease."""
        self._net.network.router_hangs = True
        self._net.schedule_call(self._net.clock.now_ns() + LEASE_NS, self._lose_sessions)

    def restart(self) -> None:
        """Kill it, and start it again: what was sent meanwhile is lost, and all processes lose each other until they
        have reconnected."""
        self._set_lost(lost=True)
        self._net.schedule_call(self._net.clock.now_ns() + RECONNECT_NS, self._take_sessions)

    def _lose_sessions(self) -> None:
        if self._net.network.router_hangs:
            self._set_lost(lost=True)

    def _take_sessions(self) -> None:
        self._net.network.router_hangs = False
        self._set_lost(lost=False)

    def _set_lost(self, *, lost: bool) -> None:
        self._net.network.router_lost = lost
        self._net.presence.refresh_watches()
