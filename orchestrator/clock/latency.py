"""The latency between a start command and the start, learned from earlier starts.

Each start gives an interval. It was not later than the instant at which the acknowledgement can have begun to be
sent, nor than the end minus the duration; it was not earlier than the last instant known to be before the end, minus
the duration. Past starts do not bind a firmware: the guarantee stays the declared one, and starts outside it only
widen it. But they show where between its bounds a controller usually starts, and the start command is written so
that T0 falls in the middle of that.

One start in `MAX_STARTS` may lie anywhere: otherwise, after a firmware hung once for 0.2 s, every job with a tighter
start tolerance would be refused, and no start could show that the controller has recovered. That one start is
reported where it happened (its evidence lies outside its guarantee). From the second one on the deviation counts as
the controller's normal behaviour and is part of the guarantee, until it is older than `MAX_STARTS` starts.
"""

from collections import deque
from dataclasses import dataclass

MAX_STARTS = 128
_MIN_STARTS = 8


@dataclass(frozen=True, slots=True)
class StartLatency:
    """Time from the end of the start command to the start, ns.

    usual_ns: the advance with which the command is written.
    earliest_ns, latest_ns: guaranteed bounds.
    starts: number of starts that it was learned from."""

    usual_ns: int
    earliest_ns: int
    latest_ns: int
    starts: int = 0


class LatencyEstimator:
    """Learns from starts. declared: the guarantee before any start."""

    def __init__(self, declared: StartLatency) -> None:
        self._declared = declared
        self._starts: deque[tuple[int, int]] = deque(maxlen=MAX_STARTS)
        self._answered: deque[int] = deque(maxlen=MAX_STARTS)
        self.latency = declared

    def discard_starts(self) -> None:
        """Discard all starts."""
        self._starts.clear()
        self._answered.clear()
        self.latency = self._declared

    def add_start(self, earliest_ns: int, latest_ns: int, answered_ns: int | None) -> None:
        """Add a start that was made in this interval after the end of its command.

        answered_ns: latest time at which the acknowledgement of the start can have begun to be sent; None for a
        controller that sends none."""
        self._starts.append((earliest_ns, latest_ns))
        if answered_ns is not None:
            self._answered.append(answered_ns)
        # The second of the starts that were certainly early, and of those that were certainly late.
        early = sorted(each[1] for each in self._starts)[1:2]
        late = sorted(each[0] for each in self._starts)[-2:-1]
        self.latency = StartLatency(
            usual_ns=self._estimate_usual_ns(),
            earliest_ns=min([self._declared.earliest_ns, *early]),
            latest_ns=max([self._declared.latest_ns, *late]),
            starts=len(self._starts),
        )

    def _estimate_usual_ns(self) -> int:
        """The mean of the acknowledgements, if they differ by no more than the starts themselves may: then no
        receiver delays them. Otherwise the declared value, unless every start was later, or earlier.

        `tutti bench rates`: without delays, this is 0.1 ms from the middle of a controller's latencies. With delays,
        and where the acknowledgement is that of another query after the command, the declared value is nearer than
        anything that acknowledgements and ends can show, by milliseconds.
        """
        declared, answered = self._declared, self._answered
        if len(answered) >= _MIN_STARTS and max(answered) - min(answered) <= declared.latest_ns - declared.earliest_ns:
            return min(max(sum(answered) // len(answered), declared.earliest_ns), declared.latest_ns)
        if len(self._starts) < _MIN_STARTS:
            return declared.usual_ns
        first, last = min(each[0] for each in self._starts), max(each[1] for each in self._starts)
        return sorted((first, declared.usual_ns, last))[1]
