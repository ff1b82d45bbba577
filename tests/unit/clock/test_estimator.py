"""The clock estimate: its bound contains the truth for any crystal, and a reset is noticed."""

from collections.abc import Callable
from random import Random

import numpy as np
import pytest

from orchestrator.clock.estimator import CounterSample, TickEstimator, upper_hull
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
        assert estimator.add_sample(CounterSample(now_ns, received_ns, int(crystal.device_ns(taken_ns) // TICK_NS)))
    return estimator, crystal, now_ns


@pytest.mark.parametrize("hold_ns", [0, 16_000_000])
def test_the_bound_contains_the_truth(hold_ns: int) -> None:
    for seed in range(150):
        estimator, crystal, now_ns = learn(seed, 1 + seed * 2, hold_ns)
        mapping = estimator.compute_mapping()
        assert mapping is not None
        fire_ns = now_ns + 700_000_000
        tick = int(crystal.device_ns(fire_ns) // TICK_NS)
        error_ns = mapping.to_host_ns(tick) - crystal.true_ns(round(tick * TICK_NS))
        assert abs(error_ns) <= mapping.bound_at_ns(fire_ns)
        # Honest, and not for nothing: half a round trip and half a tick, and some drift.
        if not hold_ns and seed > 10:
            assert mapping.bound_at_ns(fire_ns) < 1_000_000


def test_a_reset_counter_is_noticed_and_estimated_again() -> None:
    estimator, _, now_ns = learn(1, 50)
    assert not estimator.add_sample(CounterSample(now_ns + 10**8, now_ns + 10**8 + 10**6, 5))
    mapping = estimator.compute_mapping()
    assert mapping is not None
    assert mapping.samples == 1


def learnt(
    crystal: Oscillator,
    draw: Random,
    count: int,
    way_ns: Callable[[int, Random], tuple[int, int]],
    every_ns: int = 200_000_000,
) -> tuple[TickEstimator, int]:
    """An estimator with `count` readings over a link; way_ns: the request's and the reply's time, by reading."""
    estimator, now_ns = TickEstimator(TICK_NS), 10**10
    for k in range(count):
        now_ns += every_ns + draw.randrange(5_000_000)
        there_ns, back_ns = way_ns(k, draw)
        ticks = int(crystal.device_ns(now_ns + there_ns) // TICK_NS)
        assert estimator.add_sample(CounterSample(now_ns, now_ns + there_ns + back_ns, ticks))
    return estimator, now_ns


def error_and_bound(estimator: TickEstimator, crystal: Oscillator, at_ns: int) -> tuple[int, int]:
    mapping = estimator.compute_mapping()
    assert mapping is not None
    tick = int(crystal.device_ns(at_ns) // TICK_NS)
    return abs(mapping.to_host_ns(tick) - crystal.true_ns(round(tick * TICK_NS))), mapping.bound_at_ns(at_ns)


WAYS: dict[str, Callable[[int, Random], tuple[int, int]]] = {
    "symmetric": lambda _, draw: (100_000 + draw.randrange(50_000), 100_000 + draw.randrange(50_000)),
    "slow requests, which nobody sees": lambda _, draw: (3_000_000 + draw.randrange(50_000), 100_000),
    "replies that are held back": lambda _, draw: (100_000, 100_000 + draw.randrange(16_000_000)),
    "replies that are always held back": lambda _, draw: (100_000, 16_100_000 + draw.randrange(1000)),
    "a link that becomes slow": lambda k, draw: (100_000 + (k > 100) * 9_000_000, 100_000 + draw.randrange(50_000)),
    "retries": lambda _, draw: (100_000, 100_000 + (draw.random() < 0.05) * 200_000_000),
}


@pytest.mark.parametrize("name", WAYS)
@pytest.mark.parametrize("count", [1, 2, 7, 40, 300])
def test_the_bound_holds_over_every_link(name: str, count: int) -> None:
    for seed in range(12):
        draw = Random(f"{name} {count} {seed}")
        crystal = Oscillator(draw.randrange(10**12), draw.uniform(-90, 90), 0.05, seed)
        estimator, now_ns = learnt(crystal, draw, count, WAYS[name])
        for ahead_ns in (0, 10**9, 20 * 10**9):
            error_ns, bound_ns = error_and_bound(estimator, crystal, now_ns + ahead_ns)
            assert error_ns <= bound_ns
        mapping = estimator.compute_mapping()
        assert mapping is not None and mapping.consistent


@pytest.mark.parametrize("ago_s", [0, 4, 15, 40])
def test_an_instant_in_the_past_is_known_as_well_as_the_present(ago_s: int) -> None:
    for seed in range(20):
        draw = Random(f"past {seed}")
        crystal = Oscillator(draw.randrange(10**12), draw.uniform(-90, 90), 0.05, seed)
        estimator, now_ns = learnt(crystal, draw, 300, WAYS["symmetric"])
        at_ns = now_ns - ago_s * 10**9
        tick = int(crystal.device_ns(at_ns) // TICK_NS)
        near, present = estimator.compute_mapping(tick), estimator.compute_mapping()
        assert near is not None and present is not None
        assert abs(near.to_host_ns(tick) - crystal.true_ns(round(tick * TICK_NS))) <= near.bound_at_ns(at_ns)
        assert near.bound_at_ns(at_ns) <= present.bound_at_ns(at_ns) + 1000
        assert near.bound_at_ns(at_ns) < present.bound_at_ns(now_ns) + 20_000


def test_a_crystal_beyond_the_model_is_reported_and_the_last_reading_is_still_used() -> None:
    draw = Random(3)
    crystal = Oscillator(5, 400.0)
    estimator, now_ns = learnt(crystal, draw, 200, WAYS["symmetric"])
    mapping = estimator.compute_mapping()
    assert mapping is not None and not mapping.consistent
    error_ns, bound_ns = error_and_bound(estimator, crystal, now_ns)
    assert error_ns <= bound_ns


def test_a_clock_that_is_set_forward_is_estimated_again() -> None:
    draw = Random(4)
    crystal = Oscillator(5, 20.0)
    estimator, now_ns = learnt(crystal, draw, 100, WAYS["symmetric"])
    jump = round(2e9 / TICK_NS)
    at_ns = now_ns + 10**8
    assert not estimator.add_sample(
        CounterSample(at_ns, at_ns + 200_000, int(crystal.device_ns(at_ns) // TICK_NS) + jump)
    )
    mapping = estimator.compute_mapping()
    assert mapping is not None and mapping.samples == 1
    # With one reading the rate is unknown, and that is reported.
    assert mapping.drift_ppm >= 100


def test_a_host_that_slept_widens_the_bound_of_its_old_readings() -> None:
    """Its raw clock continues; the crystal may have drifted meanwhile."""
    draw = Random(5)
    crystal = Oscillator(5, 20.0, 0.05, 5)
    estimator, now_ns = learnt(crystal, draw, 200, WAYS["symmetric"])
    before = estimator.compute_mapping()
    woken_ns = now_ns + 3600 * 10**9
    assert estimator.add_sample(
        CounterSample(woken_ns, woken_ns + 250_000, int(crystal.device_ns(woken_ns + 120_000) // TICK_NS))
    )
    mapping = estimator.compute_mapping()
    assert before is not None and mapping is not None and mapping.consistent
    error_ns, bound_ns = error_and_bound(estimator, crystal, woken_ns + 10**9)
    assert error_ns <= bound_ns
    assert mapping.bound_ns > before.bound_ns


@pytest.mark.parametrize("seed", range(5))
def test_the_gates_that_are_checked_decide_as_all_of_them_would(seed: int) -> None:
    rng = Random(seed)
    ages = np.sort(np.array([-rng.choice([rng.uniform(0, 3e11), rng.randrange(300) * 1e9]) for _ in range(200)]))
    values = np.array([rng.gauss(0, 1e5) for _ in ages]) - np.abs(ages) ** 1.5 * 1e-12
    hull = upper_hull(ages, values)
    assert len(hull) < len(ages) / 4
    for rate in np.linspace(-1e-4, 1e-4, 101):
        assert (values[hull] - rate * ages[hull]).max() == (values - rate * ages).max()
