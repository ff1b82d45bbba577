"""A controller's tick counter against its host's clock: regression over the best round trips, with an honest bound.

A sample says: the counter read `ticks` at some instant between `sent_ns` and `received_ns`, and the counter's
value holds for a whole tick. Nothing narrower is ever claimed than what all samples allow together: about half the
smallest round trip (asymmetry can not be seen) plus half a tick, less where the samples dither below the tick.
"""

import math
from collections import deque
from dataclasses import dataclass

# A crystal's rate, fitted over a baseline of at least MIN_BASELINE_NS; before that the nominal one is taken.
MAX_PPM = 100.0
MIN_BASELINE_NS = 5_000_000_000
KEPT = 256
WANDER_PPM = 2.0  # how far a crystal's rate moves within the samples kept (0.05 ppm/sqrt(s) over some minutes)


@dataclass(frozen=True, slots=True)
class Sample:
    """One reading of the counter: it was taken between the two host instants, known wire times taken out."""

    sent_ns: int
    received_ns: int
    ticks: int


@dataclass(frozen=True, slots=True)
class TickMapping:
    """host_ns = host_at_ns + (ticks - ticks_at) * tick_ns: the host time at which the counter became `ticks`.

    bound_ns: guaranteed error at `host_at_ns`; grows with `drift_ppm` from there.
    """

    ticks_at: int
    host_at_ns: int
    tick_ns: float
    rate_ppm: float
    residual_ns: int
    bound_ns: int
    drift_ppm: float
    samples: int
    min_rtt_ns: int

    def host_ns(self, ticks: int) -> int:
        """Host time at which the counter becomes `ticks`."""
        return self.host_at_ns + round((ticks - self.ticks_at) * self.tick_ns)

    def ticks(self, host_ns: int) -> float:
        """The (fractional) counter value at `host_ns`."""
        return self.ticks_at + (host_ns - self.host_at_ns) / self.tick_ns

    def bound_at_ns(self, host_ns: int) -> int:
        """Guaranteed error of `host_ns()` near the instant `host_ns`."""
        return self.bound_ns + round(abs(host_ns - self.host_at_ns) * self.drift_ppm * 1e-6)


class TickEstimator:
    """Learns a controller's clock from readings of its counter."""

    def __init__(self, nominal_tick_ns: float) -> None:
        self._nominal_tick_ns = nominal_tick_ns
        self._samples: deque[Sample] = deque(maxlen=KEPT)

    def add(self, sample: Sample) -> bool:
        """Take a reading. False when the counter has gone back or jumped: everything learned before is dropped."""
        last = self._samples[-1] if self._samples else None
        self._samples.append(sample)
        if last is None:
            return True
        elapsed_ns = (sample.ticks - last.ticks) * self._nominal_tick_ns
        longest_ns = sample.received_ns - last.sent_ns
        shortest_ns = sample.sent_ns - last.received_ns
        slack_ns = 2 * self._nominal_tick_ns + longest_ns * MAX_PPM * 1e-6
        if shortest_ns - slack_ns <= elapsed_ns <= longest_ns + slack_ns:
            return True
        self._samples.clear()
        self._samples.append(sample)
        return False

    def forget(self) -> None:
        """Start anew, e.g. after the controller was reset."""
        self._samples.clear()

    def mapping(self) -> TickMapping | None:
        """The mapping that the readings give now, or None without any.

        Each reading confines the instant at which the counter became `ticks` to (sent - tick, received]. Carried
        to the newest reading at the fitted rate, and widened by what the rate may be off over its age, the
        intervals have the truth in common; their intersection is the estimate and its guaranteed bound.
        """
        if not self._samples:
            return None
        last = self._samples[-1]
        min_rtt_ns = min(sample.received_ns - sample.sent_ns for sample in self._samples)
        tick_ns, drift_ppm = self._rate(min_rtt_ns)
        low_ns, high_ns = -math.inf, math.inf
        for sample in self._samples:
            carried_ns = (last.ticks - sample.ticks) * tick_ns
            slack_ns = abs(last.sent_ns - sample.sent_ns) * drift_ppm * 1e-6
            low_ns = max(low_ns, sample.sent_ns - last.sent_ns - tick_ns + carried_ns - slack_ns)
            high_ns = min(high_ns, sample.received_ns - last.sent_ns + carried_ns + slack_ns)
        if low_ns > high_ns:
            # Outside the model (a delay before `sent`, a rate beyond its bound): what both ends say, none denied.
            low_ns, high_ns = high_ns - tick_ns, low_ns + tick_ns
        middle_ns = (low_ns + high_ns) / 2
        centres = [
            (s.sent_ns + s.received_ns - tick_ns) / 2 - last.sent_ns + (last.ticks - s.ticks) * tick_ns
            for s in self._samples
        ]
        return TickMapping(
            ticks_at=last.ticks,
            host_at_ns=last.sent_ns + round(middle_ns),
            tick_ns=tick_ns,
            rate_ppm=(tick_ns / self._nominal_tick_ns - 1.0) * 1e6,
            residual_ns=round(sum(abs(each - middle_ns) for each in centres) / len(centres)),
            bound_ns=math.ceil((high_ns - low_ns) / 2) + 1,
            drift_ppm=drift_ppm,
            samples=len(self._samples),
            min_rtt_ns=min_rtt_ns,
        )

    def _rate(self, min_rtt_ns: int) -> tuple[float, float]:
        """The tick in host ns, and how far it may be off, ppm: fitted over a long baseline, nominal before."""
        nominal = self._nominal_tick_ns
        short = [s for s in self._samples if s.received_ns - s.sent_ns <= 2 * min_rtt_ns]
        baseline_ns = short[-1].sent_ns - short[0].sent_ns if short else 0
        if len(short) < 8 or baseline_ns < MIN_BASELINE_NS:
            return nominal, MAX_PPM
        origin = short[0]
        fitted = _slope([(s.ticks - origin.ticks, (s.sent_ns + s.received_ns) / 2 - origin.sent_ns) for s in short])
        fitted_ppm = (fitted / nominal - 1.0) * 1e6
        if abs(fitted_ppm) > MAX_PPM:
            return nominal, MAX_PPM
        # What the two ends of the baseline prove, if that is less than what any crystal keeps.
        proven_ppm = 2 * (2 * min_rtt_ns + nominal) / baseline_ns * 1e6 + WANDER_PPM
        return fitted, min(proven_ppm, MAX_PPM + abs(fitted_ppm))


def _slope(points: list[tuple[float, float]]) -> float:
    """Least squares slope of y on x."""
    n = len(points)
    mean_x = sum(x for x, _ in points) / n
    mean_y = sum(y for _, y in points) / n
    return sum((x - mean_x) * (y - mean_y) for x, y in points) / sum((x - mean_x) ** 2 for x, _ in points)
