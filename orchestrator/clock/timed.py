"""Observations of a move that a controller times by its own crystal, and what they prove about crystal and start.

The observations are the same for every make: the start command was written and acknowledged; positions were reported
on the way; the controller was polled whether it still moves; it reported the end. Each is a fact about an interval
of host time. At constant speed, positions are readings of the crystal: hundreds in a long move. A position counts as
taken at an instant between the end of the query on the serial line and the beginning of its reply. The shape of
ramps only determines where start and end lie.

The late side of an end is bounded by the last query that was answered with `moving`. A limit for the delay of a
completion message is not assumed: a receiver's setting is no evidence.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor, inf, sqrt

import numpy as np
from numpy.typing import NDArray

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.rate import CrystalRate, RateGate, RateMeasurement

_END_POLL_LEAD_NS = 20 * NS_PER_MS
MIN_POLLED_DURATION_S = 5.0
"""The end of a shorter move is not worth polling for: a millisecond is more than a crystal's error in it."""
_MAX_READINGS = 256
"""Limit of readings that are compared with each other."""
_SECTIONS = 48
"""Sections of the time; of more readings than `_MAX_READINGS` the best two of each section are kept."""
_MIN_READINGS = 10
_MIN_ERROR_PPM = 0.1
"""Lower limit for the assumed error of a fit of readings."""

_Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class _CruiseLeg:
    """The longest leg at constant speed: counts from first to last, begun begin_s after the start; counts/s."""

    first: float
    last: float
    begins_at_s: float
    speed: float


@dataclass(frozen=True, slots=True)
class _PositionReading:
    """By the crystal, first_ns to last_ns had passed since the start, at an instant from earliest_ns to latest_ns."""

    first_ns: float
    last_ns: float
    earliest_ns: int
    latest_ns: int

    @property
    def earliest_start_ns(self) -> float:
        """Earliest start that this reading allows, by a perfect crystal; a larger value is more informative."""
        return self.earliest_ns - self.last_ns

    @property
    def latest_start_ns(self) -> float:
        """Latest start that this reading allows, by a perfect crystal; a smaller value is more informative."""
        return self.latest_ns - self.first_ns


class _LeastSquares:
    """Least squares of the crystal's time against the host's, as running sums, in s from the start: no reading is
    stored, and none is left out."""

    def __init__(self) -> None:
        self._n = 0
        self._host = self._host2 = self._off = self._off2 = self._both = 0.0

    def add_point(self, host_ns: float, device_ns: float) -> None:
        host, off = host_ns / NS_PER_S, (device_ns - host_ns) / NS_PER_S
        self._n += 1
        self._host, self._host2 = self._host + host, self._host2 + host * host
        self._off, self._off2 = self._off + off, self._off2 + off * off
        self._both += host * off

    def measure_rate(self, begin_ns: int) -> RateMeasurement | None:
        """Return the slope, with the error that follows from the scatter about it. begin_ns: the host instant of 0."""
        if self._n < _MIN_READINGS:
            return None
        n = self._n
        over = self._host2 - self._host**2 / n
        covariance = self._both - self._host * self._off / n
        scatter = max(0.0, self._off2 - self._off**2 / n - covariance * covariance / over) / (n - 2)
        middle_ns = begin_ns + round(self._host / n * NS_PER_S)
        return RateMeasurement(covariance / over * 1e6, sqrt(scatter / over) * 1e6 + _MIN_ERROR_PPM, middle_ns)


