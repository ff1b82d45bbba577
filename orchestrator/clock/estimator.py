"""The mapping of a controller's tick counter to its host's clock, with a guaranteed bound.

A sample states: the counter was `ticks` at some instant between `sent_ns` and `received_ns`, and a value lasts one
whole tick. So the instant at which the counter became `ticks` lies in (sent - tick, received]. The rate of a crystal
wanders slowly: seen from one instant, its time is a straight line, and each sample is a gate through which the line
passes. A gate widens with its distance from that instant by the amount that a crystal may have wandered in between.
The lines that pass all gates are the estimate: their middle is the mapping, the farthest of them its bound. Nothing
that the model allows exceeds this bound: slow replies, one-sided delays of a receiver, coarse ticks, wander. An
asymmetry of the fastest replies, which no sample can reveal, is inside the bound.

`python -m benches clock` compares this with least squares and the smallest round trip (Cristian, 1989): neither gives a
bound, and bytes that a USB adapter delays pull both off.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

MAX_PPM = 100.0
"""No crystal deviates further from its nominal rate."""
MAX_SAMPLES = 512
WANDER_PPM = 0.05
"""Random walk of a crystal's rate: standard deviation of its change in a second, ppm."""
SIGMA_LIMIT = 6.0
"""Number of standard deviations that the bound allows; five would be exceeded once in two million samples."""
PREDICTION_WANDER_PPM = 1.0
"""Allowance of a prediction for wander, over half a minute: SIGMA_LIMIT * WANDER_PPM * sqrt(t / 3) ppm after t
seconds."""
_GRID = 48
_ZOOMS = 3

_Floats = NDArray[np.float64]
_Ints = NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class CounterSample:
    """One reading of the counter, taken between the two host instants; known transmission times are already
    subtracted."""

    sent_ns: int
    received_ns: int
    ticks: int


