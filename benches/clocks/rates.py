"""The accuracy of learned crystal rates and start latencies of controllers without a readable clock: over modelled
links.

A trial is one controller that makes a hundred moves. The adapter's observations of each start and end are drawn from
a model of its link and firmware; the rate and the start latency are compared with the true values of crystal and
firmware. For comparison, the two methods without an estimator: the nominal rate of the crystal, and the mean of the
measurements; for starts, the declared latency, and the mean of the acknowledgements.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import floor
from random import Random
from typing import NamedTuple

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.timed import TimedMove
from orchestrator.runtime.simulated_fleets import DRIFT_PPM, HOLD_MS, PP_SPREAD_MS, WANDER_PPM
from sim.core.oscillator import Oscillator

MOVES = (1, 5, 20, 100)
SHORTEST_S, LONGEST_S = 5.0, 60.0
PAUSES_S = (1.0, 10.0)
REACH_PPM = 100.0
POLL_NS = 100 * NS_PER_MS
RAMP_S = 0.5


@dataclass(frozen=True, slots=True)
class RateCase:
    """A controller on its link.

    char_ns: a character. Each direction takes way_ns and up to jitter_ns more; replies are delayed by up to hold_ns.
    A command takes effect, and is answered, decode_ns, plus up to spread_ns, after its end; quick_ns of that are
    known.
    declared: the start latency.
    asked_behind: a start, or a position, shows in the reply to a second query after the first.
    line: it reports the end of a move.
    positions: it reports them in motion, at `speed` counts/s.
    ask_characters, answer_characters: of a query, and of its reply."""

    name: str
    char_ns: int
    decode_ns: int
    spread_ns: int
    declared: StartLatency
    way_ns: int = 20 * NS_PER_US
    jitter_ns: int = 80 * NS_PER_US
    hold_ns: int = 0
    quick_ns: int = 0
    asked_behind: bool = False
    line: bool = False
    positions: bool = True
    speed: float = 5000.0
    ask_characters: int = 4
    answer_characters: int = 3


def _make_declared(usual_us: int, spread_us: int) -> StartLatency:
    jitter_us = 1000  # of the serial line, in the options of all makes
    return StartLatency(
        usual_us * NS_PER_US, (usual_us - spread_us) * NS_PER_US, (usual_us + spread_us + jitter_us) * NS_PER_US
    )


_HELD_NS = round(HOLD_MS * NS_PER_MS)
STAGE = RateCase(
    "SHRC-203, 38,400 baud",
    260_417,
    NS_PER_MS,
    800 * NS_PER_US,
    _make_declared(1000, 1000),
    line=True,
    ask_characters=6,
)
STEPS = RateCase(
    "SMC30, 9,600 baud", 1_041_667, NS_PER_MS, 200 * NS_PER_US, _make_declared(1000, 1000), positions=False
)
PP = RateCase(
    "pp SMC, TCP",
    0,
    5 * NS_PER_MS,
    round(PP_SPREAD_MS * NS_PER_MS),
    _make_declared(12_500, 7_500),
    way_ns=100 * NS_PER_US,
    jitter_ns=100 * NS_PER_US,
    quick_ns=5 * NS_PER_MS,
    asked_behind=True,
)
CASES = (
    STAGE,
    replace(STAGE, name="SHRC-203, USB holds 0 to 16 ms", hold_ns=_HELD_NS),
    STEPS,
    replace(STEPS, name="SMC30, USB holds 0 to 16 ms", hold_ns=_HELD_NS),
    replace(STEPS, name="SMC30 that tells where it is, USB", hold_ns=_HELD_NS, positions=True),
    PP,
)


class RateFigures(NamedTuple):
    """Errors of the rate of the next minute after `moves` moves, ppm.

    nominal, mean: p95 of the two other methods.
    bound: guaranteed, its median.
    misses: rates outside it."""

    link: str
    moves: int
    trials: int
    p50_ppm: float
    p95_ppm: float
    max_ppm: float
    bound_ppm: float
    misses: int
    nominal_ppm: float
    mean_ppm: float


class StartFigures(NamedTuple):
    """Distance of the instant that starts are aimed at from the middle of the firmware's and link's delays, µs,
    after `moves` starts; and p95 of the two other methods. misses: starts outside the guarantee."""

    link: str
    moves: int
    trials: int
    p50_us: float
    p95_us: float
    max_us: float
    misses: int
    declared_us: float
    mean_us: float


def bench_rates(trials: int, seed: int = 1) -> tuple[list[RateFigures], list[StartFigures]]:
    """Run all links: the estimates after each of MOVES."""
    rates: list[RateFigures] = []
    starts: list[StartFigures] = []
    for case in CASES:
        results = [_run_trial(case, Random(f"{seed} {case.name} {trial}"), trial) for trial in range(trials)]
        for number, moves in enumerate(MOVES):
            at = [trial[number] for trial in results]
            rates.append(_make_rate_figures(case.name, moves, at))
            starts.append(_make_start_figures(case.name, moves, at))
    return rates, starts


class _RateTrial(NamedTuple):
    """The estimates after some moves. rate, start: errors of the estimate, of the assumed value, and of the mean."""

    rate: tuple[float, float, float]
    bound_ppm: float
    start: tuple[float, float, float]
    outside: bool


def _run_trial(case: RateCase, draw: Random, number: int) -> list[_RateTrial]:
    crystal = Oscillator(0, draw.uniform(-DRIFT_PPM, DRIFT_PPM), WANDER_PPM, number)
    learned_clock = InferredClock(0.0, REACH_PPM, case.declared)
    rates_ppm: list[float] = []
    delays_ns: list[int] = []
    known_trials: list[_RateTrial] = []
    now_ns = NS_PER_S
    is_outside = False
    for count in range(1, MOVES[-1] + 1):
        arrived_ns = now_ns + round(draw.uniform(*PAUSES_S) * NS_PER_S)
        duration_s = draw.uniform(SHORTEST_S, LONGEST_S)
        promised_latency = learned_clock.start_latency_at(now_ns)
        started_ns = arrived_ns + _draw_latency_ns(case, draw) + _draw_decoding_ns(case, draw)
        is_outside = (
            is_outside or not promised_latency.earliest_ns <= started_ns - arrived_ns <= promised_latency.latest_ns
        )
        move, now_ns = _simulate_observations(case, draw, crystal, (arrived_ns, started_ns), duration_s)
        learned_clock.learn_from_move(move, arrived_ns, None if case.asked_behind else move.started_ns[1], now_ns)
        heard_ns = move.started_ns[1]
        rates_ppm.append((duration_s * NS_PER_S / (now_ns - heard_ns) - 1) * 1e6)
        delays_ns.append(heard_ns - arrived_ns)
        if count in MOVES:
            known_trials.append(
                _compare_estimates(
                    case, learned_clock, crystal, now_ns, (_compute_mean(rates_ppm), _compute_mean(delays_ns))
                )._replace(outside=is_outside)
            )
    return known_trials


def _compare_estimates(
    case: RateCase, learned: InferredClock, crystal: Oscillator, now_ns: int, means: tuple[float, float]
) -> _RateTrial:
    """Compare estimates with the truth. means: of the measured rates, and of the acknowledgements."""
    ahead_ns = round(LONGEST_S * NS_PER_S)
    true_ppm = ((crystal.device_ns(now_ns + ahead_ns) - crystal.device_ns(now_ns)) / ahead_ns - 1) * 1e6
    middle_ns = case.decode_ns + case.spread_ns / 2 + case.way_ns + case.jitter_ns / 2
    usual, declaration, mean = (
        abs(duration_ns - middle_ns) / NS_PER_US
        for duration_ns in (learned.start_latency_at(now_ns).usual_ns, case.declared.usual_ns, means[1])
    )
    return _RateTrial(
        rate=(abs(learned.crystal_rate.rate_ppm - true_ppm), abs(true_ppm), abs(means[0] - true_ppm)),
        bound_ppm=learned.crystal_rate.bound_ppm(now_ns, LONGEST_S),
        start=(usual, declaration, mean),
        outside=False,
    )


def _simulate_observations(
    case: RateCase, draw: Random, crystal: Oscillator, times_ns: tuple[int, int], duration_s: float
) -> tuple[TimedMove, int]:
    """Simulate the adapter's observations of a move; return also the instant of the last one. times_ns: when the
    start command was at the controller's end of the line, and when the motion started."""
    arrived_ns, started_ns = times_ns
    heard_ns = started_ns + _draw_reply_ns(case, draw) - case.quick_ns
    if case.asked_behind:
        heard_ns += _draw_decoding_ns(case, draw)
    move = TimedMove(duration_s, _make_legs(case, duration_s), (arrived_ns + case.quick_ns, heard_ns))
    began_ns = crystal.device_ns(started_ns)
    end_ns = crystal.true_ns(began_ns + round(duration_s * NS_PER_S))
    asked_ns = heard_ns
    # Some queries from the start on, and consecutive ones from before the fastest crystal's end.
    near_ns = round(started_ns + duration_s * NS_PER_S * (1 - REACH_PPM * 1e-6)) - move.end_poll_lead_ns
    while True:
        arrives_ns = asked_ns + case.ask_characters * case.char_ns
        looked_ns = arrives_ns + _draw_latency_ns(case, draw) + _draw_decoding_ns(case, draw)
        answer_ns = looked_ns + (_draw_decoding_ns(case, draw) if case.asked_behind else 0) + _draw_reply_ns(case, draw)
        told_ns = answer_ns - case.quick_ns
        if looked_ns > end_ns:
            break
        move.mark_moving(arrives_ns)
        if case.positions and asked_ns < near_ns:
            way = case.speed * ((crystal.device_ns(looked_ns) - began_ns) / NS_PER_S - RAMP_S / 2)
            move.add_position(floor(way), 1.0, arrives_ns, told_ns)
        asked_ns = answer_ns + case.answer_characters * case.char_ns
        asked_ns = max(asked_ns, min(near_ns, asked_ns + POLL_NS))
    if case.line:
        told_ns = min(told_ns, end_ns + _draw_reply_ns(case, draw))
    move.mark_ended(told_ns)
    return move, told_ns


