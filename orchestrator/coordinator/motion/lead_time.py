"""Estimation of lead times: how long a fleet really takes to arm, promise and release, compared with what its
members declare.

A declared arming time also holds on a slow network. A fleet that has run some steps is known better, and its jobs
need not start as late as in the worst case; or they have to start later, where an adapter host has more to do at a
time than its members assume. A member that is late nevertheless costs a second arming with the declared lead time,
and its duration counts from then on.
"""

from collections import deque
from collections.abc import Callable, Iterable, Mapping
from typing import Literal, get_args

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.operation.learned import FLEET

KNOWN_AFTER = 16  # number of steps after which measured durations count
KEPT_STEPS = 64  # newest steps that are kept; on average one in this many is slower than all of them, and armed again
ARM_FACTOR = 1.1  # factor on the slowest arming and the slowest release: the two rarely coincide
GO_FACTOR = 1.25  # the same after the decision, where arming again begins only when all are unloaded
# Factor on the duration of the promises just made: `go` is one more exchange, but a short disturbance of the machine is
# usually over by then.
SLOW_GO_FACTOR = 1.5
LATE_LOADING_FACTOR = 1.25
MARGIN_NS = 150 * NS_PER_MS  # for promise, decision and release, until their durations are known
MARGIN_PER_MEMBER_NS = 20 * NS_PER_MS  # minimum for each member: one adapter host may have all of them
ACTING_NS = 60 * NS_PER_MS  # for the outputs between two steps, until their durations are known
DECIDING_NS = 20 * NS_PER_MS  # for a decision in the journal, until that is known
# a lower bound, because later steps may take longer than those measured; a late member is armed again
MIN_MARGIN_NS = 10 * NS_PER_MS


ArmKind = Literal["rest", "beside", "behind"]
"""How a step is armed: at rest; beside the present move, while that runs; behind it, as soon as it has ended."""


class _DurationHistory:
    """The durations of the newest repetitions of one activity."""

    def __init__(self, longest: float | None = None) -> None:
        self._kept: deque[float] = deque(maxlen=KEPT_STEPS)
        if longest is not None:
            self.fill(longest)

    def fill(self, longest: float) -> None:
        """Count a duration as if it had been measured until it is known."""
        self._kept.extend([longest] * KNOWN_AFTER)

    def clear(self) -> None:
        """Forget all."""
        self._kept.clear()

    @property
    def is_known(self) -> bool:
        return len(self._kept) >= KNOWN_AFTER

    def add_duration(self, took: float) -> None:
        self._kept.append(took)

    @property
    def longest(self) -> float:
        return max(self._kept, default=0.0)

    def allowed_time(self, declared: float, *, use_known: bool = True, factor: float = ARM_FACTOR) -> float:
        """The time to allow for the next repetition: the declared time until durations are known, or if `use_known`
        is false, and at least the slowest one."""
        return factor * self.longest if use_known and self.is_known else max(declared, self.longest)


