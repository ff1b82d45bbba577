"""The clock of a unit that can not be asked for it: how fast it is, and how soon it starts, from the moves it makes."""

from dataclasses import dataclass

from orchestrator.clock.latency import Latency, LatencyEstimator
from orchestrator.clock.rate import LEAD_S, CrystalRate, RateEstimator
from orchestrator.clock.timed import TimedMove


@dataclass(frozen=True, slots=True)
class KnownClock:
    """What is known of a unit's clock at an instant."""

    rate: CrystalRate
    latency: Latency
    now_ns: int

    def clock_ppm(self, duration_s: float) -> float:
        """How far off a move of this duration may be that is planned now."""
        return self.rate.bound_ppm(self.now_ns, duration_s, LEAD_S)


class UnreadClock:
    """Learns from every move that has ended as planned. usual_ppm, reach_ppm: of the crystal, declared: of the start,
    what is assumed without any."""

    def __init__(self, usual_ppm: float, reach_ppm: float, declared: Latency) -> None:
        self._rates = RateEstimator(usual_ppm, reach_ppm)
        self._latencies = LatencyEstimator(declared)

    @property
    def rate(self) -> CrystalRate:
        """Of the crystal against the host's, as known after the last move: two lowerings between two moves agree."""
        return self._rates.rate

    @property
    def latency(self) -> Latency:
        """From the end of the starting line on the wire to the start."""
        return self._latencies.latency

    def known(self, now_ns: int) -> KnownClock:
        """What lowering is done with."""
        return KnownClock(self.rate, self.latency, now_ns)

    def learn(self, move: TimedMove, arrived_ns: int, answered_ns: int | None, now_ns: int) -> None:
        """Learn from a move that has just ended as planned. arrived_ns: the earliest instant at which its starting line
        was at the unit. answered_ns: the latest at which the acknowledgement that is sent with the start can have begun
        to be sent; None for a unit that has none."""
        if not self._rates.take(move.gates, move.measures, now_ns):
            return
        earliest_ns, latest_ns = move.start_ns(self._rates.rate, now_ns)
        answered_after_ns = None if answered_ns is None else answered_ns - arrived_ns
        self._latencies.take(earliest_ns - arrived_ns, latest_ns - arrived_ns, answered_after_ns)

    def forget(self) -> None:
        """The unit was switched off and on, or is another one."""
        self._rates.forget()
        self._latencies.forget()
