"""The rate of a crystal that cannot be read, inferred from the moves that it times.

Anything that a controller does in a time that is exact by its crystal, and known within bounds by the host's clock,
is a gate for the rate; a gate widens with its age by the amount that a crystal may have wandered since. The rates
that pass all gates, and lie within the tolerance assumed at the start, are feasible; the farthest of them is the
bound. Effects that no evidence reveals lie inside: a delayed reply only widens a gate on its side.

The position of the rate between the bounds is estimated better than by their middle: measurements, each with its own
scatter, are combined as those of a rate that walks randomly (Kalman, 1960), and limited to the feasible range.
`python -m benches rates` shows both compared with the method of a script, for every kind of link.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import ceil, floor, sqrt

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import SIGMA_LIMIT, WANDER_PPM

MAX_GATES = 256
_RESIDUAL_MEASUREMENTS = 20
MAX_LEAD_S = 30.0
"""A move is planned at most this long before it starts."""


@dataclass(frozen=True, slots=True)
class RateGate:
    """The rate lay between low_ppm and high_ppm, as a mean over a time that ended at the host instant at_ns.

    spread_s: time over which the rate may have wandered between that mean and the rate at its end: a third of its
    length for one stretch, all of it for the narrowest of many within."""

    low_ppm: float
    high_ppm: float
    at_ns: int
    spread_s: float

    def range_at(self, now_ns: int) -> tuple[float, float]:
        """Return the range of rates that the gate allows at `now_ns`."""
        wander = _wander_ppm((now_ns - self.at_ns) / NS_PER_S + self.spread_s)
        return self.low_ppm - wander, self.high_ppm + wander


@dataclass(frozen=True, slots=True)
class RateMeasurement:
    """A measured rate.

    error_ppm: its standard deviation.
    at_ns: the middle of the measured time."""

    rate_ppm: float
    error_ppm: float
    at_ns: int


@dataclass(frozen=True, slots=True)
class CrystalRate:
    """How much faster than the host's clock a crystal runs, ppm.

    low_ppm, high_ppm: guaranteed at the host instant at_ns.
    assumed_ppm: bounds at any time, by assumption.
    error_ppm: standard deviation, by the scatter of the measurements.
    residual_ppm: mean distance of the last measurements from it.
    moves: number of moves that it was learned from.
    consistent: the moves fit the model of evidence and crystal; otherwise everything was discarded at at_ns.
    """

    rate_ppm: float
    low_ppm: float
    high_ppm: float
    assumed_ppm: tuple[float, float]
    at_ns: int = 0
    error_ppm: float = 0.0
    residual_ppm: float = 0.0
    moves: int = 0
    consistent: bool = True

    @property
    def clock_factor(self) -> float:
        """Seconds of the crystal in one of the host's."""
        return 1 + self.rate_ppm * 1e-6

    def range_ppm(self, now_ns: int, duration_s: float, lead_s: float = 0.0) -> tuple[float, float]:
        """Return the guaranteed least and largest mean rate over a move of this duration that ends now, or that
        starts within `lead_s` from now."""
        wander = _wander_ppm(max(0, now_ns - self.at_ns) / NS_PER_S + lead_s + duration_s / 3)
        least, most = self.assumed_ppm
        return max(least, self.low_ppm - wander), min(most, self.high_ppm + wander)

    def bound_ppm(self, now_ns: int, duration_s: float, lead_s: float = 0.0) -> float:
        """Return the guaranteed error of the rate, for the same time as `range_ppm`."""
        low, high = self.range_ppm(now_ns, duration_s, lead_s)
        return max(high - self.rate_ppm, self.rate_ppm - low)

    def host_duration_ns(self, duration_s: float, now_ns: int) -> tuple[int, int]:
        """Return the least and largest duration by the host's clock of something that took `duration_s` by the
        crystal, and ends now."""
        low, high = self.range_ppm(now_ns, duration_s)
        device_ns = duration_s * NS_PER_S
        return floor(device_ns / (1 + high * 1e-6)), ceil(device_ns / (1 + low * 1e-6))


