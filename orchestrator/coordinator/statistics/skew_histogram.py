"""Quantiles of many values in fixed memory."""

from math import ceil, exp, floor, log

RESOLUTION = 0.02  # relative width of a bin: a quantile is at most this much too large
_WIDTH = log(1 + RESOLUTION)
LEAST_NS = 1_000  # smaller values count as this


def find_bin(skew_ns: int) -> int:
    """The number of the bin of a skew, ns."""
    return floor(log(max(skew_ns, LEAST_NS)) / _WIDTH)


class SkewHistogram:
    """Skews in bins whose width grows with the value: some 700 bins from 1 µs to 1 s."""

    def __init__(self) -> None:
        self.count = 0
        self.worst_ns = 0
        self._bins: dict[int, int] = {}

    def add_skew(self, skew_ns: int) -> None:
        """Count a skew, ns."""
        self.worst_ns = max(self.worst_ns, skew_ns)
        self.add_bin(find_bin(skew_ns), 1)

    def add_bin(self, number: int, count: int) -> None:
        """Count skews by the number of their bin; the worst one is not known by that."""
        self.count += count
        self._bins[number] = self._bins.get(number, 0) + count

    def find_quantile(self, part: float) -> int | None:
        """The skew that `part` (0 to 1) of all do not exceed, ns; None without any."""
        count_below = 0
        for number in sorted(self._bins):
            count_below += self._bins[number]
            if count_below >= ceil(part * self.count):
                return min(self.worst_ns, round(exp((number + 1) * _WIDTH)))
        return None
