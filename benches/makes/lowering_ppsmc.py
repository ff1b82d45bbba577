"""Random feasible moves of a pp-electronic SMC: as planned, as lowered, and a part of them as executed, in virtual
time.

Its speeds are whole Hz and its ramps whole Hz/ms. From one slew speed V to the next the duration T changes by T/V;
the ramps can compensate V/1000 s at most, with 1 Hz/ms. So every duration is possible where V² is above 1000 T
Hz²/s, and slower moves only in steps: then the next longer duration is proposed, and the step is planned again for
it. Figures are given for all moves together, for these two kinds, and by mean rate.
"""

from contextvars import copy_context
from random import Random
from typing import Any, NamedTuple

from adapters.contract import Driver, DriverSetup
from adapters.host.makes import find_make
from adapters.toolkit.firing import LoopTimedWriter
from benches.makes.figures import BenchFigure, LoweringChoices, LoweringFigures, make_figure
from orchestrator.clock.base import NS_PER_MS, NS_PER_US
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import LAN, MemoryWire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

MAKE = "ppsmc"
SLOWEST, QUICKEST = 16.0, 100_000.0  # steps/s, of the cruise
STEPS_LEAST, STEPS_MOST = 50, 1_000_000
DURATION_MOST_S = 120.0
ACCELERATION = 1_000_000.0  # steps/s²
CLASSES = ((16.0, 100.0), (100.0, 300.0), (300.0, 1000.0), (1000.0, QUICKEST))  # steps/s, of the mean rate
VERNIER = 1000.0  # Hz²/s, see above
SIMULATED_EVERY = 25  # one of this many lowered moves is executed
MIN_SIMULATED = 20
ASKED_P99_MS, ASKED_MAX_MS = 1.0, 0.1
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


class _PpsmcMove(NamedTuple):
    """One move: its mean rate, steps/s, and duration, s; differences of durations in ms, executed only for a part.

    again_ms: difference between the proposed duration and the result of planning for it.
    """

    rate: float
    duration_s: float
    lowered_ms: float
    again_ms: float
    predicted_ms: float | None
    planned_ms: float | None

    @property
    def is_reachable(self) -> bool:
        return self.rate**2 >= VERNIER * self.duration_s


def bench_ppsmc(moves: int, seed: int) -> LoweringFigures:
    """Lower `moves` and execute a part of them, with the rate of the controller's crystal known as if measured."""
    ppm = Random(seed).uniform(-100.0, 100.0)
    made_moves: list[_PpsmcMove] = run_virtual(lambda clock: _measure_moves(clock, moves, ppm, seed))
    executed_moves = [move for move in made_moves if move.predicted_ms is not None]
    reached_moves = [move for move in made_moves if move.is_reachable]
    slow = [move for move in made_moves if not move.is_reachable]
    figures = [
        make_figure("all, lowered-planned", [move.lowered_ms for move in made_moves], "ms", "p99<=1", _meets_p99),
        make_figure(
            "V² >= 1000 T, lowered-planned", [move.lowered_ms for move in reached_moves], "ms", "p99<=1", _meets_p99
        ),
        *([make_figure("V² < 1000 T, lowered-planned", [move.lowered_ms for move in slow], "ms")] if slow else []),
        make_figure("all, proposal planned again", [move.again_ms for move in made_moves], "ms", "p99<=1", _meets_p99),
        make_figure(
            "all, real-lowered",
            [move.predicted_ms for move in executed_moves if move.predicted_ms is not None],
            "ms",
            "max<=0.1",
            lambda f: f.max <= ASKED_MAX_MS,
        ),
        make_figure(
            "all, real-planned", [move.planned_ms for move in executed_moves if move.planned_ms is not None], "ms"
        ),
    ]
    for low, high in CLASSES:
        of_class = [move.lowered_ms for move in made_moves if low <= move.rate < high]
        if of_class:
            figures.append(make_figure(f"{low:g}-{high:g}, lowered-planned", of_class, "ms"))
    count_within = sum(move.lowered_ms <= ASKED_P99_MS for move in made_moves)
    choices = [LoweringChoices("all", {"within 1 ms": count_within, "further away": len(made_moves) - count_within})]
    return LoweringFigures(MAKE, moves, figures, choices)


def _meets_p99(found: BenchFigure) -> bool:
    return found.p99 <= ASKED_P99_MS


