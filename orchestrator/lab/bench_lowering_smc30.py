"""Random feasible moves of an SMC30: as planned, as lowered, and a seeded part of them as executed, in virtual time.

Its rates are whole steps/s and its ramps whole steps, so that what it can do differs with the mean rate of a move; the
figures are given for all moves together and by mean rate.
"""

from contextvars import copy_context
from random import Random
from typing import NamedTuple

from adapters.contract import Driver, Setup
from adapters.firing import LoopFirer
from adapters.host import find_make
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.virtual import run_virtual
from orchestrator.lab.bench_figures import Chosen, Figure, LoweringFigures, figure
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartWay
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import SimulatedController, Timing
from sim.core.oscillator import Oscillator
from sim.core.vectors import simulator

MAKE = "smc30"
BAUD = 9600
SLOWEST, QUICKEST = 16.0, 15_000.0  # steps/s, of the cruise
STEPS_LEAST, STEPS_MOST = 50, 300_000
DURATION_MOST_S = 120.0
ACCELERATION = 200_000.0  # steps/s²
CLASSES = ((16.0, 33.0), (33.0, 100.0), (100.0, 1000.0), (1000.0, QUICKEST))  # steps/s, of the mean rate
SIMULATED = 25  # of so many lowered moves one is executed
LEAST_SIMULATED = 20
ASKED_P99_MS, ASKED_MAX_MS = 0.2, 0.1
CONFIG = {
    "adapter": MAKE,
    "link": {"kind": "serial", "device": "/dev/ttyS0", "baud": BAUD, "data_bits": 7, "parity": "odd"},
    "axes": {
        "a": {
            "motors": ["1"],
            "unit": "counts",
            "limits": {"velocity": QUICKEST, "acceleration": ACCELERATION},
            "start_rate": {"min": 16, "max": 1000},
        }
    },
}


class _Found(NamedTuple):
    """One move: its mean rate, steps/s; distances of durations in ms, executed only of a part; motor commands."""

    rate: float
    lowered_ms: float
    predicted_ms: float | None
    planned_ms: float | None
    commands: int


def bench_smc30(moves: int, seed: int) -> LoweringFigures:
    """Lower `moves` and execute a part of them."""
    ppm = Random(seed).uniform(-100.0, 100.0)
    found: list[_Found] = run_virtual(lambda clock: _measure(clock, moves, ppm, seed))
    executed = [each for each in found if each.predicted_ms is not None]
    figures = [
        figure("all, lowered-planned", [each.lowered_ms for each in found], "ms", "p99<=0.2", _keeps_p99),
        figure(
            "all, real-lowered",
            [each.predicted_ms for each in executed if each.predicted_ms is not None],
            "ms",
            "max<=0.1",
            lambda f: f.max <= ASKED_MAX_MS,
        ),
        figure("all, real-planned", [each.planned_ms for each in executed if each.planned_ms is not None], "ms"),
    ]
    chosen: list[Chosen] = []
    for low, high in CLASSES:
        of_class = [each for each in found if low <= each.rate < high]
        name = f"{low:g}-{high:g}"
        if of_class:
            figures.append(figure(f"{name}, lowered-planned", [each.lowered_ms for each in of_class], "ms"))
        split = sum(each.commands > 1 for each in of_class)
        chosen.append(Chosen(name, {"one command": len(of_class) - split, "several commands": split}))
    return LoweringFigures(MAKE, moves, figures, chosen)


def _keeps_p99(found: Figure) -> bool:
    return found.p99 <= ASKED_P99_MS


async def _measure(clock: Clock, moves: int, ppm: float, seed: int) -> list[_Found]:
    config = Controller.model_validate(CONFIG)
    make = find_make(MAKE)
    crystal = Oscillator(Random(seed).randrange(10**9), ppm)
    timing = Timing(decode_ns=500 * NS_PER_US, spread_ns=500 * NS_PER_US)
    unit = simulator(MAKE).build(clock, {"checksum": True}, oscillator=crystal, timing=timing, seed=seed)
    wire = MemoryWire(clock, serial_wire(BAUD), unit, "serial", "bench", copy_context(), seed)
    options = make.options.model_validate(config.options)
    driver = make.driver(Setup("bench", config, options, clock, wire.open, LoopFirer(clock)))
    await driver.connect()
    await driver.configure()
    await driver.enable(["a"], True)
    draw = Random(seed)
    executed = set(draw.sample(range(moves), min(moves, max(LEAST_SIMULATED, moves // SIMULATED))))
    at, found = 0, list[_Found]()
    while len(found) < moves:
        profile = _feasible(at, draw)
        if profile is None:
            continue
        lowered = driver.lower({"a": profile}, StartWay(), None)
        predicted_s = lowered.durations_s["a"]
        commands = sum(line.startswith("G") for line in lowered.commands)
        rate = abs(profile.end_counts - profile.start_counts) / profile.duration_s
        predicted_ms = planned_ms = None
        if len(found) in executed:
            start_ns, end_ns = await _executed(clock, driver, unit, profile)
            at = profile.end_counts
            device_s = (crystal.device_ns(end_ns) - crystal.device_ns(start_ns)) * 1e-9
            predicted_ms = abs(device_s - predicted_s) * 1e3
            planned_ms = abs((end_ns - start_ns) * 1e-9 - profile.duration_s) * 1e3
        found.append(_Found(rate, abs(predicted_s - profile.duration_s) * 1e3, predicted_ms, planned_ms, commands))
    await driver.close()
    return found


def _feasible(at: int, draw: Random) -> Profile | None:
    """A move from `at` that is slower than the quickest by 1.02 to 3 times; None when this draw gives none."""
    velocity = SLOWEST * (QUICKEST / SLOWEST) ** draw.random()
    acceleration = min(velocity / draw.uniform(0.05, 1.0), ACCELERATION)
    steps = round(STEPS_LEAST * (STEPS_MOST / STEPS_LEAST) ** draw.random())
    if steps / velocity > DURATION_MOST_S:
        return None
    target = at - steps if at > 0 else at + steps
    plan = plan_step([AxisMove("a", at, target, velocity, acceleration)])
    longer = plan.stretched(plan.duration_s * draw.uniform(1.02, 3.0))
    mean = steps / longer.duration_s
    return longer.profiles["a"] if mean >= SLOWEST and longer.duration_s <= DURATION_MOST_S else None


async def _executed(clock: Clock, driver: Driver, unit: SimulatedController, profile: Profile) -> tuple[int, int]:
    """The true instants of the motion's start and end."""
    before = len(unit.motions)
    lowered = driver.lower({"a": profile}, StartWay(), None)
    t0_ns = clock.now_ns() + lowered.costs.arm_ns + lowered.costs.disarm_ns + 50 * NS_PER_MS
    await driver.arm(lowered, t0_ns, None)
    await driver.verify()
    await driver.go()
    await driver.started()
    outcome = await driver.outcome()
    end_ns = unit.motions[-1].end_ns
    if outcome.state != "done" or end_ns is None:
        raise RuntimeError(f"a move of the benchmark ended otherwise: {outcome.reason}")
    await sleep_ns(clock, 10 * NS_PER_MS)
    return unit.motions[before].start_ns, end_ns
