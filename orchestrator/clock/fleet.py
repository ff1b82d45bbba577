"""Fleet time: the scale on which start instants are agreed, integer nanoseconds from 0, tied to the coordinator's
clock.

On the coordinator's own computer it differs from the host's clock by a constant. Other computers have crystals of
their own, and ask for it over the bus: each answer was given between its request and its arrival. What these gates
allow is found as for any counter that is read over a link (`orchestrator/clock/estimator.py`), with a tick of one
nanosecond: that is the bound, and an asymmetry of the fastest answers, which no sample can reveal, is inside it.

Gates of milliseconds bound the rate of a crystal only after minutes. But the delays of a network are much alike, so the
line is placed by least squares through the middles of the fast answers of the last minute, and only the bound is that
of the gates. At first the rate is held near 0: a few answers say less about it than that crystals are good to some 30
ppm.
"""

from collections import deque
from dataclasses import dataclass
from math import ceil

import numpy as np

from orchestrator.clock.base import Clock
from orchestrator.clock.estimator import PREDICTION_WANDER_PPM, CounterSample, TickEstimator
from orchestrator.model.messages import LeaderHeartbeat

LEAST_EXCHANGES = 8
"""Exchanges before fleet time is used: the best of a few is known to half of its round trip."""
RECENT_EXCHANGES = 60
SPREAD_NS = 20_000.0
"""By how much the middle of even the fastest answers is off, standard deviation."""
USUAL_RATE = 30e-6
"""Standard deviation of the rate between two crystals before anything is known of them."""


@dataclass(frozen=True, slots=True)
class FleetScale:
    """Fleet time as estimated on one host: it is `fleet_at_ns` at `host_at_ns`, and runs `rate` faster than the host's
    clock (1e-6 is 1 ppm).

    bound_ns: guaranteed error at `host_at_ns`; it grows with `drift_ppm` from there. All are 0 on the coordinator's own
    computer.
    """

    scale_id: str
    host_at_ns: int
    fleet_at_ns: int = 0
    rate: float = 0.0
    bound_ns: int = 0
    drift_ppm: float = 0.0

    @property
    def is_exact(self) -> bool:
        """Whether the host's clock is that of the coordinator."""
        return not (self.rate or self.bound_ns or self.drift_ppm)

    @property
    def origin_host_ns(self) -> int:
        """The host instant of fleet time 0."""
        return self.to_host_ns(0)

    @property
    def host_share(self) -> float:
        """How much of the host's time passes in a unit of fleet time."""
        return 1.0 / (1.0 + self.rate)

    def to_fleet_ns(self, host_ns: int) -> int:
        elapsed_ns = host_ns - self.host_at_ns
        return self.fleet_at_ns + elapsed_ns + round(elapsed_ns * self.rate)

    def to_host_ns(self, fleet_ns: int) -> int:
        elapsed_ns = fleet_ns - self.fleet_at_ns
        return self.host_at_ns + elapsed_ns - round(elapsed_ns * self.rate / (1 + self.rate))

    def bound_at_ns(self, host_ns: int) -> int:
        """The guaranteed error near a host instant, ns."""
        return self.bound_ns + ceil(abs(host_ns - self.host_at_ns) * self.drift_ppm * 1e-6)

    def to_fleet_span(self, earliest_ns: int, latest_ns: int) -> tuple[int, int]:
        """An interval of host time in fleet time, widened by the uncertainty of the scale."""
        return (
            self.to_fleet_ns(earliest_ns) - self.bound_at_ns(earliest_ns),
            self.to_fleet_ns(latest_ns) + self.bound_at_ns(latest_ns),
        )


class FleetTimeEstimator:
    """Fleet time on a computer with a crystal of its own."""

    def __init__(self, scale_id: str) -> None:
        self.scale_id = scale_id
        self._estimator = TickEstimator(1.0)
        self._recent: deque[CounterSample] = deque(maxlen=RECENT_EXCHANGES)

    def add_exchange(self, exchange: CounterSample) -> bool:
        """Add a request for fleet time; its answer is `ticks`. Returns False if one of the two clocks has jumped:
        what was known before is void."""
        continuous = self._estimator.add_sample(exchange)
        if not continuous:
            self._recent.clear()
        self._recent.append(exchange)
        return continuous

    def estimate_scale(self) -> FleetScale | None:
        """The scale as of the last exchange; None before there are enough."""
        if len(self._recent) < LEAST_EXCHANGES:
            return None
        possible = self._estimator.find_possible()
        assert possible is not None
        offset_ns, slope = self._fit_line(possible.ticks_at)
        slope = min(max(slope, possible.slowest), possible.fastest)
        host_ns = min(max(possible.ticks_at + round(offset_ns), possible.earliest_ns), possible.latest_ns)
        return FleetScale(
            scale_id=self.scale_id,
            host_at_ns=host_ns,
            fleet_at_ns=possible.ticks_at,
            rate=1.0 / (1.0 + slope) - 1.0,
            bound_ns=max(possible.latest_ns - host_ns, host_ns - possible.earliest_ns) + 1,
            drift_ppm=max(possible.fastest - slope, slope - possible.slowest) * 1e6 + PREDICTION_WANDER_PPM,
        )

    def _fit_line(self, fleet_ns: int) -> tuple[float, float]:
        """Host time minus fleet time at an instant of fleet time, ns, and its slope: least squares through the middles,
        the weight of each by how much longer it took than the fastest."""
        base = self._recent[-1]
        base_ns = base.sent_ns - base.ticks
        rows = np.array([(e.ticks - fleet_ns, e.sent_ns, e.received_ns) for e in self._recent], dtype=np.int64)
        ages = rows[:, 0].astype(float)
        middles = (rows[:, 1] + rows[:, 2] - 2 * (rows[:, 0] + fleet_ns + base_ns)) / 2
        took = (rows[:, 2] - rows[:, 1]).astype(float)
        weights = 1.0 / (SPREAD_NS**2 + ((took - took.min()) / 2) ** 2)
        age, middle = np.average(ages, weights=weights), np.average(middles, weights=weights)
        alike = float((weights * (ages - age) * (middles - middle)).sum())
        slope = alike / (float((weights * (ages - age) ** 2).sum()) + USUAL_RATE**-2)
        return base_ns + float(middle - slope * age), slope


def exact_scale(heartbeat: LeaderHeartbeat, clock: Clock) -> FleetScale | None:
    """Return the exact scale of a coordinator on the same kernel; None when it runs on another."""
    if heartbeat.kernel_id != clock.kernel_id:
        return None
    return FleetScale(heartbeat.scale_id, heartbeat.origin_host_ns)