class TimedMove:
    """A move that has started.

    duration_s: by the controller's crystal.
    legs: consecutive (duration, initial speed, acceleration), by the same crystal, in s and counts along the path.
    started_ns: the earliest and the latest instant of its start, by observation alone, never by an assumption about
    the crystal."""

    def __init__(
        self, duration_s: float, legs: Iterable[tuple[float, float, float]], started_ns: tuple[int, int]
    ) -> None:
        self.duration_s = duration_s
        self.started_ns = started_ns
        self._cruise = _find_cruise(legs)
        self._readings: list[_PositionReading] = []
        self._query_fit, self._reply_fit = _LeastSquares(), _LeastSquares()
        self._ended_ns: tuple[int | None, int] | None = None
        self._moved_ns: int | None = None

    @property
    def end_poll_lead_ns(self) -> int:
        """Polling for the end begins this long before the earliest possible end. The time differs between moves, so
        that some polls come just before an end, and others just after."""
        return _END_POLL_LEAD_NS + self.started_ns[0] % _END_POLL_LEAD_NS

    def add_position(self, distance: float, resolution: float, earliest_ns: int, latest_ns: int) -> None:
        """Record a position: between the two instants the move had covered this distance, to within the resolution
        in counts either way."""
        cruise = self._cruise
        if cruise is None or not cruise.first + resolution < distance < cruise.last - resolution:
            return
        middle_ns = (cruise.begins_at_s + (distance - cruise.first) / cruise.speed) * NS_PER_S
        off_ns = resolution / cruise.speed * NS_PER_S
        self._readings.append(_PositionReading(middle_ns - off_ns, middle_ns + off_ns, earliest_ns, latest_ns))
        self._query_fit.add_point(earliest_ns - self.started_ns[0], middle_ns)
        self._reply_fit.add_point(latest_ns - self.started_ns[0], middle_ns)
        if len(self._readings) > _MAX_READINGS:
            self._readings = _select_best(self._readings)

    def mark_moving(self, at_ns: int) -> None:
        """Record that the move had not ended at that instant. Only for a controller that no longer reports `moving`,
        e.g. while it settles."""
        self._moved_ns = at_ns if self._moved_ns is None else max(self._moved_ns, at_ns)

    def mark_ended(self, latest_ns: int) -> None:
        """Record that the move had ended, as planned, at that instant."""
        self._ended_ns = (self._moved_ns, latest_ns)

    @property
    def rate_gates(self) -> list[RateGate]:
        """The feasible rates of the crystal that follow from this move."""
        gates: list[RateGate] = []
        device_ns = self.duration_s * NS_PER_S
        if self._ended_ns is not None:
            moved_ns, latest_ns = self._ended_ns
            longest_ns = latest_ns - self.started_ns[0]
            shortest_ns = 0 if moved_ns is None else moved_ns - self.started_ns[1]
            low, high = _ratio_ppm(device_ns, longest_ns), _ratio_ppm(device_ns, shortest_ns)
            gates.append(RateGate(low, high, latest_ns, self.duration_s / 3))
        if len(self._readings) > 1:
            gates.append(self._narrowest_pair())
        return gates

    @property
    def rate_measurements(self) -> list[RateMeasurement]:
        """Rates measured from the reported positions; none without positions: the middles of the start and end
        intervals are no better than the middle of the rates that all moves have left feasible.

        Queries reach a controller more evenly than its replies reach the host where a receiver delays replies, less
        evenly where the host is busy: the set with less scatter about a straight line is used.
        """
        lines = [fit.measure_rate(self.started_ns[0]) for fit in (self._query_fit, self._reply_fit)]
        measurements = [line for line in lines if line is not None]
        return [min(measurements, key=lambda measurement: measurement.error_ppm)] if measurements else []

    def _narrowest_pair(self) -> RateGate:
        """Return the narrowest gate of all pairs of readings."""
        first, last, earliest, latest = (
            np.array([getattr(reading, name) for reading in self._readings], dtype=float)
            for name in ("first_ns", "last_ns", "earliest_ns", "latest_ns")
        )
        earliest, latest = earliest - self.started_ns[0], latest - self.started_ns[0]
        least, most = _subtract_pairwise(last, first), _subtract_pairwise(first, last)  # by the crystal
        shortest, longest = _subtract_pairwise(latest, earliest), _subtract_pairwise(earliest, latest)
        with np.errstate(divide="ignore", invalid="ignore"):
            low = np.where((least > 0) & (longest > 0), least / longest - 1, -1.0)
            high = np.where((least > 0) & (shortest > 0), most / shortest - 1, inf)
        at_ns = max(reading.latest_ns for reading in self._readings)
        apart_s = (at_ns - min(reading.earliest_ns for reading in self._readings)) / NS_PER_S
        return RateGate(float(low.max()) * 1e6, float(high.min()) * 1e6, at_ns, apart_s)

    def start_interval_ns(self, rate: CrystalRate, now_ns: int) -> tuple[int, int]:
        """Return the earliest and the latest instant of the start, by all observations and the current estimate of
        the rate."""
        earliest_ns, latest_ns = self.started_ns
        if self._ended_ns is not None:
            least_ns, most_ns = rate.host_duration_ns(self.duration_s, now_ns)
            moved_ns, ended_ns = self._ended_ns
            latest_ns = min(latest_ns, ended_ns - least_ns)
            if moved_ns is not None:
                earliest_ns = max(earliest_ns, moved_ns - most_ns)
        # Up to a reading the crystal may deviate by the wander of the whole move.
        low, high = rate.range_ppm(now_ns, 3 * self.duration_s)
        for reading in self._readings:
            earliest_ns = max(earliest_ns, floor(reading.earliest_ns - reading.last_ns / (1 + low * 1e-6)))
            latest_ns = min(latest_ns, ceil(reading.latest_ns - reading.first_ns / (1 + high * 1e-6)))
        return earliest_ns, latest_ns


def _find_cruise(legs: Iterable[tuple[float, float, float]]) -> _CruiseLeg | None:
    cruises: list[tuple[float, _CruiseLeg]] = []
    begin_s = begin = 0.0
    for duration_s, speed, acceleration in legs:
        end = begin + duration_s * (speed + duration_s * acceleration / 2)
        if acceleration == 0.0 and speed > 0.0:
            cruises.append((duration_s, _CruiseLeg(begin, end, begin_s, speed)))
        begin_s, begin = begin_s + duration_s, end
    return max(cruises, key=lambda cruise: cruise[0])[1] if cruises else None


def _select_best(readings: list[_PositionReading]) -> list[_PositionReading]:
    """Select, for each section, the readings that bound their own instant most tightly, early and late."""
    begin, length = readings[0].first_ns, readings[-1].last_ns - readings[0].first_ns
    stretches: dict[int, list[_PositionReading]] = {}
    for reading in readings:
        stretches.setdefault(int((reading.first_ns - begin) / length * _SECTIONS), []).append(reading)
    kept_readings: list[_PositionReading] = []
    for reading in stretches.values():
        kept_readings += dict.fromkeys(
            (
                max(reading, key=lambda position_reading: position_reading.earliest_start_ns),
                min(reading, key=lambda position_reading: position_reading.latest_start_ns),
            )
        )
    return kept_readings


def _subtract_pairwise(from_: _Floats, to: _Floats) -> _Floats:
    """Return the difference of each reading (row) to each other one (column)."""
    return to[np.newaxis, :] - from_[:, np.newaxis]


def _ratio_ppm(device_ns: float, host_ns: float) -> float:
    return (device_ns / host_ns - 1) * 1e6 if host_ns > 0 else inf
