"""Random feasible moves of a pp-electronic SMC: as planned, as lowered, and a part of them as executed, in virtual
time.

Its speeds are whole Hz and its ramps whole Hz/ms. From one slew speed V to the next the duration T changes by T/V;
the ramps can compensate V/1000 s at most, with 1 Hz/ms. So every duration is possible where V² is above 1000 T
Hz²/s, and slower moves only in steps: then the next longer duration is proposed, and the step is planned again for
it. Figures are given for all moves together, for these two kinds, and by mean rate.
"""

from typing import Any

from adapters.contract import Driver
from benches.makes.figures import BenchFigure, LoweringChoices, LoweringFigures, make_figure
from benches.makes.random_moves import (
    LoweredMove,
    RandomMoves,
    draw_drift_ppm,
    make_executed_figures,
    run_random_moves,
)
from orchestrator.link.memory import LAN
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

MAKE = "ppsmc"
QUICKEST, ACCELERATION = 100_000.0, 1_000_000.0  # steps/s, of the cruise; steps/s²
CLASSES = ((16.0, 100.0), (100.0, 300.0), (300.0, 1000.0), (1000.0, QUICKEST))  # steps/s, of the mean rate
VERNIER = 1000.0  # Hz²/s, see above
ASKED_P99_MS = 1.0
CONFIG: dict[str, Any] = {
    "adapter": MAKE,
    "link": {"kind": "tcp", "host": "10.0.0.1", "port": 1234},
    "axes": {
        "a": {
            "motors": ["1"],
            "unit": "counts",
            "limits": {"velocity": QUICKEST, "acceleration": ACCELERATION},
            "start_rate": {"min": 1, "max": 2000},
        }
    },
}


def bench_ppsmc(moves: int, seed: int) -> LoweringFigures:
    """Lower `moves` and execute a part of them, with the rate of the controller's crystal known as if measured."""
    options = {"rate_ppm": draw_drift_ppm(seed), "clock_ppm": 1, "decode_us": 750, "decode_spread_us": 250}
    case = RandomMoves(
        config=Controller.model_validate({**CONFIG, "options": options}),
        model=LAN,
        port="tcp",
        simulate={},
        quickest=QUICKEST,
        acceleration=ACCELERATION,
        steps_most=1_000_000,
        compare=_measure_proposal_ms,
    )
    made_moves = run_random_moves(case, moves, seed).moves
    times_ms = [move.lowered_ms for move in made_moves]
    reached_ms = [move.lowered_ms for move in made_moves if _is_reachable(move)]
    slow_ms = [move.lowered_ms for move in made_moves if not _is_reachable(move)]
    again_ms = [move.compared_ms for move in made_moves if move.compared_ms is not None]
    figures = [
        make_figure("all, lowered-planned", times_ms, "ms", "p99<=1", _meets_p99),
        make_figure("V² >= 1000 T, lowered-planned", reached_ms, "ms", "p99<=1", _meets_p99),
        *([make_figure("V² < 1000 T, lowered-planned", slow_ms, "ms")] if slow_ms else []),
        make_figure("all, proposal planned again", again_ms, "ms", "p99<=1", _meets_p99),
        *make_executed_figures(made_moves, by_device=False),
    ]
    for low, high in CLASSES:
        of_class = [move.lowered_ms for move in made_moves if low <= move.rate < high]
        if of_class:
            figures.append(make_figure(f"{low:g}-{high:g}, lowered-planned", of_class, "ms"))
    count_within = sum(time_ms <= ASKED_P99_MS for time_ms in times_ms)
    choices = [LoweringChoices("all", {"within 1 ms": count_within, "further away": len(times_ms) - count_within})]
    return LoweringFigures(MAKE, moves, figures, choices)


def _is_reachable(move: LoweredMove) -> bool:
    return move.rate**2 >= VERNIER * move.profile.duration_s


def _meets_p99(found: BenchFigure) -> bool:
    return found.p99 <= ASKED_P99_MS


def _measure_proposal_ms(driver: Driver, profile: Profile, answered_s: float) -> float:
    """Return the remaining difference after all members have been planned for the proposed duration, as in a step."""
    longer = profile.stretch_time(max(1.0, answered_s / profile.duration_s))
    return abs(driver.lower_profiles({"a": longer}, StartOptions(), None).durations_s["a"] - longer.duration_s) * 1e3