class LeadTimeEstimator:
    """Measured durations of this fleet's steps under the present leader.

    last_leads_ns: the lead time of the last step of the same members.
    """

    def __init__(self, find_least_go_ns: Callable[[], int] = lambda: 0) -> None:
        """find_least_go_ns: returns the least time to allow for decision and release."""
        self._find_least_go_ns = find_least_go_ns
        self._shares: dict[tuple[ArmKind, str], _DurationHistory] = {}
        self._releases_ns = _DurationHistory()
        self._goes_ns = _DurationHistory()
        self._following_ns = _DurationHistory()
        self._acts_ns = _DurationHistory()
        self._decisions_ns = _DurationHistory()
        self._activities = {
            "release": self._releases_ns,
            "go": self._goes_ns,
            "following": self._following_ns,
            "act": self._acts_ns,
            "decision": self._decisions_ns,
        }
        self.last_leads_ns: dict[frozenset[str], int] = {}

    @property
    def acting_ns(self) -> int:
        """The time to allow for switching outputs between two steps."""
        return round(self._acts_ns.allowed_time(ACTING_NS))

    @property
    def deciding_ns(self) -> int:
        """The time to allow for writing a decision."""
        return round(self._decisions_ns.allowed_time(DECIDING_NS))

    def record_deciding(self, took_ns: int) -> None:
        """Record how long writing a decision took."""
        self._decisions_ns.add_duration(took_ns)

    def record_acting(self, took_ns: int) -> None:
        """Record how long switching outputs between two steps took, without the dwell there."""
        self._acts_ns.add_duration(took_ns)

    def record_arming(self, kind: ArmKind, declared_ns: Mapping[str, int], took_ns: Mapping[str, int]) -> None:
        """Record an arming. declared_ns: by member; took_ns: from the request to its answer; behind a step, from that
        one's planned end until it was loaded."""
        for member, took in took_ns.items():
            if declared_ns[member] > 0:
                history = self._shares.setdefault((kind, member), _DurationHistory())
                history.add_duration(took / declared_ns[member])

    def record_late_loading(self, members: Iterable[str]) -> None:
        """Record that members have not loaded a step behind another one in time: they get more of it."""
        for member in members:
            history = self._shares.setdefault(("behind", member), _DurationHistory())
            history.add_duration(LATE_LOADING_FACTOR * self.arming_share(member, "behind"))

    def knows_loading(self, members: Iterable[str]) -> bool:
        """Whether the time that each member needs to load a step behind the one before, from its planned end, is known
        from earlier steps."""
        histories = [self._shares.get(("behind", member)) for member in members]
        return all(history is not None and history.is_known for history in histories)

    def record_release(self, took_ns: int, go_ns: int) -> None:
        """Record a release. took_ns: from armed to the last answer to `go`; go_ns: from the last promise."""
        self._releases_ns.add_duration(took_ns)
        self._goes_ns.add_duration(go_ns)

    def record_following(self, go_ns: int) -> None:
        """Record a release behind a step. go_ns: from the last promise to the last answer to `go`."""
        self._following_ns.add_duration(go_ns)

    @property
    def promise_ns(self) -> int:
        """How long promises take at most, as far as it is known; 0 until then."""
        is_known = self._releases_ns.is_known and self._goes_ns.is_known
        return max(0, round(self._releases_ns.longest - self._goes_ns.longest)) if is_known else 0

    def record_late_promise(self, promise_ns: int, members: int) -> None:
        """Record that promises took so long that no time was left for `go`. A member that takes far longer than
        others was suspended, which says nothing about the next step."""
        self._releases_ns.add_duration(min(promise_ns + self._goes_ns.longest, 2 * self.margin_ns(members)))

    def record_late_go(self, members: int) -> None:
        """Record that a member was late to `go`: the next one gets more time."""
        before_ns, given_ns = self._goes_ns.longest, self.go_ns(members)
        self._goes_ns.add_duration(given_ns if self._goes_ns.is_known else GO_FACTOR * given_ns)
        self._releases_ns.add_duration(self._releases_ns.longest + self._goes_ns.longest - before_ns)

    # What outlives the coordinator

    def list_shares(self, controller: str) -> dict[str, float]:
        """The arming shares of a controller that are known, by kind: the largest of late."""
        histories = {kind: self._shares.get((kind, controller)) for kind in get_args(ArmKind)}
        return {
            kind: history.longest for kind, history in histories.items() if history is not None and history.is_known
        }

    def list_durations(self) -> dict[str, float]:
        """The durations of the fleet that are known, ns, by activity: the longest of late."""
        return {name: history.longest for name, history in self._activities.items() if history.is_known}

    def take_learned(self, controller: str, shares: Mapping[str, float], durations_ns: Mapping[str, float]) -> None:
        """Use what an earlier coordinator has learned, as if each had been measured `KNOWN_AFTER` times."""
        for kind in get_args(ArmKind):
            if kind in shares:
                self._shares[kind, controller] = _DurationHistory(shares[kind])
        for name, history in self._activities.items():
            if name in durations_ns:
                history.fill(durations_ns[name])

    def forget_learned(self, controller: str) -> None:
        """Forget the shares of a controller; of `FLEET`, the durations of the fleet."""
        for kind in get_args(ArmKind):
            self._shares.pop((kind, controller), None)
        if controller == FLEET:
            for history in self._activities.values():
                history.clear()

    def arming_share(self, member: str, kind: ArmKind = "rest", *, use_known: bool = True) -> float:
        """The fraction of its declared arming time that a member needs; at least 1 until it has been armed
        `KNOWN_AFTER` times, or if `use_known` is false."""
        declared_share = self.arming_share(member) if kind == "behind" else 1.0
        history = self._shares.get((kind, member))
        return declared_share if history is None else history.allowed_time(declared_share, use_known=use_known)

    def go_ns(self, members: int, promise_ns: int = 0, *, follows: bool = False) -> int:
        """The time to allow for decision and release. members: their number. promise_ns: how long their promises
        have just taken; a machine that was slow a moment ago probably still is. follows: behind a step."""
        known_history = self._following_ns if follows and self._following_ns.is_known else self._goes_ns
        declared_ns = _default_margin_ns(members) / 2
        known_ns = known_history.allowed_time(declared_ns, factor=GO_FACTOR)
        return round(max(known_ns, SLOW_GO_FACTOR * promise_ns, self._find_least_go_ns()))

    def margin_ns(self, members: int, *, use_known: bool = True) -> int:
        """The time to allow for promise, decision and release. members: their number."""
        if not use_known or not self._goes_ns.is_known:
            half_ns = _default_margin_ns(members) / 2
            declared_ns = half_ns + max(half_ns, self.go_ns(members))
            return round(self._releases_ns.allowed_time(declared_ns, use_known=use_known))
        go_ns, releases_ns = self.go_ns(members), self._releases_ns.allowed_time(0)
        # Before the decision, at least as much as the first must be left for `go`.
        return max(MIN_MARGIN_NS, round(releases_ns + (1 - 1 / GO_FACTOR) * go_ns), self.promise_ns + go_ns)


def _default_margin_ns(members: int) -> int:
    return max(MARGIN_NS, members * MARGIN_PER_MEMBER_NS)
