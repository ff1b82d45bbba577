"""The skew of fleets at start, on the path and at the end: complete coordinators in virtual time, checked against
the simulators' ground truth.

An environment is a fleet with its own crystals that has polled its controllers for a while; it runs one step after
the other, there and back, after pauses of random length, so that every start has other phases of the servo ticks.
"""

import asyncio
import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from random import Random
from typing import Any, NamedTuple

from benches.sync.baselines import BASELINES, BaselineMethod
from benches.sync.bounds import Bound, bound_of_drifting_ticks, bound_of_latencies, bound_of_ticks
from orchestrator.bus.memory.network import NetworkPath
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.crystal import ComputerClock
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import JobReport, StepRecording, StepReport
from orchestrator.runtime.simulated_fleets import DRIFT_PPM, PP_SPREAD_MS, make_sync_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from orchestrator.runtime.workers import map_in_processes

HISTORY_S = 300
STEPS_PER_FLEET = 40
MIN_FLEETS = 10  # of a row of many trials, at least
PATH_SAMPLES = 24  # samples of the path of each step
PEAK_SHARE = 0.1  # of the peak velocity; below it a distance is not converted to a time
PAUSE_NS = NS_PER_S


@dataclass(frozen=True, slots=True)
class SyncCase:
    """A row: a fleet, and its moves.

    cruise_s: at half the speed limit.
    step: more fields of the move.
    trials: share of the requested number.
    steps_a_world: few where differences of crystals matter; None: forty, or more for many trials.
    most_ms: targets of its figures.
    bound: smallest possible p99 of its start skew, where that is known.
    to_ms, back_ms: its adapter hosts are on computers of their own, with crystals of their own; delays from and to the
    coordinator's, each up to a tenth more.
    """

    name: str
    fleet: str
    cruise_s: float = 0.6
    limits: dict[str, float] = field(default_factory=dict[str, float])
    step: dict[str, Any] = field(default_factory=dict[str, Any])
    trials: float = 1.0
    steps_a_world: int | None = None
    asked: str = ""
    most_ms: dict[str, float] = field(default_factory=dict[str, float])
    bound: Bound | None = None
    to_ms: float | None = None
    back_ms: float = 0.0


TICK_MS = 1000 / 1024
CASES = (
    SyncCase(
        "clock",
        "8 SMC-4000",
        asked="p99 1 tick + 0.15 ms, p50 0.7 tick",
        most_ms={"start_p99": TICK_MS + 0.15, "start_p50": 0.7 * TICK_MS},
        bound=bound_of_ticks(8, TICK_MS),
    ),
    SyncCase(
        "clock",
        "64 SMC-4000",
        trials=0.1,
        asked="p99 1 tick + 0.2 ms",
        most_ms={"start_p99": TICK_MS + 0.2},
        bound=bound_of_ticks(64, TICK_MS),
    ),
    SyncCase("clock, one computer", "32 SMC-4000", trials=0.2, bound=bound_of_ticks(32, TICK_MS)),
    *(
        SyncCase(
            f"clock, 4 computers, {delay_ms:g} ms",
            "32 SMC-4000",
            trials=0.2,
            asked="p99 1.2 x one computer's",
            most_ms={"start_p99": 1.2 * TICK_MS},
            bound=bound_of_ticks(32, TICK_MS),
            to_ms=delay_ms,
            back_ms=delay_ms,
        )
        for delay_ms in (0.5, 5.0)
    ),
    SyncCase("clock, 4 computers, 5 ms one way", "32 SMC-4000", trials=0.2, to_ms=5.5, back_ms=0.5),
    SyncCase(
        "clock, align 10 s",
        "2 SMC-4000",
        step={"align": "10 s"},
        steps_a_world=4,
        asked="p50 0.12, p99 0.5 ms",
        most_ms={"start_p50": 0.12, "start_p99": 0.5},
        bound=bound_of_drifting_ticks(10, TICK_MS),
    ),
    SyncCase(
        "clock, align 300 s",
        "2 SMC-4000",
        step={"align": "300 s"},
        steps_a_world=4,
        trials=0.3,
        asked="p99 0.3 ms",
        most_ms={"start_p99": 0.3},
        bound=bound_of_drifting_ticks(300, TICK_MS),
    ),
    SyncCase(
        "clock, contour",
        "8 SMC-4000",
        limits={"jerk": 20_000.0},
        trials=0.5,
        asked="path p99 0.3 ms",
        most_ms={"path_p99": 0.3},
        bound=bound_of_ticks(8, TICK_MS),
    ),
    SyncCase(
        "clock, 60 s",
        "8 SMC-4000",
        cruise_s=60.0,
        trials=0.3,
        asked="end, path p99 1 tick + 0.3 ms",
        most_ms={"end_p99": TICK_MS + 0.3, "path_p99": TICK_MS + 0.3},
        bound=bound_of_ticks(8, TICK_MS),
    ),
    SyncCase(
        "clock",
        "8 SMC-2000, own ports",
        asked="p99 2 ms",
        most_ms={"start_p99": 2.0},
        bound=bound_of_ticks(8, TICK_MS),
    ),
    SyncCase("clock", "8 SMC-2000, one chain", trials=0.2, bound=bound_of_ticks(8, TICK_MS)),
    SyncCase("best", "mixed", asked="p99 2.5 ms", most_ms={"start_p99": 2.5}),
    SyncCase("best", "mixed, lines", asked="p99 2.5 ms", most_ms={"start_p99": 2.5}),
    SyncCase("line", "mixed, lines", step={"start": "line"}, trials=0.5),
    # Two controllers that begin up to 15 ms late cannot be timed better, except by a trigger line or by their own
    # clock.
    SyncCase(
        "best",
        "mixed with pp",
        asked="p99 9 ms",
        most_ms={"start_p99": 9.0},
        bound=bound_of_latencies(PP_SPREAD_MS),
    ),
)


