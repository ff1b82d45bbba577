"""Accuracy of clock predictions: simulated crystals read over modelled links, compared with two estimators without a
bound.

A trial is one controller with a history of samples; then the host instant of one of its ticks, seconds ahead, is
predicted. The ground truth is the crystal itself.
"""

from dataclasses import dataclass, replace
from random import Random
from typing import NamedTuple

from adapters.yaskawa.common.ticks import SampleClock
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.estimator import TickMapping
from sim.core.oscillator import Oscillator

HISTORY_S = 300
READINGS_HZ = 5
AHEAD_NS = 5 * NS_PER_S
DRIFT_PPM = 50.0
WANDER_PPM = 0.05
BEGIN_NS = 100 * NS_PER_S


@dataclass(frozen=True, slots=True)
class ClockCase:
    """A link and a counter.

    Each direction takes latency_ns and up to jitter_ns more, with tail_chance up to tail_ns on top; replies are
    delayed by up to hold_ns. The counter is read decode_ns, plus up to spread_ns, after a request has arrived;
    least_ns of that are known. asked_us: target for the 95th percentile."""

    name: str
    tick_ns: float
    asked_us: float
    latency_ns: int = 100 * NS_PER_US
    jitter_ns: int = 100 * NS_PER_US
    tail_chance: float = 0.001
    tail_ns: int = 5 * NS_PER_MS
    hold_ns: int = 0
    constant_hold: bool = False
    decode_ns: int = 500 * NS_PER_US
    spread_ns: int = 50 * NS_PER_US
    least_ns: int = 250 * NS_PER_US


SAMPLE_NS = 1e9 / 1024
SERIAL = ClockCase("", SAMPLE_NS, 0.0, latency_ns=20 * NS_PER_US, jitter_ns=80 * NS_PER_US, tail_chance=0.0005)
HELD_NS = 16 * NS_PER_MS
CASES = (
    ClockCase("TCP, tick 1 µs", 1000.0, 20.0),
    ClockCase("TCP, tick 0.98 ms", SAMPLE_NS, 60.0),
    replace(SERIAL, name="USB holds 0 to 16 ms", asked_us=300.0, hold_ns=HELD_NS),
    replace(SERIAL, name="USB holds 16 ms always", hold_ns=HELD_NS, constant_hold=True),
)


class ClockFigures(NamedTuple):
    """Errors of predictions, µs.

    bound_us: the guaranteed error, median.
    misses: predictions outside the bound.
    cristian_us, regression_us: 95th percentiles of the smallest round trip at the nominal rate, and of least
    squares."""

    link: str
    trials: int
    p50_us: float
    p95_us: float
    max_us: float
    asked_us: float
    bound_us: float
    misses: int
    cristian_us: float
    regression_us: float


class _ClockReading(NamedTuple):
    sent_ns: int
    received_ns: int
    ticks: int


def bench_clock(trials: int, seed: int = 1) -> list[ClockFigures]:
    """Predict one tick per trial and link, AHEAD_NS after the last of HISTORY_S of samples."""
    return [_measure_case(case, trials, seed) for case in CASES]