def _make_legs(case: RateCase, duration_s: float) -> tuple[tuple[float, float, float], ...]:
    steep = case.speed / RAMP_S
    return (RAMP_S, 0.0, steep), (duration_s - 2 * RAMP_S, case.speed, 0.0), (RAMP_S, case.speed, -steep)


def _draw_latency_ns(case: RateCase, draw: Random) -> int:
    return case.way_ns + draw.randrange(case.jitter_ns)


def _draw_reply_ns(case: RateCase, draw: Random) -> int:
    return _draw_latency_ns(case, draw) + draw.randrange(case.hold_ns + 1)


def _draw_decoding_ns(case: RateCase, draw: Random) -> int:
    return case.decode_ns + draw.randrange(case.spread_ns)


def _make_rate_figures(link: str, moves: int, at: Sequence[_RateTrial]) -> RateFigures:
    errors, nominal, mean = (sorted(trial.rate[k] for trial in at) for k in range(3))
    return RateFigures(
        link=link,
        moves=moves,
        trials=len(at),
        p50_ppm=round(_percentile(errors, 0.5), 2),
        p95_ppm=round(_percentile(errors, 0.95), 2),
        max_ppm=round(errors[-1], 2),
        bound_ppm=round(_percentile(sorted(trial.bound_ppm for trial in at), 0.5), 1),
        misses=sum(trial.rate[0] > trial.bound_ppm for trial in at),
        nominal_ppm=round(_percentile(nominal, 0.95), 1),
        mean_ppm=round(_percentile(mean, 0.95), 1),
    )


def _make_start_figures(link: str, moves: int, at: Sequence[_RateTrial]) -> StartFigures:
    errors, declarations, mean = (sorted(trial.start[k] for trial in at) for k in range(3))
    return StartFigures(
        link=link,
        moves=moves,
        trials=len(at),
        p50_us=round(_percentile(errors, 0.5)),
        p95_us=round(_percentile(errors, 0.95)),
        max_us=round(errors[-1]),
        misses=sum(trial.outside for trial in at),
        declared_us=round(_percentile(declarations, 0.95)),
        mean_us=round(_percentile(mean, 0.95)),
    )


def _compute_mean(values: Sequence[float]) -> float:
    return sum(values) / len(values)


def _percentile(ordered: Sequence[float], share: float) -> float:
    """Percentile by nearest rank."""
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]
