"""How quickly a fleet really arms, promises and goes, beside what its members declare.

What a member declares of its arming holds on a slow network too. A fleet that has done the same some times before is
known better, and its jobs need not begin as late as the worst case would have them. Whoever is late after all costs a
second arming with the lead that was declared, and from then on its declarations count again.
"""

from collections import deque
from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS

KEPT = 16  # of the newest steps
ROOM = 1.25  # over the slowest of them: were they lognormal, of 20 % spread, one step in 500 would be armed twice
MARGIN_NS = 150 * NS_PER_MS  # for promise, decision and release, until it is known how long they take
LEAST_MARGIN_NS = 10 * NS_PER_MS  # more than those that were seen may take as long; who is late is armed again


class Pace:
    """What was seen of this fleet's steps since its coordinator reigns."""

    def __init__(self) -> None:
        self._shares: dict[str, deque[float]] = {}
        self._releases_ns: deque[int] = deque(maxlen=KEPT)
        self._goes_ns: deque[int] = deque(maxlen=KEPT)

    def armed(self, declared_ns: Mapping[str, int], took_ns: Mapping[str, int]) -> None:
        """Members have been armed, each in so long."""
        for member, took in took_ns.items():
            if declared_ns[member] > 0:
                self._shares.setdefault(member, deque(maxlen=KEPT)).append(took / declared_ns[member])

    def released(self, took_ns: int, go_ns: int) -> None:
        """To the last answer to `go`: from armed, and from the last promise."""
        self._releases_ns.append(took_ns)
        self._goes_ns.append(go_ns)

    def late(self, members: Mapping[str, object]) -> None:
        """Somebody was late: what is known of these members counts no more."""
        for member in members:
            self._shares.pop(member, None)
        self._releases_ns.clear()
        self._goes_ns.clear()

    def share(self, member: str) -> float:
        """The part of its declared arming that a member needs; 1 until it has been armed `KEPT` times."""
        shares = self._shares.get(member, ())
        return min(1.0, ROOM * max(shares)) if len(shares) == KEPT else 1.0

    @property
    def release_ns(self) -> int:
        """What promise, decision and release have needed at the most; half their time until it is known."""
        return max(self._releases_ns) if self._known else MARGIN_NS // 2

    @property
    def go_ns(self) -> int:
        """What decision and release alone are given."""
        return round(ROOM * max(self._goes_ns)) if self._known else MARGIN_NS // 2

    @property
    def margin_ns(self) -> int:
        """What promise, decision and release are given."""
        if not self._known:
            return MARGIN_NS
        return min(MARGIN_NS, max(LEAST_MARGIN_NS, round(ROOM * self.release_ns)))

    @property
    def _known(self) -> bool:
        return len(self._releases_ns) == KEPT
