"""Random feasible moves of steppers and of one drive: as planned, as lowered, and a seeded part of them as executed.

Rates are whole steps/s and ramps whole steps or milliseconds, so the accuracy depends on the mean rate of a move;
the figures are given for all moves together and by mean rate.
"""

from collections.abc import Callable, Mapping
from contextvars import copy_context
from dataclasses import dataclass
from itertools import pairwise
from random import Random
from typing import Any, NamedTuple

from adapters.contract import Driver, DriverSetup
from adapters.host.makes import find_make
from adapters.shrc203.fleetaxes import axis_bounds
from adapters.shrc203.shapes.trapezoid import fit_trapezoid
from adapters.toolkit.firing import LoopTimedWriter
from benches.makes.figures import BenchFigure, LoweringChoices, LoweringFigures, make_figure
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, can_wire, serial_wire
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

STEPS_LEAST, STEPS_MOST = 50, 300_000
SLOWEST = 16.0  # steps/s, of the mean rate
DURATION_MOST_S = 120.0
CLASSES = (16.0, 33.0, 100.0, 1000.0)  # steps/s, of the mean rate, up to the fastest
SIMULATED_EVERY = 25  # one of this many lowered moves is executed
MIN_SIMULATED = 20
ASKED_P99_MS, ASKED_MAX_MS = 0.2, 0.1


@dataclass(frozen=True, slots=True)
class BenchedStepper:
    """A make and its controller of one axis `a`.

    quickest, acceleration: in steps/s (²).
    begins: prefix of those lines of `Lowered.commands` that are motions.
    port: of the simulated controller.
    alone: duration of the nearest move with a single command, in s, for comparison."""

    make: str
    link: Mapping[str, Any]
    options: Mapping[str, Any]
    simulate: Mapping[str, Any]
    axis: Mapping[str, Any]
    quickest: float
    acceleration: float
    begins: str
    port: str = "serial"
    alone: Callable[[Controller, Profile], float] | None = None


def _fit_one_trapezoid(config: Controller, profile: Profile) -> float:
    way = abs(profile.end_counts - profile.start_counts)
    shape = fit_trapezoid(way, profile.duration_s, profile.durations_s[0], axis_bounds(config.axes["a"]))
    assert shape is not None
    return shape.duration_s


STEPPERS = {
    stepper.make: stepper
    for stepper in (
        BenchedStepper(
            make="smc30",
            link={"kind": "serial", "device": "/dev/ttyS0", "baud": 9600, "data_bits": 7, "parity": "odd"},
            options={},
            simulate={"checksum": True},
            axis={
                "unit": "counts",
                "limits": {"velocity": 15_000, "acceleration": 200_000},
                "start_rate": {"min": 16, "max": 1000},
            },
            quickest=15_000.0,
            acceleration=200_000.0,
            begins="G",
        ),
        BenchedStepper(
            make="shrc203",
            link={"kind": "serial", "device": "/dev/ttyS0", "baud": 38400},
            options={"nm_per_pulse": 100},
            simulate={"divide": 20, "speed": [100, 20000, 100]},
            axis={
                "unit": "um",
                "scale": 10,
                "limits": {"velocity": 5_000, "acceleration": 50_000},
                "start_rate": {"min": 0.1, "max": 500},
            },
            quickest=50_000.0,
            acceleration=500_000.0,
            begins="MP",
            alone=_fit_one_trapezoid,
        ),
        BenchedStepper(
            make="cia402",
            link={"kind": "can", "interface": "socketcan", "channel": "can0", "address": 1},
            options={},
            simulate={},
            axis={"unit": "counts", "limits": {"velocity": 200_000, "acceleration": 1_000_000}},
            quickest=200_000.0,
            acceleration=1_000_000.0,
            begins="6040h",
            port="can",
        ),
    )
}


class _StepperMove(NamedTuple):
    """One move: its mean rate, steps/s; differences of durations in ms, executed only for a part, and by one command
    alone where that is known; motor commands."""

    rate: float
    planned_s: float
    lowered_ms: float
    predicted_ms: float | None
    planned_ms: float | None
    alone_ms: float | None
    commands: int


