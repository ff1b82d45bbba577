"""Signs of life of commands that a person waits for, in the processes that stop what such a command has begun."""

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.model.queue import SESSION_TIMEOUT_NS

REMEMBERED_NS = 60 * NS_PER_S


class SessionSigns:
    """When each session was last seen by this process."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock
        self._seen_ns: dict[str, int] = {}
        self._cleared_ns = 0

    def receive_sign(self, sample: BusSample) -> None:
        """Note a sign of life. The sessions of long ago are forgotten."""
        now_ns = self._clock.now_ns()
        if now_ns - self._cleared_ns > REMEMBERED_NS:
            self._cleared_ns = now_ns
            self._seen_ns = {name: at_ns for name, at_ns in self._seen_ns.items() if now_ns - at_ns < REMEMBERED_NS}
        self._seen_ns[sample.key.rpartition("/")[2]] = now_ns

    def present_until_ns(self, session: str, since_ns: int) -> int:
        """Until when the session counts as present without another sign, host time. since_ns: since when it has been
        waited for; it has as long for its first sign."""
        return max(since_ns, self._seen_ns.get(session, 0)) + SESSION_TIMEOUT_NS
