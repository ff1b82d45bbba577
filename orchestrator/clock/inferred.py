"""The clock of a controller that cannot be read: its rate and its start latency, inferred from the moves that it
makes."""

from dataclasses import dataclass

from orchestrator.clock.latency import Latency, LatencyEstimator
from orchestrator.clock.rate import LEAD_S, CrystalRate, RateEstimator
from orchestrator.clock.timed import TimedMove


@dataclass(frozen=True, slots=True)
class KnownClock:
    """The estimate of a controller's clock at an instant."""

    rate: CrystalRate
    latency: Latency
    now_ns: int

    def clock_ppm(self, duration_s: float) -> float:
        """Return the largest clock error of a move of this duration that is planned now."""
        return self.rate.bound_ppm(self.now_ns, duration_s, LEAD_S)


class UnreadClock:
    """Learns from every move that ended as planned.

    usual_ppm, reach_ppm: assumed rate of the crystal and its tolerance, until moves have been seen.
    declared: assumed start latency, until moves have been seen."""

    def __init__(self, usual_ppm: float, reach_ppm: float, declared: Latency) -> None:
        self._rates = RateEstimator(usual_ppm, reach_ppm)
        self._latencies = LatencyEstimator(declared)

    @property
    def rate(self) -> CrystalRate:
        """Rate of the crystal against the host's, as of the last move: two compilations between two moves agree."""
        return self._rates.rate

    @property
    def latency(self) -> Latency:
        """Latency from the end of the start command on the serial line to the start."""
        return self._latencies.latency

    def known(self, now_ns: int) -> KnownClock:
        """Return the estimate that profiles are compiled with."""
        return KnownClock(self.rate, self.latency, now_ns)

    def learn(self, move: TimedMove, arrived_ns: int, answered_ns: int | None, now_ns: int) -> None:
        """Learn from a move that has just ended as planned.

        arrived_ns: the earliest instant at which its start command was at the controller.
        answered_ns: the latest instant at which the controller can have begun to send the acknowledgement of the
        start; None for a controller that sends none."""
        if not self._rates.take(move.gates, move.measures, now_ns):
            return
        earliest_ns, latest_ns = move.start_ns(self._rates.rate, now_ns)
        answered_after_ns = None if answered_ns is None else answered_ns - arrived_ns
        self._latencies.take(earliest_ns - arrived_ns, latest_ns - arrived_ns, answered_after_ns)

    def forget(self) -> None:
        """Discard what was learned: the controller was switched off and on, or was replaced."""
        self._rates.forget()
        self._latencies.forget()