def bench_stepper(make: str, moves: int, seed: int) -> LoweringFigures:
    """Lower `moves` of one of `STEPPERS` and execute a part of them."""
    subject = STEPPERS[make]
    refusals = [0]
    made_moves: list[_StepperMove] = run_virtual(lambda clock: _measure_moves(clock, subject, moves, seed, refusals))
    executed_moves = [move for move in made_moves if move.predicted_ms is not None]
    figures = [
        make_figure("all, lowered-planned", [move.lowered_ms for move in made_moves], "ms", "p99<=0.2", _meets_p99),
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
    if subject.alone is not None:
        times_alone = [move.alone_ms for move in made_moves if move.alone_ms is not None]
        figures.append(make_figure("all, lowered-planned by one command", times_alone, "ms"))
    choices: list[LoweringChoices] = [LoweringChoices("refused", {"slower than the controller supports": refusals[0]})]
    # Visible where one step of the cruise speed changes the duration by more than the longest ramp can compensate.
    times_within = [move.lowered_ms for move in made_moves if move.planned_s < move.rate]
    if times_within:
        figures.append(make_figure("seconds < steps/s, lowered-planned", times_within, "ms", "p99<=0.2", _meets_p99))
    for low, high in pairwise((*CLASSES, subject.quickest)):
        of_class = [move for move in made_moves if low <= move.rate < high]
        name = f"{low:g}-{high:g}"
        if of_class:
            figures.append(make_figure(f"{name}, lowered-planned", [move.lowered_ms for move in of_class], "ms"))
        split = sum(move.commands > 1 for move in of_class)
        choices.append(LoweringChoices(name, {"one command": len(of_class) - split, "several commands": split}))
    return LoweringFigures(make, moves, figures, choices)


def _meets_p99(found: BenchFigure) -> bool:
    return found.p99 <= ASKED_P99_MS


def _draw_drift_ppm(seed: int) -> float:
    return Random(seed).uniform(-100.0, 100.0)


async def _measure_moves(
    clock: VirtualClock, subject: BenchedStepper, moves: int, seed: int, refused: list[int]
) -> list[_StepperMove]:
    config = Controller.model_validate(
        {
            "adapter": subject.make,
            "link": subject.link,
            # Durations are compared in the controller's own time: nothing has to be learned of its crystal.
            "options": {**subject.options, "clock_ppm": 0},
            "axes": {"a": {"motors": ["1"], **subject.axis}},
        }
    )
    make = find_make(subject.make)
    crystal = Oscillator(Random(seed).randrange(10**9), _draw_drift_ppm(seed))
    timing = FirmwareTiming(decode_ns=500 * NS_PER_US, spread_ns=500 * NS_PER_US)
    unit = find_simulator(subject.make).build_controller(
        clock, subject.simulate, oscillator=crystal, timing=timing, seed=seed
    )
    model = serial_wire(subject.link["baud"]) if "baud" in subject.link else can_wire()
    wire = MemoryWire(
        clock=clock, model=model, far=unit, port=subject.port, endpoint="bench", far_context=copy_context(), seed=seed
    )
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
    at, results = 0, list[_StepperMove]()
    while len(results) < moves:
        profile = _draw_feasible(subject, at, draw)
        if profile is None:
            continue
        try:
            lowered_profiles = driver.lower_profiles({"a": profile}, StartOptions(), None)
        except Refusal:
            # Slower than the controller supports: not feasible.
            refused[0] += 1
            continue
        predicted_s = lowered_profiles.durations_s["a"]
        commands = sum(line.startswith(subject.begins) for line in lowered_profiles.commands)
        rate = abs(profile.end_counts - profile.start_counts) / profile.duration_s
        predicted_ms = planned_ms = alone_ms = None
        if subject.alone is not None:
            alone_ms = abs(subject.alone(config, profile) - profile.duration_s) * 1e3
        if len(results) in sample_numbers:
            start_ns, end_ns = await _measure_execution(clock, driver, unit, profile)
            at = profile.end_counts
            device_s = (crystal.device_ns(end_ns) - crystal.device_ns(start_ns)) * 1e-9
            predicted_ms = abs(device_s - predicted_s) * 1e3
            planned_ms = abs((end_ns - start_ns) * 1e-9 - profile.duration_s) * 1e3
        results.append(
            _StepperMove(
                rate=rate,
                planned_s=profile.duration_s,
                lowered_ms=abs(predicted_s - profile.duration_s) * 1e3,
                predicted_ms=predicted_ms,
                planned_ms=planned_ms,
                alone_ms=alone_ms,
                commands=commands,
            )
        )
    await driver.close()
    return results


def _draw_feasible(subject: BenchedStepper, at: int, draw: Random) -> Profile | None:
    """Draw a move from `at` that is 1.02 to 3 times slower than the fastest; return None when this draw gives none."""
    velocity = SLOWEST * (subject.quickest / SLOWEST) ** draw.random()
    acceleration = min(velocity / draw.uniform(0.05, 1.0), subject.acceleration)
    steps = round(STEPS_LEAST * (STEPS_MOST / STEPS_LEAST) ** draw.random())
    if steps / velocity > DURATION_MOST_S:
        return None
    target = at - steps if at > 0 else at + steps
    plan = plan_step([AxisMove("a", at, target, velocity, acceleration)])
    longer = plan.stretch_to(plan.duration_s * draw.uniform(1.02, 3.0))
    mean = steps / longer.duration_s
    return longer.profiles["a"] if mean >= SLOWEST and longer.duration_s <= DURATION_MOST_S else None


async def _measure_execution(
    clock: Clock, driver: Driver, unit: SimulatedController, profile: Profile
) -> tuple[int, int]:
    """Return the true instants of the motion's start and end."""
    motion_count = len(unit.commanded_motions)
    lowered_profiles = driver.lower_profiles({"a": profile}, StartOptions(), None)
    t0_ns = clock.now_ns() + lowered_profiles.costs.arm_ns + lowered_profiles.costs.disarm_ns + 50 * NS_PER_MS
    await driver.slots.present.load(lowered_profiles, t0_ns, None)
    await driver.slots.present.verify()
    await driver.slots.present.release()
    await driver.slots.present.wait_for_start()
    outcome = await driver.slots.present.wait_for_end()
    end_ns = unit.commanded_motions[-1].end_ns
    if outcome.state != "done" or end_ns is None:
        raise RuntimeError(f"a move of the benchmark ended unexpectedly: {outcome.reason}")
    await sleep_ns(clock, 10 * NS_PER_MS)
    return unit.commanded_motions[motion_count].start_ns, end_ns
