"""The smallest possible start skew, p99: with perfect clocks and links, only phases, crystals and firmware remain.

No method can do better with these models; a fleet close to it cannot gain from better clocks.
"""

from collections.abc import Callable

import numpy as np

from orchestrator.runtime.simulated_fleets import DRIFT_PPM

DRAWS = 100_000

Bound = Callable[[], float]


def bound_of_ticks(count: int, tick_ms: float) -> Bound:
    """`count` controllers that begin at ticks of random phase, commanded just after the largest gap."""

    def compute_p99() -> float:
        phases = np.sort(np.random.default_rng(count).random((DRAWS, count)), axis=1)
        gaps = np.diff(phases, axis=1, append=phases[:, :1] + 1.0)
        return float(np.quantile(1.0 - gaps.max(axis=1), 0.99)) * tick_ms

    return compute_p99


def bound_of_drifting_ticks(within_s: float, tick_ms: float) -> Bound:
    """Two controllers that begin at the best instant within that time, while their ticks drift past each other."""

    def compute_p99() -> float:
        draw = np.random.default_rng(2)
        drift_ppm = np.abs(draw.uniform(-DRIFT_PPM, DRIFT_PPM, DRAWS) - draw.uniform(-DRIFT_PPM, DRIFT_PPM, DRAWS))
        come_ms = drift_ppm * 1e-3 * within_s
        apart_ms = draw.random(DRAWS) * tick_ms
        nearest_ms = np.where(apart_ms <= come_ms, 0.0, np.minimum(apart_ms - come_ms, tick_ms - apart_ms))
        return float(np.quantile(nearest_ms, 0.99))

    return compute_p99


def bound_of_latencies(spread_ms: float) -> Bound:
    """Two controllers that begin immediately on command, each after a uniform random time."""
    # The difference of two uniform values is below x with 1 - (1 - x)²; of the spread.
    return lambda: spread_ms * (1.0 - 0.01**0.5)