@dataclass(frozen=True, slots=True)
class TickMapping:
    """host_ns = host_at_ns + (ticks - ticks_at) * tick_ns: the host time at which the counter became `ticks`.

    bound_ns: guaranteed error at `host_at_ns`; it grows with `drift_ppm` from there.
    residual_ns: mean distance of the samples from the mapping.
    consistent: all samples fit the model; otherwise the mapping uses one sample only.
    moved_ns: how much later than the middle of what is possible the mapping was placed, for usual delays.
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
    consistent: bool = True
    moved_ns: int = 0

    def to_host_ns(self, ticks: int) -> int:
        """Return the host time at which the counter becomes `ticks`."""
        return self.host_at_ns + round((ticks - self.ticks_at) * self.tick_ns)

    def to_ticks(self, host_ns: int) -> float:
        """Return the (fractional) counter value at `host_ns`."""
        return self.ticks_at + (host_ns - self.host_at_ns) / self.tick_ns

    def bound_at_ns(self, host_ns: int) -> int:
        """Return the guaranteed error of `to_host_ns()` near the instant `host_ns`."""
        return self.bound_ns + round(abs(host_ns - self.host_at_ns) * self.drift_ppm * 1e-6)

    def late_bound_at_ns(self, host_ns: int) -> int:
        """Return how much later than `to_host_ns()` the true instant can be, near the instant `host_ns`."""
        return self.bound_at_ns(host_ns) - 2 * self.moved_ns


@dataclass(frozen=True, slots=True)
class PossibleMappings:
    """All mappings that the samples allow: the counter became `ticks_at` between the two host instants, and a tick is
    longer than its nominal length by a rate between `slowest` and `fastest` (1e-6 is 1 ppm)."""

    ticks_at: int
    earliest_ns: int
    latest_ns: int
    slowest: float
    fastest: float


class TickEstimator:
    """Estimates a controller's clock from samples of its counter.

    usual_delay_ns: the counter is usually read this much later than a sample's `sent_ns` allows, e.g. because a
    firmware usually takes longer than its minimum. The mapping is moved by half of it; the bound does not depend on
    it.
    """

    def __init__(self, nominal_tick_ns: float, usual_delay_ns: int = 0) -> None:
        self._nominal_tick_ns = nominal_tick_ns
        self._usual_delay_ns = usual_delay_ns
        # Columns: sent_ns, received_ns, ticks; the newest is the last of `_count`.
        self._samples: _Ints = np.empty((MAX_SAMPLES, 3), dtype=np.int64)
        self._count = 0
        self._last: CounterSample | None = None

    def add_sample(self, sample: CounterSample) -> bool:
        """Add a sample. Return False when the counter has gone back or jumped: all earlier samples are then
        discarded."""
        last = self._last
        self._append_sample(sample)
        if last is None:
            return True
        elapsed_ns = (sample.ticks - last.ticks) * self._nominal_tick_ns
        longest_ns = sample.received_ns - last.sent_ns
        shortest_ns = sample.sent_ns - last.received_ns
        slack_ns = 2 * self._nominal_tick_ns + longest_ns * MAX_PPM * 1e-6
        if shortest_ns - slack_ns <= elapsed_ns <= longest_ns + slack_ns:
            return True
        self.discard_samples()
        self._append_sample(sample)
        return False

    def discard_samples(self) -> None:
        """Discard all samples, e.g. after a reset of the controller."""
        self._count, self._last = 0, None

    def compute_mapping(self, near_ticks: int | None = None) -> TickMapping | None:
        """Return the mapping from the current samples, or None without any: as seen from the last sample, or from the
        one nearest to `near_ticks`, which knows an instant in the past better."""
        if self._last is None:
            return None
        nominal, samples = self._nominal_tick_ns, self._samples[: self._count]
        origin = samples[-1] if near_ticks is None else samples[int(np.abs(samples[:, 2] - near_ticks).argmin())]
        gates, lines, consistent = _find_lines(samples, origin, nominal)
        # Move by half the usual delay, but never out of the feasible range nor out of the bound.
        offset_ns = lines.offset_ns + min(self._usual_delay_ns / 2, lines.half_ns)
        tick_ns = nominal * (1.0 + lines.rate)
        return TickMapping(
            ticks_at=int(origin[2]),
            host_at_ns=int(origin[0]) + round(offset_ns),
            tick_ns=tick_ns,
            rate_ppm=lines.rate * 1e6,
            residual_ns=round(gates.residual_ns(offset_ns, lines.rate)),
            bound_ns=math.ceil(lines.bound_ns + abs(offset_ns - lines.offset_ns)) + 1,
            drift_ppm=lines.rate_bound * 1e6 + PREDICTION_WANDER_PPM,
            samples=self._count,
            min_rtt_ns=int((samples[:, 1] - samples[:, 0]).min()),
            consistent=consistent,
            moved_ns=math.floor(abs(offset_ns - lines.offset_ns)),
        )

    def find_possible(self) -> PossibleMappings | None:
        """Return what the samples allow, as seen from the last one; None without any."""
        if self._last is None:
            return None
        samples = self._samples[: self._count]
        origin = samples[-1]
        gates, lines, _ = _find_lines(samples, origin, self._nominal_tick_ns)
        sent_ns, slowest, fastest = int(origin[0]), lines.rate - lines.rate_bound, lines.rate + lines.rate_bound
        lowest_ns, highest_ns = gates.find_offset_limits(slowest, fastest)
        return PossibleMappings(
            int(origin[2]), sent_ns + math.floor(lowest_ns), sent_ns + math.ceil(highest_ns), slowest, fastest
        )

    def _append_sample(self, sample: CounterSample) -> None:
        if self._count == MAX_SAMPLES:
            self._samples[:-1] = self._samples[1:]
            self._count -= 1
        self._samples[self._count] = sample.sent_ns, sample.received_ns, sample.ticks
        self._count += 1
        self._last = sample


@dataclass(frozen=True, slots=True)
class _FeasibleLines:
    """The properties common to all feasible lines.

    offset_ns: offset of the middle line when the counter became the ticks of the sample that they are seen from,
    counted from the instant that sample was sent.
    half_ns: how far an offset may be moved at its rate.
    bound_ns, rate_bound: largest deviation of any feasible line, in offset and rate."""

    offset_ns: float
    half_ns: float
    bound_ns: float
    rate: float
    rate_bound: float


class _GateSet:
    """The samples, relative to one of them, `origin`: ages in nominal ns of the counter (negative before it), gates in
    host ns.

    Of the hundreds of gates, straight lines can touch only those on a convex hull: some tens decide, and only those
    are evaluated.
    """

    def __init__(self, samples: _Ints, origin: _Ints, nominal_tick_ns: float) -> None:
        sent_ns, received_ns, ticks = (samples - origin[[0, 0, 2]]).T
        self._ages: _Floats = ticks * nominal_tick_ns
        # Deviation of a line from a sample of this age by wander alone: the integral of a random walk.
        wander_ns = SIGMA_LIMIT * WANDER_PPM * 1e-6 * np.sqrt(np.abs(self._ages * 1e-9) ** 3 / 3) * 1e9
        # The tick of a counter that runs slow is longer.
        tick_ns = nominal_tick_ns * (1.0 + MAX_PPM * 1e-6)
        self._low: _Floats = sent_ns - self._ages - tick_ns - wander_ns
        self._high: _Floats = received_ns - self._ages + wander_ns
        floor, ceiling = upper_hull(self._ages, self._low), upper_hull(self._ages, -self._high)
        self._floor = self._ages[floor], self._low[floor]
        self._ceiling = self._ages[ceiling], self._high[ceiling]

    def find_lines(self) -> _FeasibleLines | None:
        """Find all lines through the gates; None when there is none."""
        rates = np.linspace(-MAX_PPM, MAX_PPM, _GRID) * 1e-6
        best = 0.0
        for _ in range(_ZOOMS):
            low, high = self._find_offset_range(rates)
            best = float(rates[np.argmax(high - low)])
            step = float(rates[1] - rates[0])
            rates = np.linspace(best - step, best + step, _GRID)
        low, high = self._find_offset_range(np.array([best]))
        if float(high[0]) < float(low[0]):
            return None
        slowest, fastest = self._find_rate_limit(best, -MAX_PPM * 1e-6), self._find_rate_limit(best, MAX_PPM * 1e-6)
        rate = (slowest + fastest) / 2
        rates = np.linspace(slowest, fastest, _GRID)
        lows, highs = self._find_offset_range(rates)
        low, high = self._find_offset_range(np.array([rate]))
        middle, half = float(high[0] + low[0]) / 2, max(0.0, float(high[0] - low[0]) / 2)
        # Between two rates of the grid a line may reach further, in proportion to the age of the oldest sample.
        slack = (fastest - slowest) / _GRID * float(np.abs(self._ages).max())
        bound = max(float(highs.max()) - middle, middle - float(lows.min())) + slack
        return _FeasibleLines(middle, half, bound, rate, (fastest - slowest) / 2)

    def find_offset_limits(self, slowest: float, fastest: float) -> tuple[float, float]:
        """Return the least and the greatest offset of a line through all gates at any rate between the two: the lower
        limit is convex in the rate and the upper one concave, so that each is near the best rate of a grid."""
        limits: list[float] = []
        for side in (0, 1):
            rates, limit = np.linspace(slowest, fastest, _GRID), 0.0
            for _ in range(_ZOOMS):
                offsets = self._find_offset_range(rates)[side]
                best, step = int(offsets.argmax() if side else offsets.argmin()), float(rates[1] - rates[0])
                slack = step * float(np.abs(self._ages).max())
                limit, middle = float(offsets[best]) + (slack if side else -slack), float(rates[best])
                rates = np.linspace(max(slowest, middle - step), min(fastest, middle + step), _GRID)
            limits.append(limit)
        return limits[0], limits[1]

    def residual_ns(self, offset_ns: float, rate: float) -> float:
        """Return the mean distance of the samples' middles from a line."""
        middles = (self._low + self._high) / 2 - self._ages * rate
        return float(np.abs(middles - offset_ns).mean())

    def _find_offset_range(self, rates: _Floats) -> tuple[_Floats, _Floats]:
        """Return, for each rate, the offsets between which a line passes all gates."""
        (low_ages, low), (high_ages, high) = self._floor, self._ceiling
        return (low - np.outer(rates, low_ages)).max(axis=1), (high - np.outer(rates, high_ages)).min(axis=1)

    def _find_rate_limit(self, inside: float, outside: float) -> float:
        """Find the last rate on the way from `inside` to `outside` at which a line passes all gates."""
        for _ in range(_ZOOMS):
            rates = np.linspace(inside, outside, _GRID)
            low, high = self._find_offset_range(rates)
            possible = np.nonzero(high >= low)[0]
            last = int(possible[-1]) if len(possible) else 0
            if last == _GRID - 1:
                return outside
            inside, outside = float(rates[last]), float(rates[last + 1])
        return outside


def _find_lines(samples: _Ints, origin: _Ints, nominal_tick_ns: float) -> tuple[_GateSet, _FeasibleLines, bool]:
    """Find the gates and the lines through them, and whether they are consistent: samples outside the model (a delay
    beyond every allowance, a crystal beyond MAX_PPM) leave `origin` alone."""
    gates = _GateSet(samples, origin, nominal_tick_ns)
    lines = gates.find_lines()
    if lines is not None:
        return gates, lines, True
    gates = _GateSet(origin[None], origin, nominal_tick_ns)
    lines = gates.find_lines()
    assert lines is not None
    return gates, lines, False


def upper_hull(ages: _Floats, values: _Floats) -> _Ints:
    """Find the points that a straight line from above can touch, by index; a few more do no harm."""
    hull: _Ints = np.argsort(ages, kind="stable")
    while len(hull) > 2:
        x, y = ages[hull], values[hull]
        # A point below the line between its neighbours is no corner, whatever other points are dropped.
        is_below = (x[1:-1] - x[:-2]) * (y[2:] - y[:-2]) > (x[2:] - x[:-2]) * (y[1:-1] - y[:-2])
        if not is_below.any():
            break
        hull = hull[np.concatenate(([True], ~is_below, [True]))]
    return hull