class SyncFigures(NamedTuple):
    """Skews in ms: of starts, ends, and on the path.

    budget: predicted, guaranteed, its median.
    width: of the verdict's interval; 99 in 100 are narrower.
    width_most: its target.
    misses: verdicts that do not contain the true skew.
    late: steps in which a link delayed a start command of the host for longer than its adapter allows
    (`wire_jitter_us`); this cannot be detected, so a verdict based on it is no miss, but the controllers' evidence
    must hold.
    worst: member and term that the budget names.

    Baseline methods have only starts."""

    fleet: str
    way: str
    trials: int
    start_p50: float
    start_p99: float
    start_max: float
    bound_p99: float | None = None
    end_p99: float | None = None
    path_p99: float | None = None
    budget: float | None = None
    width: float | None = None
    width_most: float | None = None
    misses: int | None = None
    late: int | None = None
    worst: str = ""
    asked: str = ""
    met: bool | None = None


class SyncTrial(NamedTuple):
    """One step, ns."""

    start_ns: int
    end_ns: int
    path_ns: float
    budget_ns: int
    width_ns: int
    irreducible_ns: int
    missed: bool
    late: bool
    worst: str


class SyncOptions(NamedTuple):
    """only: a regular expression for the names of the rows to run."""

    trials: int
    seed: int = 1
    only: str = ""
    history_s: int = HISTORY_S
    processes: int = 1


def bench_sync(
    options: SyncOptions, on_row: Callable[[SyncFigures], None] = lambda _: None
) -> tuple[list[SyncFigures], dict[str, list[float]]]:
    """Run the chosen rows, baselines first; return also their start skews, ms."""
    trials, seed, pattern, history_s, processes = options
    rows: list[SyncFigures] = []
    starts: dict[str, list[float]] = {}

    def add_row(row: SyncFigures, skews_ms: list[float]) -> None:
        rows.append(row)
        starts[f"{row.fleet}: {row.way}"] = skews_ms
        on_row(row)

    for row, baseline in enumerate(BASELINES):
        if re.search(pattern, f"{baseline.fleet}, {baseline.way}"):
            olds = [BaselineTrial(row, seed, number) for number in range(trials)]
            add_row(*_make_baseline_figures(baseline, list(map_in_processes(_run_baseline_trial, olds, processes))))
    for row, case in enumerate(CASES):
        if re.search(pattern, f"{case.fleet}, {case.name}"):
            worlds = list(_make_fleet_trials(row, max(2, round(trials * case.trials)), seed, history_s))
            add_row(
                *_make_figures(
                    case,
                    [trial for results in map_in_processes(_run_fleet_trials, worlds, processes) for trial in results],
                )
            )
    return rows, starts


class BaselineTrial(NamedTuple):
    """One trial of a row of BASELINES."""

    row: int
    seed: int
    number: int


def _run_baseline_trial(trial: BaselineTrial) -> float:
    """Return the start skew, ms."""
    draw = Random(f"{trial.seed} {trial.number}")
    return run_virtual(lambda clock: BASELINES[trial.row].trial(clock, draw)) / 1e6


def _make_baseline_figures(baseline: BaselineMethod, skews_ms: list[float]) -> tuple[SyncFigures, list[float]]:
    return SyncFigures(baseline.fleet, baseline.way, len(skews_ms), *_compute_spread(skews_ms)), skews_ms


class FleetTrials(NamedTuple):
    """Some steps of a row of CASES, after history_s of polls."""

    row: int
    seed: int
    steps: int
    history_s: int


