"""Crystals and starts estimated from observed moves; the ground truth is a simulated crystal."""

from dataclasses import replace
from random import Random

import pytest

from benches.clocks.rates import CASES, bench_rates
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.latency import MAX_STARTS, LatencyEstimator, StartLatency
from orchestrator.clock.rate import RateEstimator, RateGate, RateMeasurement
from orchestrator.clock.timed import TimedMove
from sim.core.oscillator import Oscillator

START = StartLatency(NS_PER_MS, 0, 3 * NS_PER_MS)
SPEED, RAMP_S = 5000.0, 0.5


def made(
    crystal: Oscillator, begin_ns: int, duration_s: float, draw: Random, held_ns: int = 0, told: bool = True
) -> TimedMove:
    """A move as observed by an adapter: answers take up to a millisecond each way, and are delayed by up to
    `held_ns`."""

    def way_ns() -> int:
        return draw.randrange(NS_PER_MS)

    def back_ns() -> int:
        return way_ns() + draw.randrange(held_ns + 1)

    began_ns = crystal.device_ns(begin_ns)
    end_ns = crystal.true_ns(began_ns + round(duration_s * NS_PER_S))
    legs = ((RAMP_S, 0.0, SPEED / RAMP_S), (duration_s - 2 * RAMP_S, SPEED, 0.0), (RAMP_S, SPEED, -SPEED / RAMP_S))
    move = TimedMove(duration_s, legs, (begin_ns - way_ns(), begin_ns + back_ns()))
    at_ns = begin_ns + NS_PER_S
    while told and at_ns < end_ns - NS_PER_S:
        way = SPEED * ((crystal.device_ns(at_ns) - began_ns) / NS_PER_S - RAMP_S / 2)
        move.add_position(int(way), 1.0, at_ns - way_ns(), at_ns + back_ns())
        at_ns += 100 * NS_PER_MS
    move.mark_moving(end_ns - draw.randrange(1, 5 * NS_PER_MS))
    move.mark_ended(end_ns + back_ns())
    return move


def mean_ppm(crystal: Oscillator, begin_ns: int, seconds: int) -> float:
    length_ns = seconds * NS_PER_S
    return ((crystal.device_ns(begin_ns + length_ns) - crystal.device_ns(begin_ns)) / length_ns - 1) * 1e6


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("told", [True, False])
def test_bounds_contain_the_truth_and_the_rate_comes_near_to_it(seed: int, told: bool) -> None:
    draw = Random(seed)
    crystal = Oscillator(0, draw.uniform(-60, 60), 0.05, seed)
    clock, now_ns, widths = InferredClock(0.0, 100.0, START), NS_PER_S, list[float]()
    for _ in range(12):
        begin_ns, duration_s = now_ns + draw.randrange(20 * NS_PER_S), draw.uniform(10, 60)
        move = made(crystal, begin_ns, duration_s, draw, held_ns=draw.choice([0, 16 * NS_PER_MS]), told=told)
        now_ns = begin_ns + round(duration_s * NS_PER_S * 1.001)
        clock.learn_from_move(move, begin_ns - NS_PER_MS, None, now_ns)
        low, high = clock.crystal_rate.range_ppm(now_ns, 60.0)
        assert clock.crystal_rate.consistent and low <= mean_ppm(crystal, now_ns, 60) <= high
        least_ns, most_ns = clock.crystal_rate.host_duration_ns(duration_s, now_ns)
        end_ns = crystal.true_ns(crystal.device_ns(begin_ns) + round(duration_s * NS_PER_S))
        assert least_ns <= end_ns - begin_ns <= most_ns
        earliest_ns, latest_ns = move.start_interval_ns(clock.crystal_rate, now_ns)
        assert earliest_ns <= begin_ns <= latest_ns
        widths.append(high - low)
    assert widths[-1] < 130
    assert abs(clock.crystal_rate.rate_ppm - mean_ppm(crystal, now_ns, 60)) < (4 if told else 45)


