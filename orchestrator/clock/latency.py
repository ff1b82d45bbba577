"""The latency between a start command and the start, learned from earlier starts.

Each start gives an interval. It was not later than the instant at which the acknowledgement can have begun to be
sent, nor than the end minus the duration; it was not earlier than the last instant known to be before the end, minus
the duration. Past starts do not bind a firmware: the guarantee stays the declared one, and starts outside it only
widen it. But they show where between its bounds a controller usually starts, and the start command is written so
that T0 falls in the middle of that.

One start in `MAX_STARTS` may lie anywhere: otherwise, after a firmware hung once for 0.2 s, every job with a tighter
start tolerance would be refused. That one start is reported where it happened (its evidence lies outside its
guarantee). From the second one on the deviation counts as the controller's normal behaviour and is part of the
guarantee; but refused jobs make no starts that could show the contrary, so it shrinks with time, to nothing after
`FORGET_NS`. A start whose command the host has written late shows nothing about the controller, and is not learned.
"""

from collections import deque
from dataclasses import dataclass
from math import ceil

from orchestrator.clock.base import NS_PER_S

MAX_STARTS = 128
FORGET_NS = 300 * NS_PER_S
_MIN_STARTS = 8


@dataclass(frozen=True, slots=True)
class UnusualStart:
    """A start outside the declared bounds. outside_ns: by how much it was certainly late; negative: early. at_ns: when
    it was learned, host time."""

    outside_ns: int
    at_ns: int

    def remaining_ns(self, now_ns: int) -> float:
        """Return what is left of `outside_ns`, without its sign."""
        return abs(self.outside_ns) * max(0.0, 1 - max(0, now_ns - self.at_ns) / FORGET_NS)


@dataclass(frozen=True, slots=True)
class StartLatency:
    """Time from the end of the start command to the start, ns.

    usual_ns: the advance with which the command is written.
    earliest_ns, latest_ns: guaranteed bounds.
    starts: number of starts that it was learned from.
    learned_early_ns, learned_late_ns: how much of the bounds was learned, and is forgotten again.
    unusual: the starts that it was learned from."""

    usual_ns: int
    earliest_ns: int
    latest_ns: int
    starts: int = 0
    learned_early_ns: int = 0
    learned_late_ns: int = 0
    unusual: tuple[UnusualStart, ...] = ()


class LatencyEstimator:
    """Learns from starts. declared: the guarantee before any start."""

    def __init__(self, declared: StartLatency) -> None:
        self._declared = declared
        self._starts: deque[tuple[int, int, int]] = deque(maxlen=MAX_STARTS)
        self._answered: deque[int] = deque(maxlen=MAX_STARTS)

    def discard_starts(self) -> None:
        """Discard all starts."""
        self._starts.clear()
        self._answered.clear()

    def add_start(self, earliest_ns: int, latest_ns: int, answered_ns: int | None, now_ns: int) -> None:
        """Add a start that was made in this interval after the end of its command.

        answered_ns: latest time at which the acknowledgement of the start can have begun to be sent; None for a
        controller that sends none. now_ns: host time."""
        self._starts.append((earliest_ns, latest_ns, now_ns))
        if answered_ns is not None:
            self._answered.append(answered_ns)

    def latency_at(self, now_ns: int) -> StartLatency:
        """Return what is guaranteed at the host instant `now_ns`."""
        declared_latency = self._declared
        late = [UnusualStart(start[0] - declared_latency.latest_ns, start[2]) for start in self._starts]
        early = [UnusualStart(start[1] - declared_latency.earliest_ns, start[2]) for start in self._starts]
        late = [start for start in late if start.outside_ns > 0 and start.remaining_ns(now_ns)]
        early = [start for start in early if start.outside_ns < 0 and start.remaining_ns(now_ns)]
        learned_early_ns, learned_late_ns = _second_largest_ns(early, now_ns), _second_largest_ns(late, now_ns)
        return StartLatency(
            usual_ns=self._estimate_usual_ns(),
            earliest_ns=declared_latency.earliest_ns - learned_early_ns,
            latest_ns=declared_latency.latest_ns + learned_late_ns,
            starts=len(self._starts),
            learned_early_ns=learned_early_ns,
            learned_late_ns=learned_late_ns,
            unusual=(*early, *late),
        )

    def _estimate_usual_ns(self) -> int:
        """The mean of the acknowledgements, if they differ by no more than the starts themselves may: then no
        receiver delays them. Otherwise the declared value, unless every start was later, or earlier.

        `python -m benches rates`: without delays, this is 0.1 ms from the middle of a controller's latencies. With
        delays, and where the acknowledgement is that of another query after the command, the declared value is nearer
        than anything that acknowledgements and ends can show, by milliseconds.
        """
        declared_latency, answers = self._declared, self._answered
        if (
            len(answers) >= _MIN_STARTS
            and max(answers) - min(answers) <= declared_latency.latest_ns - declared_latency.earliest_ns
        ):
            return min(max(sum(answers) // len(answers), declared_latency.earliest_ns), declared_latency.latest_ns)
        if len(self._starts) < _MIN_STARTS:
            return declared_latency.usual_ns
        first, last = min(start[0] for start in self._starts), max(start[1] for start in self._starts)
        return sorted((first, declared_latency.usual_ns, last))[1]


def _second_largest_ns(found: list[UnusualStart], now_ns: int) -> int:
    """Return what the second of the unusual starts on one side leaves: one alone may lie anywhere."""
    times_left = sorted((start.remaining_ns(now_ns) for start in found), reverse=True)
    return ceil(times_left[1]) if len(times_left) > 1 else 0