class RateEstimator:
    """Learns the rate of one crystal. usual_ppm: the rate assumed at first; the true one is always within
    `reach_ppm` of it."""

    def __init__(self, usual_ppm: float, reach_ppm: float) -> None:
        span = (usual_ppm - reach_ppm, usual_ppm + reach_ppm)
        # `reach_ppm` counts as three standard deviations: most crystals are much better than the worst permitted one.
        self._assumed = CrystalRate(usual_ppm, *span, assumed_ppm=span, error_ppm=reach_ppm / 3)
        self._reach_ppm = reach_ppm
        self._gates: deque[RateGate] = deque(maxlen=MAX_GATES)
        self._measurements: deque[RateMeasurement] = deque(maxlen=MAX_GATES)
        self._moves = 0
        self.rate = self._assumed

    def discard_moves(self) -> None:
        """Discard all moves, e.g. after the controller was switched off and on."""
        self._gates.clear()
        self._measurements.clear()
        self._moves = 0
        self.rate = self._assumed

    def add_move(self, gates: Iterable[RateGate], measures: Iterable[RateMeasurement], now_ns: int) -> bool:
        """Learn from a move that ends now. Return False when it contradicts the earlier ones: all are then
        discarded."""
        fresh = [gate for gate in gates if self._narrows_range(gate, now_ns)]
        usable_measures = [measure for measure in measures if measure.error_ppm < self._reach_ppm]
        if not fresh and not usable_measures:
            return True  # too short, or observed too poorly, to show anything
        self._gates.extend(fresh)
        self._measurements.extend(usable_measures)
        self._moves += 1
        rate = self._estimate_rate(now_ns)
        if rate is None:
            self.discard_moves()
            self.rate = replace(self._assumed, at_ns=now_ns, consistent=False)
            return False
        self.rate = rate
        return True

    def _narrows_range(self, gate: RateGate, now_ns: int) -> bool:
        low, high = gate.range_at(now_ns)
        return low > self._assumed.low_ppm or high < self._assumed.high_ppm

    def _estimate_rate(self, now_ns: int) -> CrystalRate | None:
        spans = [(self._assumed.low_ppm, self._assumed.high_ppm), *(gate.range_at(now_ns) for gate in self._gates)]
        low, high = max(span[0] for span in spans), min(span[1] for span in spans)
        if low > high:
            return None
        likely, variance = (
            self._filter_measurements(now_ns) if self._measurements else ((low + high) / 2, (high - low) ** 2 / 12)
        )
        rate = min(max(likely, low), high)
        last = list(self._measurements)[-_RESIDUAL_MEASUREMENTS:]
        return CrystalRate(
            rate_ppm=rate,
            low_ppm=low,
            high_ppm=high,
            assumed_ppm=self._assumed.assumed_ppm,
            at_ns=now_ns,
            error_ppm=sqrt(variance),
            residual_ppm=sum(abs(measurement.rate_ppm - rate) for measurement in last) / len(last) if last else 0.0,
            moves=self._moves,
        )

    def _filter_measurements(self, now_ns: int) -> tuple[float, float]:
        """Return the most likely rate at `now_ns`, and its variance."""
        rate, variance = self._assumed.rate_ppm, self._assumed.error_ppm**2
        at_ns = now_ns
        for measurement in self._measurements:
            variance += WANDER_PPM**2 * max(0, measurement.at_ns - at_ns) / NS_PER_S
            gain = variance / (variance + measurement.error_ppm**2)
            rate += gain * (measurement.rate_ppm - rate)
            variance *= 1 - gain
            at_ns = measurement.at_ns
        return rate, variance + WANDER_PPM**2 * max(0, now_ns - at_ns) / NS_PER_S


def _wander_ppm(spread_s: float) -> float:
    """Return how far a crystal's rate may have walked in `spread_s`, or, over three times as long, deviate from its
    mean."""
    return SIGMA_LIMIT * WANDER_PPM * sqrt(spread_s)