def test_a_delayed_end_widens_the_interval_and_does_not_move_it() -> None:
    """The completion line comes 50 ms late: on the slow side the move gives no more information, and no false one."""
    crystal, draw = Oscillator(0, 30.0), Random(1)
    clock = InferredClock(0.0, 100.0, START)
    for number in range(5):
        move = made(crystal, (1 + 100 * number) * NS_PER_S, 60.0, draw, told=False)
        clock.learn_from_move(move, (1 + 100 * number) * NS_PER_S, None, (62 + 100 * number) * NS_PER_S)
    before = clock.crystal_rate
    late = made(crystal, 601 * NS_PER_S, 60.0, draw, told=False)
    late.mark_ended(661 * NS_PER_S + 50 * NS_PER_MS)
    clock.learn_from_move(late, 601 * NS_PER_S, None, 662 * NS_PER_S)
    assert clock.crystal_rate.consistent and clock.crystal_rate.low_ppm <= 30.0 <= clock.crystal_rate.high_ppm
    assert abs(clock.crystal_rate.rate_ppm - before.rate_ppm) < 5


def test_a_crystal_that_jumps_is_noticed_and_estimated_again() -> None:
    draw = Random(3)
    crystal, clock, now_ns = Oscillator(0, 40.0, 0.001, 3), InferredClock(0.0, 100.0, START), NS_PER_S
    said: list[bool] = []
    for number in range(12):
        if number == 6:
            crystal.change_rate(-90.0)
        move = made(crystal, now_ns, 60.0, draw)
        now_ns += 62 * NS_PER_S
        clock.learn_from_move(move, now_ns, None, now_ns)
        said.append(clock.crystal_rate.consistent)
    assert said[:6] == [True] * 6 and False in said[6:8] and said[8:] == [True] * 4
    assert (
        clock.crystal_rate.low_ppm <= -50.0 <= clock.crystal_rate.high_ppm and abs(clock.crystal_rate.rate_ppm + 50) < 5
    )


def test_a_measurement_that_contradicts_the_assumption_does_not_replace_it() -> None:
    rates = RateEstimator(10.0, 100.0)
    assert rates.add_move([], [], 5)
    assert not rates.add_move(
        [RateGate(150.0, 160.0, NS_PER_S, 1.0)], [RateMeasurement(155.0, 1.0, NS_PER_S)], NS_PER_S
    )
    assert (rates.rate.rate_ppm, rates.rate.range_ppm(NS_PER_S, 1.0)) == (10.0, (-90.0, 110.0))
    assert not rates.rate.consistent
    assert rates.add_move([RateGate(20.0, 30.0, 2 * NS_PER_S, 1.0)], [], 2 * NS_PER_S)
    assert rates.rate.consistent and rates.rate.rate_ppm == pytest.approx(25.0)


def test_the_measured_rate_loses_precision_with_time_but_never_beyond_the_assumption() -> None:
    rates = RateEstimator(0.0, 100.0)
    rates.add_move([RateGate(20.0, 22.0, 0, 1.0)], [], 0)
    bounds = [rates.rate.bound_ppm(age_s * NS_PER_S, 10.0) for age_s in (0, 10, 1000, 10**8)]
    assert bounds == sorted(bounds) and bounds[0] < 3 and bounds[-1] == pytest.approx(121)
    rates.discard_moves()
    assert rates.rate == RateEstimator(0.0, 100.0).rate


def test_the_mean_start_latency_is_estimated_if_no_answer_is_delayed() -> None:
    draw, prompt, held = Random(4), LatencyEstimator(START), LatencyEstimator(START)
    for _ in range(30):
        start_ns = round(draw.uniform(1.4, 2.2) * NS_PER_MS)
        prompt.add_start(0, start_ns + 50 * NS_PER_US, start_ns + 50 * NS_PER_US, 0)
        answered_ns = start_ns + draw.randrange(16 * NS_PER_MS)
        held.add_start(0, answered_ns, answered_ns, 0)
    assert abs(prompt.latency_at(0).usual_ns - 1.85 * NS_PER_MS) < 0.15 * NS_PER_MS
    assert held.latency_at(0) == replace(START, starts=30)


