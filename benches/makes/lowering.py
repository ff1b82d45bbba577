"""Accuracy of the compilation of plans to what a make's controller executes, by the simulator's ground truth, in
virtual time.

Plans pass through the real driver: compiled, armed, released, and watched, on a simulated controller with a crystal
of its own. To add a make, add its `BenchedMake`.
"""

import asyncio
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from math import ceil
from random import Random
from typing import Any, NamedTuple

from adapters.contract import Driver, Lowered
from benches.makes.drivers import connect_wire, make_drivers
from benches.makes.figures import BenchFigure, LoweringChoices, LoweringFigures, make_figure
from benches.makes.lowering_ppsmc import bench_ppsmc
from benches.makes.lowering_steppers import STEPPERS, bench_stepper
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, sleep_ns, sleep_until_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import LAN, WireModel, serial_wire
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import CommandedMotion, FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

SEED = 11
CRYSTALS_PPM = (-100.0, -37.0, 0.0, 55.0, 100.0)
CONTOUR_S = 5.0
VELOCITY, ACCELERATION, JERK = 200_000.0, 1_000_000.0, 10_000_000.0  # counts/s, counts/s², counts/s³
FAST = "20k-200k"
CRUISES = {  # counts/s, slowest and fastest; one of this many moves has such a cruise
    FAST: (20_000.0, 200_000.0, 1),
    "2k-20k": (2_000.0, 20_000.0, 10),
    "200-2k": (200.0, 2_000.0, 10),
    "20-200": (20.0, 200.0, 10),
}
SIMULATED_EVERY = 25  # one of this many lowered trapezoids is executed
MIN_SIMULATED = 20
TRAPEZOIDS_PER_CONTOUR = 1000  # trapezoids per contour, with each crystal
ASKED_RECORD, ASKED_BETWEEN, ASKED_P99_MS = 1.0, 1.0, 0.2


@dataclass(frozen=True, slots=True)
class BenchedMake:
    """The benchmark's parameters of a make.

    config: a controller of four axes a, b, c, d with a scale of 1.
    sample_ns: by its own clock.
    record_samples: of a lowered contour; None: the make has none.
    way: kind of a lowered step, in a word.
    """

    config: Mapping[str, Any]
    port: str
    wire: WireModel
    sample_ns: float
    record_samples: Callable[[Lowered], int] | None
    way: Callable[[Lowered], str]


def _make_yaskawa_config(adapter: str, link: Mapping[str, Any]) -> Mapping[str, Any]:
    axis = {"unit": "counts", "limits": {"velocity": VELOCITY, "acceleration": ACCELERATION, "jerk": JERK}}
    axes = {name: {**axis, "motors": [motor]} for name, motor in zip("abcd", "XYZW", strict=True)}
    return {"adapter": adapter, "link": dict(link), "axes": axes}


def _record_samples(lowered: Lowered) -> int:
    words = lowered.commands[0].split()
    return int(words[words.index("of") + 1])


def _describe_lowering(lowered: Lowered) -> str:
    return "contour" if lowered.commands[0].startswith("contour") else "registers"


BENCHED_MAKES = {
    "smc4000": BenchedMake(
        config=_make_yaskawa_config("smc4000", {"kind": "tcp", "host": "10.0.0.1", "port": 23}),
        port="tcp",
        wire=LAN,
        sample_ns=976_562.5,
        record_samples=_record_samples,
        way=_describe_lowering,
    ),
    "smc2000": BenchedMake(
        config=_make_yaskawa_config("smc2000", {"kind": "serial", "device": "/dev/ttyUSB0", "baud": 19200}),
        port="serial",
        wire=serial_wire(19200),
        sample_ns=976_562.5,
        record_samples=_record_samples,
        way=_describe_lowering,
    ),
}


OTHER_BENCHES: dict[str, Callable[[int, int], LoweringFigures]] = {
    **{make: partial(bench_stepper, make) for make in STEPPERS},
    "ppsmc": bench_ppsmc,
}
"""Makes with a benchmark of their own, by number of moves and seed."""
MAKES = (*BENCHED_MAKES, *OTHER_BENCHES)


