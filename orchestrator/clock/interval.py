"""Instants that are known as intervals, and the durations between them."""

from typing import Protocol

DURATION_TOLERANCE_S = 0.02  # beyond the intervals and the clock error, as at the prediction of ends
_NS_PER_S = 1_000_000_000


class Interval(Protocol):
    """An instant that is known only as an interval, in ns."""

    @property
    def earliest_ns(self) -> int: ...

    @property
    def latest_ns(self) -> int: ...


def find_other_duration(start: Interval, end: Interval, promised_s: float, clock_ppm: float) -> float | None:
    """Return how long it took from `start` to `end`, in s, if that was certainly not `promised_s`; None otherwise.

    clock_ppm: by which the controller's own crystal may stretch or shorten it. An end that contradicts itself, earliest
    after latest, is another duration, too.
    """
    shortest_s = (end.earliest_ns - start.latest_ns) / _NS_PER_S
    longest_s = (end.latest_ns - start.earliest_ns) / _NS_PER_S
    margin_s = DURATION_TOLERANCE_S + promised_s * clock_ppm * 1e-6
    if end.earliest_ns <= end.latest_ns and shortest_s - margin_s <= promised_s <= longest_s + margin_s:
        return None
    return (shortest_s + longest_s) / 2