def test_the_second_start_outside_the_promise_widens_it_for_as_long_as_it_is_kept() -> None:
    starts = LatencyEstimator(START)
    for each_ms, promised_ms in ((180, None), (4, 4), (5, 5)):
        starts.add_start(each_ms * NS_PER_MS, (each_ms + 1) * NS_PER_MS, None, 0)
        latest_ns = START.latest_ns if promised_ms is None else promised_ms * NS_PER_MS
        assert (starts.latency_at(0).earliest_ns, starts.latency_at(0).latest_ns) == (START.earliest_ns, latest_ns)
    for _ in range(MAX_STARTS - 2):
        starts.add_start(NS_PER_MS, 2 * NS_PER_MS, None, 0)
    # The one late start has expired: one of the others is left.
    assert starts.latency_at(0).latest_ns == 4 * NS_PER_MS
    starts.add_start(NS_PER_MS, 2 * NS_PER_MS, None, 0)
    assert starts.latency_at(0).latest_ns == START.latest_ns


def test_starts_before_the_promise_widen_it_as_well() -> None:
    starts = LatencyEstimator(START)
    for _ in range(2):
        assert starts.latency_at(0).earliest_ns == START.earliest_ns
        starts.add_start(-3 * NS_PER_MS, -2 * NS_PER_MS, None, 0)
    assert starts.latency_at(0).earliest_ns == -2 * NS_PER_MS


def test_what_unusual_starts_have_added_shrinks_with_time_and_can_be_forgotten() -> None:
    """Refused jobs make no starts that could show that the controller is punctual again."""
    starts = LatencyEstimator(START)
    for at_s in (10, 40):
        starts.add_start(START.latest_ns + 8 * NS_PER_MS, START.latest_ns + 9 * NS_PER_MS, None, at_s * NS_PER_S)
    widths = [starts.latency_at(at_s * NS_PER_S).learned_late_ns for at_s in (40, 100, 160, 309, 310, 1000)]
    assert widths[0] == pytest.approx(8 * NS_PER_MS * 0.9) and widths[2] == pytest.approx(8 * NS_PER_MS * 0.5)
    assert widths == sorted(widths, reverse=True) and widths[3] > 0 and widths[4:] == [0, 0]
    now = starts.latency_at(100 * NS_PER_S)
    assert [each.at_ns // NS_PER_S for each in now.unusual] == [10, 40]
    assert now.latest_ns == START.latest_ns + now.learned_late_ns
    starts.discard_starts()
    assert starts.latency_at(100 * NS_PER_S) == START


def test_a_start_that_the_host_has_given_late_shows_nothing_about_the_controller() -> None:
    crystal, clock, now_ns = Oscillator(0, 0.0, 0.0, 3), InferredClock(0.0, 100.0, START), NS_PER_S
    for host_late_ns, starts in ((5 * NS_PER_MS, 0), (0, 1)):
        begin_ns = now_ns + NS_PER_S
        now_ns = begin_ns + 10 * NS_PER_S
        move = made(crystal, begin_ns, 9.0, Random(1))
        clock.learn_from_move(move, begin_ns - NS_PER_MS, None, now_ns, host_late_ns)
        assert clock.start_latency_at(now_ns).starts == starts


def test_figures_of_the_benchmark() -> None:
    rates, starts = bench_rates(1, seed=5)
    assert len(rates) == len(starts) == 4 * len(CASES)
    assert not any(each.misses for each in (*rates, *starts))
    told = [each for each in rates if each.moves >= 5 and "SHRC" in each.link]
    assert all(each.max_ppm < 3 for each in told)
