"""The controller's sample counter (TIME) against the host's clock.

Every record carries the low 16 bits of the counter; together with the last full reading they give the whole counter as
long as records arrive at least twice in the 64 s in which those bits wrap around.
"""

from dataclasses import dataclass
from math import ceil

from adapters.contract import HostInterval
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import MAX_PPM, CounterSample, TickEstimator, TickMapping

SAMPLES_PER_S = 1024  # at TM 1000 (L10619-10622)
LONGEST_GAP_NS = 20 * NS_PER_S  # after a gap of this length, and at this interval, the whole counter is read
REFRESH_NS = NS_PER_S  # a mapping stays usable for far longer; its bound states its accuracy
# The estimator keeps a fixed number of readings: the longer they span, the better the rate is known. While it is young
# it therefore gets all readings, and later two of each second: those that bound the counter's time most from either
# side. They are seldom the fastest: where in its tick of a millisecond a reading is taken decides more than its round
# trip.
YOUNG_READINGS = 64


@dataclass(slots=True)
class _ChosenReadings:
    """Of one second: the reading that proves the latest instant before which the counter had not its value, and the one
    that proves the earliest at which it had it."""

    earliest: CounterSample
    latest: CounterSample


def _get_ticks(sample: CounterSample) -> int:
    return sample.ticks


class SampleClock:
    """Estimate the counter from readings and detect resets of it. late_ns: see `TickEstimator`."""

    def __init__(self, tick_ns: float, late_ns: int = 0) -> None:
        self.tick_ns = tick_ns
        self._estimator = TickEstimator(tick_ns, late_ns)
        self._last: CounterSample | None = None
        self._whole_ns = 0
        self._mapping: TickMapping | None = None
        self._mapped: CounterSample | None = None
        self._taken = 0
        self._second: _ChosenReadings | None = None

    def find_sampling_interval(self, sent_ns: int, received_ns: int) -> HostInterval:
        """Return when the positions in an answer were sampled: they are those of the last sample."""
        return HostInterval(sent_ns - ceil(self.tick_ns * (1 + MAX_PPM * 1e-6)), received_ns)

    def add_full_reading(self, sent_ns: int, received_ns: int, ticks: int) -> bool:
        """Add a reading of TIME. Return False when the counter did not continue from the last reading: the controller
        was restarted."""
        sample = CounterSample(sent_ns, received_ns, ticks)
        went_on = self._is_consistent(sample)
        if not went_on:
            self.discard_readings()
        self._whole_ns = received_ns
        self._add_sample(sample)
        return went_on

    def add_low_reading(self, sent_ns: int, received_ns: int, low: int) -> bool:
        """Add a reading of the low 16 bits. Return False when they need a whole reading now; then they are not used."""
        last = self._last
        if last is None or received_ns - self._whole_ns > LONGEST_GAP_NS:
            return False
        sample = CounterSample(sent_ns, received_ns, last.ticks + ((low - last.ticks) & 0xFFFF))
        if not self._is_consistent(sample):
            return False
        self._add_sample(sample)
        return True

    def discard_readings(self) -> None:
        """Discard all readings: the counter was reset."""
        self._estimator.discard_samples()
        self._last = None
        self._mapping = self._mapped = None
        self._taken = 0
        self._second = None

    def current_mapping(self) -> TickMapping | None:
        """Return the present estimate; it is computed again when it is a second old, or still young and improving."""
        last = self._last
        if last is None:
            return None
        mapped_sample = self._mapped
        if mapped_sample is not last and (
            mapped_sample is None or self._taken <= 16 or last.received_ns - mapped_sample.received_ns >= REFRESH_NS
        ):
            self._mapping, self._mapped = self._estimator.compute_mapping(), last
        return self._mapping

    def find_mapping_near(self, ticks: int) -> TickMapping | None:
        """Return the estimate from all readings for an instant that may be some seconds ago: its bound does not grow
        with them."""
        return self._estimator.compute_mapping(ticks)

    def _add_sample(self, sample: CounterSample) -> None:
        self._last = sample
        self._taken += 1
        if self._taken <= YOUNG_READINGS:
            self._estimator.add_sample(sample)
            return
        second = self._second
        if second is not None and sample.sent_ns // REFRESH_NS != second.latest.sent_ns // REFRESH_NS:
            for reading in sorted({second.earliest, second.latest}, key=_get_ticks):
                self._estimator.add_sample(reading)
            if sample.sent_ns - second.latest.sent_ns > 2 * REFRESH_NS:
                # After a pause the newest reading is more valuable than others.
                self._estimator.add_sample(sample)
            second = None
        if second is None:
            self._second = _ChosenReadings(sample, sample)
            return
        tick_ns = self.tick_ns if self._mapping is None else self._mapping.tick_ns
        since_ns = (sample.ticks - second.earliest.ticks) * tick_ns
        if sample.sent_ns - second.earliest.sent_ns > since_ns:
            second.earliest = sample
        since_ns = (sample.ticks - second.latest.ticks) * tick_ns
        if sample.received_ns - second.latest.received_ns < since_ns:
            second.latest = sample

    def _is_consistent(self, sample: CounterSample) -> bool:
        last = self._last
        if last is None:
            return True
        elapsed_ns = (sample.ticks - last.ticks) * self.tick_ns
        longest_ns = sample.received_ns - last.sent_ns
        slack_ns = 2 * self.tick_ns + longest_ns * MAX_PPM * 1e-6
        return sample.sent_ns - last.received_ns - slack_ns <= elapsed_ns <= longest_ns + slack_ns