def bench_lowering(make: str, moves: int, seed: int = SEED) -> LoweringFigures:
    """Lower `moves` trapezoids, execute a seeded part of them and some contours. make: one of `MAKES`."""
    if make in OTHER_BENCHES:
        return OTHER_BENCHES[make](moves, seed)
    subject = BENCHED_MAKES[make]
    at_record: list[float] = []
    errors_between: list[float] = []
    errors_beyond: list[float] = []
    contour_count = max(1, moves // TRAPEZOIDS_PER_CONTOUR)
    for number, ppm in enumerate(CRYSTALS_PPM if subject.record_samples is not None else ()):
        for records, distances, sag in _measure_contours(subject, ppm, contour_count, seed + number):
            at_record += records
            errors_between += distances
            errors_beyond += [distance - sag for distance in distances]
    figures = (
        []
        if subject.record_samples is None
        else [
            make_figure("contour, at record instants", at_record, "counts", "max<=1", lambda f: f.max <= ASKED_RECORD),
            make_figure("contour, between them", errors_between, "counts"),
            make_figure(
                "contour, between, less a·h²/8", errors_beyond, "counts", "max<=1", lambda f: f.max <= ASKED_BETWEEN
            ),
        ]
    )
    choices: list[LoweringChoices] = []
    for number, (cruise, (low, high, share)) in enumerate(CRUISES.items()):
        trapezoids = _measure_trapezoids(subject, low, high, max(moves // share, 1), seed + 100 + number)
        # Slower moves are shown for information: their accuracy depends on the make's speed resolution.
        bound, keeps = ("p99<0.2", _meets_duration) if cruise == FAST else ("", None)
        figures += [
            make_figure(f"{cruise}, lowered-planned", trapezoids.lowered_ms, "ms", bound, keeps),
            make_figure(
                f"{cruise}, real-lowered", trapezoids.simulated_samples, "samples", "max<1", lambda f: f.max < 1.0
            ),
            make_figure(f"{cruise}, real-planned", trapezoids.planned_ms, "ms"),
        ]
        choices.append(LoweringChoices(cruise, trapezoids.ways))
    return LoweringFigures(make, moves, figures, choices)


def _meets_duration(found: BenchFigure) -> bool:
    return found.p99 < ASKED_P99_MS


# A controller on a link


@dataclass(slots=True)
class _LoweringBench:
    clock: VirtualClock
    controller: SimulatedController
    driver: Driver
    config: Controller
    crystal: Oscillator
    built_ns: int
    sample_ns: float

    async def wait_until_ready(self) -> None:
        """Connect, switch the motors on, and wait until the clock estimate has converged."""
        await self.driver.connect()
        await self.driver.configure()
        await self.driver.set_enabled(list(self.config.axes), on=True)
        for _ in range(300):
            await self.driver.poll()
            await sleep_ns(self.clock, 100 * NS_PER_MS)

    def clock_mapping(self) -> TickMapping:
        mapping = self.driver.clock_mapping()
        if mapping is None:
            raise RuntimeError("the controller has no clock estimate")
        return mapping

    def motor_of(self, axis: str) -> str:
        return self.config.axes[axis].motors[0]

    # By the simulator's own crystal

    def sample_at(self, true_ns: int) -> int:
        """Return the sample that begins at `true_ns`."""
        elapsed_ns = self.crystal.device_ns(true_ns) - self.crystal.device_ns(self.built_ns)
        return round(elapsed_ns / self.sample_ns)

    def sample_begin_ns(self, sample: int) -> int:
        return self.crystal.true_ns(self.crystal.device_ns(self.built_ns) + ceil(sample * self.sample_ns))


def _run_with_driver(subject: BenchedMake, ppm: float, seed: int, main: Callable[[_LoweringBench], Any]) -> Any:
    """Run `main` with a driver connected to a simulated controller."""

    async def run_bench(clock: VirtualClock) -> Any:
        config = Controller.model_validate(subject.config)
        crystal = Oscillator(Random(seed).randrange(10**9), ppm)
        timing = FirmwareTiming(decode_ns=500 * NS_PER_US, spread_ns=50 * NS_PER_US)
        built_ns = clock.now_ns()
        controller = find_simulator(config.adapter).build_controller(
            clock, {}, oscillator=crystal, timing=timing, seed=seed
        )
        wire = connect_wire(clock, subject.wire, controller, subject.port, seed)
        (driver,) = make_drivers(wire, {"bench": config})
        world = _LoweringBench(
            clock=clock,
            controller=controller,
            driver=driver,
            config=config,
            crystal=crystal,
            built_ns=built_ns,
            sample_ns=subject.sample_ns,
        )
        await world.wait_until_ready()
        return await main(world)

    return run_virtual(run_bench)


async def _start_step(world: _LoweringBench, profiles: Mapping[str, Profile]) -> tuple[Lowered, TickMapping, int]:
    """Arm a step and release it; return the mapping that it was frozen with, and T0."""
    driver = world.driver
    await driver.poll()
    mapping = world.clock_mapping()
    lowered_profiles = driver.lower_profiles(profiles, StartOptions(), mapping)
    t0_ns = world.clock.now_ns() + lowered_profiles.costs.arm_ns + lowered_profiles.costs.disarm_ns + 150 * NS_PER_MS
    await driver.slots.present.load(lowered_profiles, t0_ns, mapping)
    await driver.slots.present.verify()
    await driver.slots.present.release()
    return lowered_profiles, mapping, t0_ns


async def _finish_step(world: _LoweringBench) -> None:
    """Watch the step to its end, as an adapter does."""
    await world.driver.slots.present.wait_for_start()
    outcome = await world.driver.slots.present.wait_for_end()
    if outcome.state != "done":
        raise RuntimeError(f"a move of the benchmark ended unexpectedly: {outcome.reason}")


# Contours


def _measure_contours(
    subject: BenchedMake, ppm: float, count: int, seed: int
) -> list[tuple[list[float], list[float], float]]:
    """Return, for each of `count` moves: distances to the plan at the record instants and at the samples between,
    counts, and a·h²/8."""

    async def measure(world: _LoweringBench) -> list[tuple[list[float], list[float], float]]:
        draw = Random(seed)
        results: list[tuple[list[float], list[float], float]] = []
        at = dict.fromkeys(world.config.axes, 0)
        for _ in range(count):
            profiles = _draw_contour(at, draw)
            results.append(await _measure_contour(world, subject, profiles))
            at = {axis: profile.end_counts for axis, profile in profiles.items()}
        return results

    return _run_with_driver(subject, ppm, seed, measure)


def _draw_contour(at: Mapping[str, int], draw: Random) -> dict[str, Profile]:
    """Draw a step of about `CONTOUR_S`, with one axis at its limits."""
    longest = VELOCITY * (CONTOUR_S - VELOCITY / ACCELERATION - ACCELERATION / JERK)
    first = draw.choice(list(at))
    moves = [
        AxisMove(
            axis=axis,
            start_counts=start,
            target_counts=start
            + draw.choice((-1, 1)) * round(longest * (1.0 if axis == first else draw.uniform(0.01, 1.0))),
            velocity=VELOCITY,
            acceleration=ACCELERATION,
            jerk=JERK,
            order=3,
        )
        for axis, start in at.items()
    ]
    return dict(plan_step(moves).profiles)


async def _measure_contour(
    world: _LoweringBench, subject: BenchedMake, profiles: Mapping[str, Profile]
) -> tuple[list[float], list[float], float]:
    lowering, mapping, t0_ns = await _start_step(world, profiles)
    motion_count = len(world.controller.commanded_motions)
    await sleep_until_ns(world.clock, t0_ns - 10 * NS_PER_MS)
    first_sample = world.sample_at(world.clock.now_ns())
    assert subject.record_samples is not None
    record, samples = (
        subject.record_samples(lowering),
        ceil(lowering.durations_s[max(profiles)] * 1e9 / lowering.tick_ns),
    )
    watching = asyncio.get_running_loop().create_task(_finish_step(world))
    sightings: list[tuple[int, dict[str, float]]] = []
    # From some samples before the start, which is not determined yet, to some after the end.
    for sample in range(first_sample + 1, first_sample + samples + 40):
        await sleep_until_ns(world.clock, world.sample_begin_ns(sample))
        sightings.append((sample, {axis: world.controller.position(world.motor_of(axis)) for axis in profiles}))
    await watching
    start = world.sample_at(min(motion.start_ns for motion in world.controller.commanded_motions[motion_count:]))
    plans = {axis: (profile.start_counts, profile.make_evaluator()) for axis, profile in profiles.items()}
    at_record: list[float] = []
    distances_between: list[float] = []
    for sample, positions in sightings:
        time_s = (mapping.to_host_ns(sample) - t0_ns) * 1e-9
        for axis, (origin, plan) in plans.items():
            distance = abs(positions[axis] - origin - plan(time_s).position)
            (distances_between if (sample - start) % record else at_record).append(distance)
    steepest = max(profile.peak_acceleration for profile in profiles.values())
    return at_record, distances_between, steepest * (record * lowering.tick_ns * 1e-9) ** 2 / 8


# Trapezoids


class _TrapezoidResults(NamedTuple):
    """Differences of durations: lowered and simulated minus planned in ms, simulated minus lowered in samples."""

    lowered_ms: list[float]
    simulated_samples: list[float]
    planned_ms: list[float]
    ways: dict[str, int]


def _measure_trapezoids(subject: BenchedMake, low: float, high: float, count: int, seed: int) -> _TrapezoidResults:
    """Run `count` moves of one axis with cruises from `low` to `high` counts/s."""

    async def measure(world: _LoweringBench) -> _TrapezoidResults:
        draw = Random(seed)
        results = _TrapezoidResults([], [], [], {})
        sample_numbers = set(draw.sample(range(count), min(count, max(MIN_SIMULATED, count // SIMULATED_EVERY))))
        at = 0
        for number in range(count):
            profile = _draw_trapezoid(at, low, high, draw)
            lowered_profiles = world.driver.lower_profiles({"a": profile}, StartOptions(), world.clock_mapping())
            way = subject.way(lowered_profiles)
            results.ways[way] = results.ways.get(way, 0) + 1
            results.lowered_ms.append(abs(lowered_profiles.durations_s["a"] - profile.duration_s) * 1e3)
            if number not in sample_numbers:
                continue
            motion = await _execute_profile(world, profile)
            at = profile.end_counts
            if motion.end_ns is None:
                raise RuntimeError("a move of the benchmark has no end")
            samples = world.sample_at(motion.end_ns) - world.sample_at(motion.start_ns)
            prediction = lowered_profiles.durations_s["a"] * 1e9 / lowered_profiles.tick_ns
            results.simulated_samples.append(abs(samples - prediction))
            results.planned_ms.append(abs((motion.end_ns - motion.start_ns) * 1e-6 - profile.duration_s * 1e3))
        return results

    return _run_with_driver(subject, Random(seed).uniform(-100.0, 100.0), seed, measure)


async def _execute_profile(world: _LoweringBench, profile: Profile) -> CommandedMotion:
    await _start_step(world, {"a": profile})
    await _finish_step(world)
    return world.controller.commanded_motions[-1]


def _draw_trapezoid(at: int, low: float, high: float, draw: Random) -> Profile:
    """Draw a cruise between `low` and `high`, ramps of 0.05 to 1 s, up to 8 s at speed; alternating directions."""
    velocity = low * (high / low) ** draw.random()
    acceleration = min(velocity / draw.uniform(0.05, 1.0), ACCELERATION)
    way = max(1, round(velocity * (velocity / acceleration + draw.uniform(0.0, 8.0))))
    target = at - way if at > 0 else at + way
    return plan_step([AxisMove("a", at, target, velocity, acceleration)]).profiles["a"]
