"""Signs of life of commands that a person waits for: what such a command moves stops when they are missing."""

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_S, Clock

REMEMBERED_NS = 60 * NS_PER_S


class SessionSigns:
    """When each session was last seen by this adapter host."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._seen_ns: dict[str, int] = {}
        self._cleared_ns = 0

    def receive_sign(self, sample: BusSample) -> None:
        """Note a sign of life. The sessions of long ago are forgotten."""
        now_ns = self._clock.now_ns()
        if now_ns - self._cleared_ns > REMEMBERED_NS:
            self._cleared_ns = now_ns
            self._seen_ns = {each: at_ns for each, at_ns in self._seen_ns.items() if now_ns - at_ns < REMEMBERED_NS}
        self._seen_ns[sample.key.rpartition("/")[2]] = now_ns

    def seen_ns(self, session: str) -> int:
        """When the session was last seen, host time; 0 if it was not seen yet."""
        return self._seen_ns.get(session, 0)