def _measure_case(case: ClockCase, trials: int, seed: int) -> ClockFigures:
    errors: list[float] = []
    bounds: list[float] = []
    other_errors: tuple[list[float], list[float]] = ([], [])
    for trial in range(trials):
        draw = Random(f"{seed} {case.name} {trial}")
        crystal = Oscillator(draw.randrange(10**12), draw.uniform(-DRIFT_PPM, DRIFT_PPM), WANDER_PPM, trial)
        readings = _draw_history(case, crystal, draw)
        clock = SampleClock(case.tick_ns, case.decode_ns - case.least_ns)
        for reading in readings:
            clock.add_full_reading(reading.sent_ns, reading.received_ns, reading.ticks)
        mapping = clock.current_mapping()
        assert mapping is not None
        ahead_ns = readings[-1].received_ns + AHEAD_NS
        tick = int(crystal.device_ns(ahead_ns) // case.tick_ns)
        true_ns = crystal.true_ns(round(tick * case.tick_ns))
        errors.append(abs(mapping.to_host_ns(tick) - true_ns) / NS_PER_US)
        bounds.append(mapping.bound_at_ns(ahead_ns) / NS_PER_US)
        for error_list, line in zip(
            other_errors, (_estimate_cristian(readings, case), _estimate_regression(readings, case)), strict=True
        ):
            error_list.append(abs(line.to_host_ns(tick) - true_ns) / NS_PER_US)
    errors_sorted = sorted(errors)
    return ClockFigures(
        link=case.name,
        trials=trials,
        p50_us=round(_percentile(errors_sorted, 0.5), 1),
        p95_us=round(_percentile(errors_sorted, 0.95), 1),
        max_us=round(errors_sorted[-1], 1),
        asked_us=case.asked_us,
        bound_us=round(_percentile(sorted(bounds), 0.5), 1),
        misses=sum(error > bound for error, bound in zip(errors, bounds, strict=True)),
        cristian_us=round(_percentile(sorted(other_errors[0]), 0.95), 1),
        regression_us=round(_percentile(sorted(other_errors[1]), 0.95), 1),
    )


def _draw_history(case: ClockCase, crystal: Oscillator, draw: Random) -> list[_ClockReading]:
    readings: list[_ClockReading] = []
    now_ns = BEGIN_NS
    for _ in range(HISTORY_S * READINGS_HZ):
        now_ns += NS_PER_S // READINGS_HZ + draw.randrange(5 * NS_PER_MS)
        read_ns = now_ns + _draw_latency(case, draw) + case.decode_ns + draw.randrange(case.spread_ns)
        held_ns = case.hold_ns if case.constant_hold else draw.randrange(case.hold_ns + 1)
        ticks = int(crystal.device_ns(read_ns) // case.tick_ns)
        readings.append(_ClockReading(now_ns + case.least_ns, read_ns + _draw_latency(case, draw) + held_ns, ticks))
    return readings


def _draw_latency(case: ClockCase, draw: Random) -> int:
    tail_ns = draw.randrange(case.tail_ns) if draw.random() < case.tail_chance else 0
    return case.latency_ns + draw.randrange(case.jitter_ns) + tail_ns


def _estimate_cristian(readings: list[_ClockReading], case: ClockCase) -> TickMapping:
    """Estimate by the middle of the fastest of the last minute's round trips, at the nominal rate."""
    recent = readings[-60 * READINGS_HZ :]
    best = min(recent, key=lambda reading: reading.received_ns - reading.sent_ns)
    return _make_mapping(best.ticks, (best.sent_ns + best.received_ns - case.tick_ns) / 2, case.tick_ns)


def _estimate_regression(readings: list[_ClockReading], case: ClockCase) -> TickMapping:
    """Estimate by least squares through the middles of the round trips that are at most twice as slow as the
    fastest."""
    least_ns = min(reading.received_ns - reading.sent_ns for reading in readings)
    fast = [reading for reading in readings if reading.received_ns - reading.sent_ns <= 2 * least_ns]
    xs = [float(reading.ticks) for reading in fast]
    ys = [(reading.sent_ns + reading.received_ns - case.tick_ns) / 2 for reading in fast]
    mean_x, mean_y = sum(xs) / len(xs), sum(ys) / len(ys)
    over = sum((x - mean_x) ** 2 for x in xs)
    slope = sum((x - mean_x) * (y - mean_y) for x, y in zip(xs, ys, strict=True)) / over if over else case.tick_ns
    return _make_mapping(round(mean_x), mean_y + (round(mean_x) - mean_x) * slope, slope)


def _make_mapping(ticks: int, host_ns: float, tick_ns: float) -> TickMapping:
    return TickMapping(
        ticks_at=ticks,
        host_at_ns=round(host_ns),
        tick_ns=tick_ns,
        rate_ppm=0.0,
        residual_ns=0,
        bound_ns=0,
        drift_ppm=0.0,
        samples=0,
        min_rtt_ns=0,
    )


def _percentile(ordered: list[float], share: float) -> float:
    """Percentile by nearest rank."""
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]