async def _measure_moves(clock: VirtualClock, moves: int, ppm: float, seed: int) -> list[_PpsmcMove]:
    crystal = Oscillator(Random(seed).randrange(10**9), ppm)
    timing = FirmwareTiming(decode_ns=500 * NS_PER_US, spread_ns=500 * NS_PER_US)
    unit = find_simulator(MAKE).build_controller(clock, {}, oscillator=crystal, timing=timing, seed=seed)
    wire = MemoryWire(
        clock=clock, model=LAN, far=unit, port="tcp", endpoint="bench", far_context=copy_context(), seed=seed
    )
    config = Controller.model_validate(
        {**CONFIG, "options": {"rate_ppm": ppm, "clock_ppm": 1, "decode_us": 750, "decode_spread_us": 250}}
    )
    make = find_make(MAKE)
    options = make.options_model.model_validate(config.options)
    driver = make.create_driver(
        DriverSetup(
            controller="bench",
            config=config,
            options=options,
            clock=clock,
            open_link=wire.open_link,
            timed_writer=LoopTimedWriter(clock),
        )
    )
    await driver.connect()
    await driver.configure()
    await driver.set_enabled(["a"], on=True)
    draw = Random(seed)
    sample_numbers = set(draw.sample(range(moves), min(moves, max(MIN_SIMULATED, moves // SIMULATED_EVERY))))
    at, results = 0, list[_PpsmcMove]()
    while len(results) < moves:
        profile = _draw_feasible(at, draw)
        if profile is None:
            continue
        lowered_s = driver.lower_profiles({"a": profile}, StartOptions(), None).durations_s["a"]
        rate = abs(profile.end_counts - profile.start_counts) / profile.duration_s
        predicted_ms = planned_ms = None
        if len(results) in sample_numbers:
            real_s = await _measure_execution(clock, driver, unit, profile)
            at = profile.end_counts
            predicted_ms, planned_ms = abs(real_s - lowered_s) * 1e3, abs(real_s - profile.duration_s) * 1e3
        results.append(
            _PpsmcMove(
                rate=rate,
                duration_s=profile.duration_s,
                lowered_ms=abs(lowered_s - profile.duration_s) * 1e3,
                again_ms=_measure_proposal_ms(driver, profile, lowered_s),
                predicted_ms=predicted_ms,
                planned_ms=planned_ms,
            )
        )
    await driver.close()
    return results


def _measure_proposal_ms(driver: Driver, profile: Profile, answered_s: float) -> float:
    """Return the remaining difference after all members have been planned for the proposed duration, as in a step."""
    longer = profile.stretch_time(max(1.0, answered_s / profile.duration_s))
    return abs(driver.lower_profiles({"a": longer}, StartOptions(), None).durations_s["a"] - longer.duration_s) * 1e3


def _draw_feasible(at: int, draw: Random) -> Profile | None:
    """Draw a move from `at` that is 1.02 to 3 times slower than the fastest; return None when this draw gives none."""
    velocity = SLOWEST * (QUICKEST / SLOWEST) ** draw.random()
    acceleration = min(velocity / draw.uniform(0.05, 1.0), ACCELERATION)
    steps = round(STEPS_LEAST * (STEPS_MOST / STEPS_LEAST) ** draw.random())
    if steps / velocity > DURATION_MOST_S:
        return None
    target = at - steps if at > 0 else at + steps
    plan = plan_step([AxisMove("a", at, target, velocity, acceleration)])
    longer = plan.stretch_to(plan.duration_s * draw.uniform(1.02, 3.0))
    mean = steps / longer.duration_s
    return longer.profiles["a"] if mean >= SLOWEST and longer.duration_s <= DURATION_MOST_S else None


async def _measure_execution(clock: VirtualClock, driver: Driver, unit: SimulatedController, profile: Profile) -> float:
    """Return the true duration of the motion, s."""
    lowered_profiles = driver.lower_profiles({"a": profile}, StartOptions(), None)
    t0_ns = clock.now_ns() + lowered_profiles.costs.arm_ns + lowered_profiles.costs.disarm_ns + 50 * NS_PER_MS
    await driver.slots.present.load(lowered_profiles, t0_ns, None)
    await driver.slots.present.verify()
    await driver.slots.present.release()
    await driver.slots.present.wait_for_start()
    outcome = await driver.slots.present.wait_for_end()
    motion = unit.commanded_motions[-1]
    if outcome.state != "done" or motion.end_ns is None:
        raise RuntimeError(f"a move of the benchmark ended unexpectedly: {outcome.reason}")
    return (motion.end_ns - motion.start_ns) * 1e-9
