"""The rate of a crystal that can not be read, from what is seen of the moves that it times.

Whatever a unit has done in a time that is exact by its crystal, and known by the host's within bounds, is a gate for
the rate: wider the older it is, by what a crystal may have wandered since. The rates that pass all gates, and are
within what is assumed of the crystal from the start, are possible; the farthest of them is the bound. What no evidence
shows lies inside: an answer that was held back only makes a gate wider on its side.

Where between them the rate is can be told better than by their middle: measurements, each with its own scatter, are put
together as those of a rate that walks (Kalman, 1960), and never believed beyond what is possible. `tutti bench rates`
shows both beside what a script would do, for every kind of link.
"""

from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass, replace
from math import ceil, floor, sqrt

from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.estimator import SURE, WANDER_PPM

KEPT = 256
_LAST = 20
LEAD_S = 30.0
"""A move is planned so long before it starts at the most."""


@dataclass(frozen=True, slots=True)
class Gate:
    """The rate lay between low_ppm and high_ppm, as a mean over a time that ended at the host instant at_ns. spread_s:
    of the wander between that mean and the rate at its end: a third of its length for one stretch, all of it for the
    narrowest of many within."""

    low_ppm: float
    high_ppm: float
    at_ns: int
    spread_s: float

    def widened(self, now_ns: int) -> tuple[float, float]:
        """The rates of now that it allows."""
        wander = _wander_ppm((now_ns - self.at_ns) / NS_PER_S + self.spread_s)
        return self.low_ppm - wander, self.high_ppm + wander


@dataclass(frozen=True, slots=True)
class Measure:
    """A rate that was measured. error_ppm: its standard deviation. at_ns: the middle of the time that it is of."""

    rate_ppm: float
    error_ppm: float
    at_ns: int


@dataclass(frozen=True, slots=True)
class CrystalRate:
    """How much faster than the host's clock a crystal runs, ppm.

    low_ppm, high_ppm: guaranteed at the host instant at_ns. assumed_ppm: the same at any time, by what is assumed.
    error_ppm: standard deviation, by the scatter of what was measured. residual_ppm: how far the last measurements are
    from it on average. moves: that it was learned from. consistent: they fit the model of evidence and crystal; else
    everything was forgotten at at_ns.
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
    def factor(self) -> float:
        """Seconds of the crystal in one of the host's."""
        return 1 + self.rate_ppm * 1e-6

    def span_ppm(self, now_ns: int, duration_s: float, lead_s: float = 0.0) -> tuple[float, float]:
        """The least and the most that the rate is, guaranteed, as a mean over a move of this duration that ends now, or
        that starts within `lead_s` from now."""
        wander = _wander_ppm(max(0, now_ns - self.at_ns) / NS_PER_S + lead_s + duration_s / 3)
        least, most = self.assumed_ppm
        return max(least, self.low_ppm - wander), min(most, self.high_ppm + wander)

    def bound_ppm(self, now_ns: int, duration_s: float, lead_s: float = 0.0) -> float:
        """Guaranteed error of the rate, like `span_ppm`."""
        low, high = self.span_ppm(now_ns, duration_s, lead_s)
        return max(high - self.rate_ppm, self.rate_ppm - low)

    def took_ns(self, duration_s: float, now_ns: int) -> tuple[int, int]:
        """What something that took so long by the crystal, and ends now, took by the host's clock: least and most."""
        low, high = self.span_ppm(now_ns, duration_s)
        device_ns = duration_s * NS_PER_S
        return floor(device_ns / (1 + high * 1e-6)), ceil(device_ns / (1 + low * 1e-6))


class RateEstimator:
    """Learns the rate of one crystal. usual_ppm: what it is taken for at first, and within `reach_ppm` of it always."""

    def __init__(self, usual_ppm: float, reach_ppm: float) -> None:
        span = (usual_ppm - reach_ppm, usual_ppm + reach_ppm)
        # Taken for three standard deviations: most crystals are much better than the worst that is allowed for.
        self._assumed = CrystalRate(usual_ppm, *span, assumed_ppm=span, error_ppm=reach_ppm / 3)
        self._reach_ppm = reach_ppm
        self._gates: deque[Gate] = deque(maxlen=KEPT)
        self._measures: deque[Measure] = deque(maxlen=KEPT)
        self._moves = 0
        self.rate = self._assumed

    def forget(self) -> None:
        """Start anew, e.g. after the unit was switched off and on."""
        self._gates.clear()
        self._measures.clear()
        self._moves = 0
        self.rate = self._assumed

    def take(self, gates: Iterable[Gate], measures: Iterable[Measure], now_ns: int) -> bool:
        """Learn from a move that ends now. False when it contradicts what was known: then nothing is."""
        fresh = [gate for gate in gates if self._excludes(gate, now_ns)]
        measured = [each for each in measures if each.error_ppm < self._reach_ppm]
        if not fresh and not measured:
            return True  # too short, or seen too badly, to say anything
        self._gates.extend(fresh)
        self._measures.extend(measured)
        self._moves += 1
        found = self._estimate(now_ns)
        if found is None:
            self.forget()
            self.rate = replace(self._assumed, at_ns=now_ns, consistent=False)
            return False
        self.rate = found
        return True

    def _excludes(self, gate: Gate, now_ns: int) -> bool:
        low, high = gate.widened(now_ns)
        return low > self._assumed.low_ppm or high < self._assumed.high_ppm

    def _estimate(self, now_ns: int) -> CrystalRate | None:
        spans = [(self._assumed.low_ppm, self._assumed.high_ppm), *(each.widened(now_ns) for each in self._gates)]
        low, high = max(each[0] for each in spans), min(each[1] for each in spans)
        if low > high:
            return None
        likely, variance = self._filtered(now_ns) if self._measures else ((low + high) / 2, (high - low) ** 2 / 12)
        rate = min(max(likely, low), high)
        last = list(self._measures)[-_LAST:]
        return CrystalRate(
            rate_ppm=rate,
            low_ppm=low,
            high_ppm=high,
            assumed_ppm=self._assumed.assumed_ppm,
            at_ns=now_ns,
            error_ppm=sqrt(variance),
            residual_ppm=sum(abs(each.rate_ppm - rate) for each in last) / len(last) if last else 0.0,
            moves=self._moves,
        )

    def _filtered(self, now_ns: int) -> tuple[float, float]:
        """The likeliest rate of now, and its variance."""
        rate, variance = self._assumed.rate_ppm, self._assumed.error_ppm**2
        at_ns = now_ns
        for each in self._measures:
            variance += WANDER_PPM**2 * max(0, each.at_ns - at_ns) / NS_PER_S
            gain = variance / (variance + each.error_ppm**2)
            rate += gain * (each.rate_ppm - rate)
            variance *= 1 - gain
            at_ns = each.at_ns
        return rate, variance + WANDER_PPM**2 * max(0, now_ns - at_ns) / NS_PER_S


def _wander_ppm(spread_s: float) -> float:
    """How far a crystal's rate may have walked, or, over a third of the time, be from its mean."""
    return SURE * WANDER_PPM * sqrt(spread_s)