def _make_fleet_trials(row: int, trials: int, seed: int, history_s: int) -> Iterator[FleetTrials]:
    # The polls before take as long as forty steps.
    a_world = CASES[row].steps_a_world or max(STEPS_PER_FLEET, trials // MIN_FLEETS)
    for number, first_trial in enumerate(range(0, trials, a_world)):
        yield FleetTrials(row, seed * 1000 + number, min(a_world, trials - first_trial), history_s)


def _run_fleet_trials(world: FleetTrials) -> list[SyncTrial]:
    return run_virtual(lambda clock: _run_trials(clock, world))


def _make_figures(case: SyncCase, found: list[SyncTrial]) -> tuple[SyncFigures, list[float]]:
    starts = [trial.start_ns / 1e6 for trial in found]
    figures = SyncFigures(
        fleet=case.fleet,
        way=case.name,
        trials=len(found),
        **dict(zip(("start_p50", "start_p99", "start_max"), _compute_spread(starts), strict=True)),
        bound_p99=None if case.bound is None else round(case.bound(), 3),
        end_p99=_percentile([trial.end_ns / 1e6 for trial in found], 0.99),
        path_p99=_percentile([trial.path_ns / 1e6 for trial in found], 0.99),
        budget=_percentile([trial.budget_ns / 1e6 for trial in found], 0.5),
        width=_percentile([trial.width_ns / 1e6 for trial in found], 0.99),
        misses=sum(trial.missed for trial in found),
        late=sum(trial.late for trial in found),
        worst=max({trial.worst for trial in found}, key=lambda name: sum(trial.worst == name for trial in found)),
        asked=case.asked,
    )
    irreducible = _percentile([trial.irreducible_ns / 1e6 for trial in found], 0.5)
    figures = figures._replace(width_most=round(max(3 * figures.start_p99, 2 * irreducible), 3))
    # What the delays of a network leave open is no fault of the evidence.
    most_ms = {**case.most_ms, **({"width": figures.width_most} if case.to_ms is None else {})}
    is_met = all(getattr(figures, name) <= most for name, most in most_ms.items()) if case.most_ms else None
    return figures._replace(met=is_met), starts


async def _run_trials(clock: VirtualClock, world: FleetTrials) -> list[SyncTrial]:
    case = CASES[world.row]
    draw = Random(f"{case.name} {case.fleet} {world.seed}")
    fleet = VirtualFleet(make_sync_fleet(case.fleet, world.seed, **case.limits), clock, world.seed, guardian=False)
    if case.to_ms is not None:
        _set_apart(fleet, case.to_ms, case.back_ms, draw)
    await fleet.start()
    names = list(fleet.fleet.controllers)
    await _run_job(fleet, [{"do": "enable", "axes": names}, {"do": "home"}])
    await sleep_ns(clock, world.history_s * NS_PER_S)
    trials: list[SyncTrial] = []
    for k in range(world.steps):
        await sleep_ns(clock, draw.randrange(PAUSE_NS))
        targets = {
            f"{name}.x": (limits.velocity * (0.2 + 0.5 * case.cruise_s)) if k % 2 == 0 else 0.0
            for name in names
            for limits in [fleet.fleet.controllers[name].axes["x"].limits]
        }
        move = {"do": "move", "to": targets, "speed": 0.5, **case.step}
        trials.append(await _run_trial(fleet, move, round(case.cruise_s / PATH_SAMPLES * NS_PER_S), draw))
    return trials


def _set_apart(fleet: VirtualFleet, to_ms: float, back_ms: float, draw: Random) -> None:
    """Put each adapter host on a computer of its own."""
    to, way_back = (
        NetworkPath(round(mean_ms * NS_PER_MS), round(mean_ms * NS_PER_MS / 10)) for mean_ms in (to_ms, back_ms)
    )
    for host in fleet.fleet.hosts:
        offset_ns, ppm = draw.randrange(1, 2000) * NS_PER_S, draw.uniform(-DRIFT_PPM, DRIFT_PPM)
        fleet.computers[host] = ComputerClock(fleet.clock, host, offset_ns, ppm)
        fleet.net.network.set_path(host, to=to, back=way_back)


async def _run_trial(fleet: VirtualFleet, move: dict[str, Any], look_ns: int, draw: Random) -> SyncTrial:
    motion_counts = {name: len(controller.commanded_motions) for name, controller in fleet.controllers.items()}
    positions: list[tuple[int, dict[str, float]]] = []
    watching = asyncio.get_running_loop().create_task(_watch_path(fleet, look_ns, draw, positions))
    report = await _run_job(fleet, [move])
    watching.cancel()
    step = report.steps[0]
    client = fleet.make_client("path")
    recording = await client.load_recording(report.job_id, 0)
    await client.close()
    assert recording is not None
    motions = [controller.commanded_motions[motion_counts[name]] for name, controller in fleet.controllers.items()]
    origin_ns = next(iter(fleet.coordinators.values()))[1].leadership.scale.origin_host_ns
    start_ns = max(motion.start_ns for motion in motions) - min(motion.start_ns for motion in motions)
    ends = [motion.end_ns for motion in motions if motion.end_ns is not None]
    skew, budget = step.narrowest_skew, step.budget
    assert skew is not None and budget is not None
    motion_by_name = dict(zip(fleet.controllers, motions, strict=True))
    late = any(
        step.members[name].start_class == "host" and fleet.wires[name].delayed_start(motion.start_ns)
        for name, motion in motion_by_name.items()
    )
    is_missed = not late and not skew.at_least_ns <= start_ns <= skew.at_most_ns
    for name, motion in motion_by_name.items():
        for evidence in step.members[name].evidence.values():
            for interval in (evidence.start,) if late else (evidence.start, evidence.start_for_verdict):
                is_missed = is_missed or not interval.earliest_ns <= motion.start_ns - origin_ns <= interval.latest_ns
    return SyncTrial(
        start_ns=start_ns,
        end_ns=max(ends) - min(ends),
        path_ns=_measure_path_skew(recording, origin_ns, positions),
        budget_ns=budget.predicted_ns,
        width_ns=skew.at_most_ns - skew.at_least_ns,
        irreducible_ns=sum(sorted(_irreducible_ns(step, name) for name in fleet.controllers)[-2:]),
        missed=is_missed,
        late=late,
        worst=f"{budget.worst_member}, {budget.worst_term}",
    )


def _irreducible_ns(step: StepReport, name: str) -> int:
    """Return the part of a member's start that cannot be determined, to either side. With a clock: half its shortest
    round trip, and the tick by which it timestamps; without, half of what its link and firmware leave open."""
    assert step.budget is not None
    member, budget = step.members[name], step.budget.members[name]
    if member.mapping is not None and member.start_class == "clock":
        return member.mapping.min_rtt_ns // 2 + round(member.mapping.tick_ns)
    return (budget.latest_ns - budget.earliest_ns) // 2


async def _watch_path(
    fleet: VirtualFleet, every_ns: int, draw: Random, seen: list[tuple[int, dict[str, float]]]
) -> None:
    """Record the true positions of all axes (counts), at random instants."""
    motors = {name: config.axes["x"].motors[0] for name, config in fleet.fleet.controllers.items()}
    while True:
        await sleep_ns(fleet.clock, every_ns // 2 + draw.randrange(every_ns))
        present_positions = {
            f"{name}.x": controller.position(motors[name]) for name, controller in fleet.controllers.items()
        }
        seen.append((fleet.clock.now_ns(), present_positions))


def _measure_path_skew(recording: StepRecording, origin_ns: int, seen: list[tuple[int, dict[str, float]]]) -> float:
    """Return the largest distance in time between the axes' positions on the plan, ns: (position - plan) / planned
    velocity, where that is at least a tenth of the axis's peak."""
    worst_ns = 0.0
    at = {axis: axis_motion.profile.make_evaluator() for axis, axis_motion in recording.axes.items()}
    for now_ns, axis_positions in seen:
        since_s = (now_ns - origin_ns - recording.t0_fleet_ns) * 1e-9
        late: list[float] = []
        for axis, axis_motion in recording.axes.items():
            if not 0.0 < since_s < axis_motion.profile.duration_s:
                continue
            planned_state = at[axis](since_s)
            if abs(planned_state.velocity) >= PEAK_SHARE * axis_motion.profile.peak_velocity:
                off = axis_positions[axis] - axis_motion.profile.start_counts - planned_state.position
                late.append(off / planned_state.velocity * 1e9)
        if len(late) > 1:
            worst_ns = max(worst_ns, max(late) - min(late))
    return worst_ns


async def _run_job(fleet: VirtualFleet, steps: list[dict[str, Any]]) -> JobReport:
    job = Job.model_validate(
        {
            "schema": "tutti.job/1",
            "name": "sync",
            "max_start_skew": "500 ms",
            "max_end_skew": "500 ms",
            "steps": steps,
        }
    )
    client = fleet.make_client("sync")
    try:
        report = await client.wait_for_job(await client.submit(job))
    finally:
        await client.close()
    if report.state != "done":
        raise RuntimeError(f"the step did not run: {report.reason}")
    return report


def _compute_spread(values: list[float]) -> tuple[float, float, float]:
    return _percentile(values, 0.5), _percentile(values, 0.99), _percentile(values, 1.0)


def _percentile(values: list[float], share: float) -> float:
    """Percentile by nearest rank."""
    ordered_values = sorted(values)
    return round(ordered_values[min(len(ordered_values) - 1, int(share * len(ordered_values)))], 3)
