"""The clock estimate: its bound holds the truth, whatever the crystal, and a reset is noticed."""

from random import Random

import pytest

from orchestrator.clock.estimator import Sample, TickEstimator
from sim.core.oscillator import Oscillator

TICK_NS = 1e9 / 1024


def learn(seed: int, count: int, hold_ns: int = 0) -> tuple[TickEstimator, Oscillator, int]:
    draw = Random(seed)
    crystal = Oscillator(draw.randrange(10**12), draw.uniform(-50, 50), 0.05, seed)
    estimator, now_ns = TickEstimator(TICK_NS), 10**10
    for _ in range(count):
        now_ns += 100_000_000 + draw.randrange(5_000_000)
        taken_ns = now_ns + 600_000 + draw.randrange(100_000)
        received_ns = taken_ns + 100_000 + draw.randrange(100_000) + (draw.randrange(hold_ns) if hold_ns else 0)
        assert estimator.add(Sample(now_ns, received_ns, int(crystal.device_ns(taken_ns) // TICK_NS)))
    return estimator, crystal, now_ns


@pytest.mark.parametrize("hold_ns", [0, 16_000_000])
def test_the_bound_holds_the_truth(hold_ns: int) -> None:
    for seed in range(150):
        estimator, crystal, now_ns = learn(seed, 1 + seed * 2, hold_ns)
        mapping = estimator.mapping()
        assert mapping is not None
        fire_ns = now_ns + 700_000_000
        tick = int(crystal.device_ns(fire_ns) // TICK_NS)
        error_ns = mapping.host_ns(tick) - crystal.true_ns(round(tick * TICK_NS))
        assert abs(error_ns) <= mapping.bound_at_ns(fire_ns)
        # Honest, and not for nothing: half a round trip and half a tick, and some drift.
        if not hold_ns and seed > 10:
            assert mapping.bound_at_ns(fire_ns) < 1_000_000


def test_a_reset_counter_is_noticed_and_learned_anew() -> None:
    estimator, _, now_ns = learn(1, 50)
    assert not estimator.add(Sample(now_ns + 10**8, now_ns + 10**8 + 10**6, 5))
    mapping = estimator.mapping()
    assert mapping is not None
    assert mapping.samples == 1
