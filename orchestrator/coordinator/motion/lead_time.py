"""How quickly a fleet really arms, promises and goes, beside what its members declare.

What a member declares of its arming holds on a slow network too. A fleet that has done the same some times before is
known better, and its jobs need not begin as late as the worst case would have them; or they have to begin later, where
an adapter host has more to do at a time than each of its members thinks. Whoever is late after all costs a second
arming, with the lead that was declared, and what it took counts from then on.
"""

from collections import deque
from collections.abc import Mapping

from orchestrator.clock.base import NS_PER_MS

KNOWN = 16  # steps from which on what was seen counts
KEPT = 64  # of the newest steps: of the next ones, one in so many is slower than all of these, and armed again
ROOM = 1.1  # over the slowest arming and the slowest release: the two seldom come together
GO_ROOM = 1.25  # the same behind the decision, where arming again begins only when all are unloaded
# Times what promises have just taken: go is an exchange more, but what holds a machine up once mostly lets go soon.
SLOW_GO = 1.5
MARGIN_NS = 150 * NS_PER_MS  # for promise, decision and release, until it is known how long they take
EACH_NS = 20 * NS_PER_MS  # and at least so much for each member: one adapter host may have all of them
LEAST_MARGIN_NS = 10 * NS_PER_MS  # more than those that were seen may take as long; who is late is armed again


class _Seen:
    """How long the newest of something have taken."""

    def __init__(self) -> None:
        self._kept: deque[float] = deque(maxlen=KEPT)

    @property
    def known(self) -> bool:
        return len(self._kept) >= KNOWN

    def add(self, took: float) -> None:
        self._kept.append(took)

    @property
    def slowest(self) -> float:
        return max(self._kept, default=0.0)

    def allow(self, declared: float, known: bool = True, room: float = ROOM) -> float:
        """What the next one is given. Until they are known, or if that is not to count: what is declared, or the
        slowest."""
        return room * self.slowest if known and self.known else max(declared, self.slowest)


class Pace:
    """What was seen of this fleet's steps since its coordinator reigns."""

    def __init__(self) -> None:
        self._shares: dict[str, _Seen] = {}
        self._releases_ns = _Seen()
        self._goes_ns = _Seen()

    def armed(self, declared_ns: Mapping[str, int], took_ns: Mapping[str, int]) -> None:
        """Members have been armed: what each has declared, and from the order to its answer."""
        for member, took in took_ns.items():
            if declared_ns[member] > 0:
                self._shares.setdefault(member, _Seen()).add(took / declared_ns[member])

    def released(self, took_ns: int, go_ns: int) -> None:
        """To the last answer to `go`: from armed, and from the last promise."""
        self._releases_ns.add(took_ns)
        self._goes_ns.add(go_ns)

    def late(self, promise_ns: int, members: int) -> None:
        """Promises of so many members have taken so long that there was no time left for go. Who takes far longer than
        others was stopped, and says nothing of the next time."""
        self._releases_ns.add(min(promise_ns + self._goes_ns.slowest, 2 * self.margin_ns(members)))

    def late_to_go(self, members: int) -> None:
        """Somebody has not gone in the time that is given for it: the next is given more."""
        before_ns, given_ns = self._goes_ns.slowest, self.go_ns(members)
        self._goes_ns.add(given_ns if self._goes_ns.known else GO_ROOM * given_ns)
        self._releases_ns.add(self._releases_ns.slowest + self._goes_ns.slowest - before_ns)

    def share(self, member: str, known: bool = True) -> float:
        """The part of its declared arming that a member needs; at least 1 until it has been armed `KNOWN` times, or if
        what is `known` is not to count."""
        seen = self._shares.get(member)
        return 1.0 if seen is None else seen.allow(1.0, known)

    def go_ns(self, members: int, promise_ns: int = 0) -> int:
        """What decision and release alone are given, of so many members. promise_ns: how long their promises have taken
        just now: a machine that was slow a moment ago still is."""
        return round(max(self._goes_ns.allow(_unknown_ns(members) / 2, room=GO_ROOM), SLOW_GO * promise_ns))

    def margin_ns(self, members: int, known: bool = True) -> int:
        """What promise, decision and release are given, of so many members."""
        if not known or not self._goes_ns.known:
            half_ns = _unknown_ns(members) / 2
            declared_ns = half_ns + max(half_ns, self.go_ns(members))
            return round(self._releases_ns.allow(declared_ns, known))
        # Before the decision there has to be that much left for go.
        return max(LEAST_MARGIN_NS, round(self._releases_ns.allow(0) + (1 - 1 / GO_ROOM) * self.go_ns(members)))


def _unknown_ns(members: int) -> int:
    return max(MARGIN_NS, members * EACH_NS)
