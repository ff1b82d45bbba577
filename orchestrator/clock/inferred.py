"""The clock of a controller that cannot be read: its rate and its start latency, inferred from the moves that it
makes."""

from dataclasses import dataclass

from orchestrator.clock.latency import LatencyEstimator, StartLatency
from orchestrator.clock.rate import MAX_LEAD_S, CrystalRate, RateEstimator
from orchestrator.clock.timed import TimedMove


@dataclass(frozen=True, slots=True)
class ClockEstimate:
    """The estimate of a controller's clock at an instant."""

    rate: CrystalRate
    latency: StartLatency
    now_ns: int

    def bound_ppm(self, duration_s: float) -> float:
        """Return the largest clock error of a move of this duration that is planned now."""
        return self.rate.bound_ppm(self.now_ns, duration_s, MAX_LEAD_S)


class InferredClock:
    """Learns from every move that ended as planned.

    usual_ppm, reach_ppm: assumed rate of the crystal and its tolerance, until moves have been seen.
    declared: assumed start latency, until moves have been seen."""

    def __init__(self, usual_ppm: float, reach_ppm: float, declared: StartLatency) -> None:
        self._rate_estimator = RateEstimator(usual_ppm, reach_ppm)
        self._latency_estimator = LatencyEstimator(declared)

    @property
    def crystal_rate(self) -> CrystalRate:
        """Rate of the crystal against the host's, as of the last move: two compilations between two moves agree."""
        return self._rate_estimator.rate

    def start_latency_at(self, now_ns: int) -> StartLatency:
        """Latency from the end of the start command on the serial line to the start, as it is known at `now_ns`."""
        return self._latency_estimator.latency_at(now_ns)

    def estimate_at(self, now_ns: int) -> ClockEstimate:
        """Return the estimate that profiles are compiled with."""
        return ClockEstimate(self.crystal_rate, self.start_latency_at(now_ns), now_ns)

    def learn_from_move(
        self, move: TimedMove, arrived_ns: int, answered_ns: int | None, now_ns: int, host_late_ns: int = 0
    ) -> None:
        """Learn from a move that has just ended as planned.

        arrived_ns: the earliest instant at which its start command was at the controller.
        answered_ns: the latest instant at which the controller can have begun to send the acknowledgement of the
        start; None for a controller that sends none.
        host_late_ns: how late the start command was written; such a start shows nothing about the latency."""
        if not self._rate_estimator.add_move(move.rate_gates, move.rate_measurements, now_ns):
            return
        if host_late_ns:
            return
        earliest_ns, latest_ns = move.start_interval_ns(self._rate_estimator.rate, now_ns)
        answered_after_ns = None if answered_ns is None else answered_ns - arrived_ns
        self._latency_estimator.add_start(earliest_ns - arrived_ns, latest_ns - arrived_ns, answered_after_ns, now_ns)

    def forget_starts(self) -> None:
        """Forget what was learned about the start latency."""
        self._latency_estimator.discard_starts()

    def discard_moves(self) -> None:
        """Discard what was learned: the controller was switched off and on, or was replaced."""
        self._rate_estimator.discard_moves()
        self._latency_estimator.discard_starts()
