"""A controller's clock mapping as it is published on the bus and recorded in a job's report."""

from collections.abc import Iterable

from adapters.controller.state.armed_step import PastStep
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.rate import CrystalRate
from orchestrator.model.state import ClockMapping, LearnedCrystal, LearnedStart


def clock_mapping(controller: str, mapping: TickMapping, now_ns: int) -> ClockMapping:
    """Return the bus form of a mapping. It is valid until its bound has grown by one tick."""
    return ClockMapping(
        controller=controller,
        ticks_at=mapping.ticks_at,
        host_at_ns=mapping.host_at_ns,
        tick_ns=mapping.tick_ns,
        rate_ppm=mapping.rate_ppm,
        residual_ns=mapping.residual_ns,
        bound_ns=mapping.bound_ns,
        drift_ppm=mapping.drift_ppm,
        age_ns=max(0, now_ns - mapping.host_at_ns),
        samples=mapping.samples,
        consistent=mapping.consistent,
        min_rtt_ns=mapping.min_rtt_ns,
        valid_until_ns=mapping.host_at_ns + round(1e6 / mapping.drift_ppm * mapping.tick_ns),
    )


def learned_crystal(rate: CrystalRate, now_ns: int) -> LearnedCrystal:
    """Return the bus form of a learned crystal, with its present uncertainty."""
    return LearnedCrystal(
        rate_ppm=rate.rate_ppm,
        bound_ppm=rate.bound_ppm(now_ns, 0.0),
        error_ppm=rate.error_ppm,
        residual_ppm=rate.residual_ppm,
        moves=rate.moves,
        consistent=rate.consistent,
    )


def learned_starts(latency: StartLatency, past_steps: Iterable[PastStep], now_ns: int) -> list[LearnedStart]:
    """Return the bus form of the starts that widen the bounds of a start, with what is left of each and its step."""
    # A start is learned at the end of its step, before another one begins.
    steps = list(past_steps)
    starts: list[LearnedStart] = []
    for start in latency.unusual:
        step = next((step for step in steps if step.t0_ns <= start.at_ns <= step.ended_ns), None)
        starts.append(
            LearnedStart(
                outside_ns=start.outside_ns,
                age_ns=now_ns - start.at_ns,
                remaining_ns=round(start.remaining_ns(now_ns)),
                job="" if step is None else step.job,
                step=None if step is None else step.step,
            )
        )
    return starts
