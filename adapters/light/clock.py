"""The mapping of a light controller's ticks to host time, in closed form: its crystal has a constant rate.

A sample states that the counter became `ticks` in (sent - tick, received]. The rate comes from two samples far apart;
what it may be off is the sum of both intervals over the time between them, and an allowance for the host's own crystal
(`PREDICTION_WANDER_PPM`). This costs a thousandth of `TickEstimator`, which crystals that wander need.
"""

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import MAX_PPM, PREDICTION_WANDER_PPM, TickMapping

TICK_NS = 1000.0
LEAST_BASE_NS = NS_PER_S // 2
LONGEST_BASE_NS = 30 * NS_PER_S

_Sample = tuple[int, int, int]
"""Host instants before and after the reading, ticks."""


class LightClock:
    """The estimate of one controller's clock, since it was connected."""

    def __init__(self) -> None:
        self._first: _Sample | None = None
        self._middle: _Sample | None = None
        self._last: _Sample | None = None
        self._mapping: TickMapping | None = None
        self._count = 0

    def add_sample(self, sent_ns: int, received_ns: int, ticks: int) -> None:
        """Add a reading of the counter."""
        sample = self._last = (sent_ns, received_ns, ticks)
        self._count += 1
        self._mapping = None
        if self._first is None or self._middle is None:
            self._first = self._middle = sample
        elif sent_ns - self._middle[0] > LONGEST_BASE_NS:
            self._first, self._middle = self._middle, sample

    def find_mapping(self) -> TickMapping | None:
        """Return the mapping, as seen from the last reading; None without any."""
        if self._mapping is None and self._last is not None and self._first is not None:
            self._mapping = self._make_mapping(self._first, self._last)
        return self._mapping

    def _make_mapping(self, first: _Sample, last: _Sample) -> TickMapping:
        sent_ns, received_ns, ticks = last
        width_ns = received_ns - sent_ns + TICK_NS
        base_ns, rate, drift_ppm = sent_ns - first[0], 0.0, MAX_PPM
        if base_ns >= LEAST_BASE_NS:
            elapsed_ns = (sent_ns + received_ns - first[0] - first[1]) / 2
            rate = elapsed_ns / ((ticks - first[2]) * TICK_NS) - 1.0
            drift_ppm = min(MAX_PPM, (width_ns + first[1] - first[0] + TICK_NS) / 2 / base_ns * 1e6)
        return TickMapping(
            ticks_at=ticks,
            host_at_ns=round((sent_ns - TICK_NS + received_ns) / 2),
            tick_ns=TICK_NS * (1.0 + rate),
            rate_ppm=rate * 1e6,
            residual_ns=0,
            bound_ns=round(width_ns / 2) + 1,
            drift_ppm=drift_ppm + PREDICTION_WANDER_PPM,
            samples=self._count,
            min_rtt_ns=received_ns - sent_ns,
        )
