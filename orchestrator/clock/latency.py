"""How long after its starting line a unit starts, from the starts that it has made.

Of each start an interval is known: not later than its acknowledgement can have begun to be sent, nor than its end less
its duration; not earlier than an end that had not come yet, less its duration. What a firmware has done does not bind
it: the promise stays what was declared, and is only widened, by starts that lie outside. But where between its bounds
a unit usually starts can be shown, and the starting line is written so that T0 is met in the middle of that.

One start in `KEPT` may lie anywhere: a firmware that hung once for 0.2 s would otherwise have every job refused whose
start may be less uncertain than that, and so make none of the starts that could show that it is well again. That
start is told where it was made (its evidence lies outside its promise). From the second one on it is the unit's way,
and promised, until it is older than `KEPT` starts.
"""

from collections import deque
from dataclasses import dataclass

KEPT = 128
_ENOUGH = 8


@dataclass(frozen=True, slots=True)
class Latency:
    """From the end of the starting line to the start, ns. usual_ns: what to write it ahead by. earliest_ns, latest_ns:
    guaranteed. starts: that it was learned from."""

    usual_ns: int
    earliest_ns: int
    latest_ns: int
    starts: int = 0


class LatencyEstimator:
    """Learns from starts. declared: what is guaranteed before any."""

    def __init__(self, declared: Latency) -> None:
        self._declared = declared
        self._starts: deque[tuple[int, int]] = deque(maxlen=KEPT)
        self._answered: deque[int] = deque(maxlen=KEPT)
        self.latency = declared

    def forget(self) -> None:
        """Start anew."""
        self._starts.clear()
        self._answered.clear()
        self.latency = self._declared

    def take(self, earliest_ns: int, latest_ns: int, answered_ns: int | None) -> None:
        """A start was made so long after the end of its line. answered_ns: when the acknowledgement that is sent with
        the start can have begun to be sent at the latest; None for a unit that has none."""
        self._starts.append((earliest_ns, latest_ns))
        if answered_ns is not None:
            self._answered.append(answered_ns)
        # The second of those that were surely early, and of those that were surely late.
        early = sorted(each[1] for each in self._starts)[1:2]
        late = sorted(each[0] for each in self._starts)[-2:-1]
        self.latency = Latency(
            usual_ns=self._usual_ns(),
            earliest_ns=min([self._declared.earliest_ns, *early]),
            latest_ns=max([self._declared.latest_ns, *late]),
            starts=len(self._starts),
        )

    def _usual_ns(self) -> int:
        """The mean of the acknowledgements, if they are as near to each other as the starts themselves may be: then no
        receiver holds them back. Else what is declared, unless every start was later, or earlier.

        `tutti bench rates`: so it is 0.1 ms from the middle of a unit's times where nothing is held back. Where it is,
        and where the acknowledgement is that of another question behind the line, what is declared is nearer than
        anything that acknowledgements and ends could say, by milliseconds.
        """
        declared, answered = self._declared, self._answered
        if len(answered) >= _ENOUGH and max(answered) - min(answered) <= declared.latest_ns - declared.earliest_ns:
            return min(max(sum(answered) // len(answered), declared.earliest_ns), declared.latest_ns)
        if len(self._starts) < _ENOUGH:
            return declared.usual_ns
        first, last = min(each[0] for each in self._starts), max(each[1] for each in self._starts)
        return sorted((first, declared.usual_ns, last))[1]
