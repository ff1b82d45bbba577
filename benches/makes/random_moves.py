"""Random feasible moves of one axis by a real driver on a simulated controller, in virtual time: all of them as
lowered, and a seeded part of them as executed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any, NamedTuple

from adapters.contract import Driver, Lowered
from benches.makes.drivers import connect_wire, load_moves, make_drivers, release_moves
from benches.makes.figures import BenchFigure, make_figure
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, Clock, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import WireModel
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

STEPS_LEAST = 50
SLOWEST = 16.0  # steps/s, of the mean rate
DURATION_MOST_S = 120.0
SIMULATED_EVERY = 25  # one of this many lowered moves is executed
MIN_SIMULATED = 20
DRIFT_PPM = 100.0
ASKED_MAX_MS = 0.1  # of executed and lowered durations


@dataclass(frozen=True, slots=True)
class RandomMoves:
    """A controller of one axis `a`, and the range of its moves.

    simulate: options of the simulated controller; port: its port.
    quickest, acceleration: in steps/s (²). steps_most: of a move.
    compare: another difference of durations to measure, ms, by driver, move and its lowered duration, s.
    """

    config: Controller
    model: WireModel
    port: str
    simulate: Mapping[str, Any]
    quickest: float
    acceleration: float
    steps_most: int
    compare: Callable[[Driver, Profile, float], float] | None = None


class LoweredMove(NamedTuple):
    """One move. true_s, device_s: its executed duration, by true time and by the controller's crystal; None: it was
    only lowered. compared_ms: result of `RandomMoves.compare`."""

    profile: Profile
    lowered: Lowered
    true_s: float | None
    device_s: float | None
    compared_ms: float | None

    @property
    def rate(self) -> float:
        """Mean rate, steps/s."""
        return abs(self.profile.end_counts - self.profile.start_counts) / self.profile.duration_s

    @property
    def lowered_s(self) -> float:
        return self.lowered.durations_s["a"]

    @property
    def lowered_ms(self) -> float:
        """Difference between lowered and planned duration."""
        return abs(self.lowered_s - self.profile.duration_s) * 1e3


class RandomRun(NamedTuple):
    """refusals: draws that the driver refused, because the controller cannot move so slowly."""

    moves: list[LoweredMove]
    refusals: int


def draw_drift_ppm(seed: int) -> float:
    """Return the rate error of the crystal."""
    return Random(seed).uniform(-DRIFT_PPM, DRIFT_PPM)


def run_random_moves(case: RandomMoves, count: int, seed: int) -> RandomRun:
    """Lower `count` moves and execute a part of them."""
    return run_virtual(lambda clock: _run_moves(clock, case, count, seed))


def make_executed_figures(moves: Sequence[LoweredMove], *, by_device: bool) -> list[BenchFigure]:
    """Return the figures of executed moves. by_device: lowered durations are those of the controller's crystal."""
    times_s = [(move, move.device_s if by_device else move.true_s) for move in moves]
    from_lowered = [abs(time_s - move.lowered_s) * 1e3 for move, time_s in times_s if time_s is not None]
    from_planned = [abs(move.true_s - move.profile.duration_s) * 1e3 for move in moves if move.true_s is not None]
    return [
        make_figure("all, real-lowered", from_lowered, "ms", "max<=0.1", lambda f: f.max <= ASKED_MAX_MS),
        make_figure("all, real-planned", from_planned, "ms"),
    ]


async def _run_moves(clock: VirtualClock, case: RandomMoves, count: int, seed: int) -> RandomRun:
    crystal = Oscillator(Random(seed).randrange(10**9), draw_drift_ppm(seed))
    timing = FirmwareTiming(decode_ns=500 * NS_PER_US, spread_ns=500 * NS_PER_US)
    simulator = find_simulator(case.config.adapter)
    unit = simulator.build_controller(clock, case.simulate, oscillator=crystal, timing=timing, seed=seed)
    (driver,) = make_drivers(connect_wire(clock, case.model, unit, case.port, seed), {"bench": case.config})
    await driver.connect()
    await driver.configure()
    await driver.set_enabled(["a"], on=True)
    draw = Random(seed)
    sample_numbers = set(draw.sample(range(count), min(count, max(MIN_SIMULATED, count // SIMULATED_EVERY))))
    at, refusals, moves = 0, 0, list[LoweredMove]()
    while len(moves) < count:
        profile = _draw_feasible(case, at, draw)
        if profile is None:
            continue
        try:
            lowered_profiles = driver.lower_profiles({"a": profile}, StartOptions(), None)
        except Refusal:
            refusals += 1
            continue
        true_s = device_s = compared_ms = None
        if len(moves) in sample_numbers:
            start_ns, end_ns = await _execute_move(clock, driver, unit, profile)
            at = profile.end_counts
            true_s = (end_ns - start_ns) * 1e-9
            device_s = (crystal.device_ns(end_ns) - crystal.device_ns(start_ns)) * 1e-9
        if case.compare is not None:
            compared_ms = case.compare(driver, profile, lowered_profiles.durations_s["a"])
        moves.append(LoweredMove(profile, lowered_profiles, true_s, device_s, compared_ms))
    await driver.close()
    return RandomRun(moves, refusals)


def _draw_feasible(case: RandomMoves, at: int, draw: Random) -> Profile | None:
    """Draw a move from `at` that is 1.02 to 3 times slower than the fastest; return None when this draw gives none."""
    velocity = SLOWEST * (case.quickest / SLOWEST) ** draw.random()
    acceleration = min(velocity / draw.uniform(0.05, 1.0), case.acceleration)
    steps = round(STEPS_LEAST * (case.steps_most / STEPS_LEAST) ** draw.random())
    if steps / velocity > DURATION_MOST_S:
        return None
    target = at - steps if at > 0 else at + steps
    plan = plan_step([AxisMove("a", at, target, velocity, acceleration)])
    longer = plan.stretch_to(plan.duration_s * draw.uniform(1.02, 3.0))
    mean = steps / longer.duration_s
    return longer.profiles["a"] if mean >= SLOWEST and longer.duration_s <= DURATION_MOST_S else None


async def _execute_move(clock: Clock, driver: Driver, unit: SimulatedController, profile: Profile) -> tuple[int, int]:
    """Return the true instants of the motion's start and end."""
    motion_count = len(unit.commanded_motions)
    lowered_profiles = driver.lower_profiles({"a": profile}, StartOptions(), None)
    t0_ns = clock.now_ns() + lowered_profiles.costs.arm_ns + lowered_profiles.costs.disarm_ns + 50 * NS_PER_MS
    await load_moves([driver], [lowered_profiles], t0_ns)
    await release_moves([driver])
    await driver.slots.present.wait_for_start()
    outcome = await driver.slots.present.wait_for_end()
    end_ns = unit.commanded_motions[-1].end_ns
    if outcome.state != "done" or end_ns is None:
        raise RuntimeError(f"a move of the benchmark ended unexpectedly: {outcome.reason}")
    await sleep_ns(clock, 10 * NS_PER_MS)
    return unit.commanded_motions[motion_count].start_ns, end_ns
