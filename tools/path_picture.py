"""Draw `docs/figures/path-chunks.png`: a path in chunks with an override, a feed hold and a resume, as the simulators
of two SMC-4000 truly move, in virtual time."""

# Matplotlib types its keyword arguments only in part.
# pyright: reportUnknownMemberType=false

import asyncio
import sys
from pathlib import Path
from random import Random
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[1]))  # benches are not installed
from benches.paths.circles import CircleCase, make_fleet
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.jobs.job import Job
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import SWITCH_S, ChunkPlan, PathCourse
from orchestrator.plan.path_profiles import FittedAxis, FittedMotion
from orchestrator.runtime.virtual.fleet import VirtualFleet

ROOT = Path(__file__).parents[1]
CASE = CircleCase("picture", ("smc4000", "smc4000"), 60.0, 120, "1 mm")
SEED = 59
LOOK_NS = 31 * NS_PER_MS
TURNS, RADIUS, CENTRE, SPEED = 13, 50.0, 100.0, 100.0
ORDERS = ((10.0, "override", 50.0), (20.0, "pause", 0.0), (28.0, "resume", 0.0), (36.0, "override", 100.0))
BLUE, GREY, RED, GREEN = "#1d4ed8", "#9ca3af", "#dc2626", "#16a34a"
UM = 1000.0
CHUNK_S = 7.5

Array = NDArray[np.float64]


class Truth(NamedTuple):
    """What was seen: instants after the start of the motion, positions of both axes (mm), the bound (mm), and by how
    much the crystals differ."""

    times_s: Array
    positions: Array
    bound: float
    apart_ppm: float


async def _run_job(fleet: VirtualFleet, steps: list[dict[str, Any]]) -> str:
    job = Job.model_validate({"schema": "tutti.job/1", "name": "picture", "max_start_skew": "20 ms", "steps": steps})
    return await fleet.make_client("picture").submit(job)


def _move_along_circles() -> Truth:
    """Run the path in virtual time."""

    async def run_path(clock: VirtualClock) -> Truth:
        plan = make_fleet(CASE, Random(SEED))
        fleet = VirtualFleet(plan, clock, SEED, guardian=False)
        await fleet.start()
        client, names = fleet.make_client("picture"), list(plan.controllers)
        axes = [f"{name}.x" for name in names]
        start, far = [CENTRE + RADIUS, CENTRE], [CENTRE - RADIUS, CENTRE]
        sides = [[CENTRE, CENTRE + RADIUS], [CENTRE, CENTRE - RADIUS]]
        to = dict(zip(axes, start, strict=True))
        steps: list[dict[str, Any]] = [{"do": "enable", "axes": names}, {"do": "home"}, {"do": "move", "to": to}]
        await client.wait_for_job(await _run_job(fleet, steps))
        await sleep_ns(clock, CASE.history_s * NS_PER_S)
        ends = [far, start]
        pieces = [{"piece": "arc", "through": sides[k % 2], "to": ends[k % 2]} for k in range(2 * TURNS)]
        path = {"do": "path", "axes": axes, "start": start, "pieces": pieces, "speed": f"{SPEED} mm/s"}
        job_id = await _run_job(fleet, [{**path, "tolerance": CASE.tolerance}])
        units = [(fleet.controllers[name], plan.controllers[name].axes["x"].motors[0]) for name in names]
        rows: list[tuple[float, float, float]] = []

        async def look() -> None:
            while True:
                await sleep_ns(clock, LOOK_NS)
                x, y = (unit.position(motor) / 1000 for unit, motor in units)
                if rows or any(unit.is_moving(motor) for unit, motor in units):
                    rows.append((clock.now_ns() / NS_PER_S, x, y))

        looking = asyncio.get_running_loop().create_task(look())
        while not rows:
            await sleep_ns(clock, NS_PER_MS)
        began_ns = clock.now_ns()
        for at_s, order, percent in ORDERS:
            await sleep_ns(clock, began_ns + round(at_s * NS_PER_S) - clock.now_ns())
            if order == "override":
                await client.override_job(job_id, percent)
            elif order == "pause":
                await client.pause_job(job_id, now=True)
            else:
                await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        looking.cancel()
        bound = report.steps[0].path.bound if report.steps[0].path is not None else None
        assert report.state == "done" and bound is not None, report.reason
        seen = np.array(rows)
        drifts = [each.simulate.drift_ppm for each in plan.controllers.values()]
        return Truth(seen[:, 0] - began_ns / NS_PER_S, seen[:, 1:], bound.predicted, abs(drifts[0] - drifts[1]))

    return run_virtual(run_path)


def _plan_chunks() -> list[ChunkPlan]:
    """The chunks of a line of 30 s at the same speed, each with its stopping tail."""
    ramp_s, whole_s = 0.2, 30.0
    a = SPEED / ramp_s
    times_s = np.array([0.0, ramp_s, whole_s - ramp_s, whole_s])
    velocities = np.array([[0.0], [SPEED], [SPEED], [0.0]])
    positions = np.cumsum([0.0, SPEED * ramp_s / 2, SPEED * (whole_s - 2 * ramp_s), SPEED * ramp_s / 2])[:, None]
    accelerations, jerks = np.array([[a], [0.0], [-a]]), np.zeros((3, 1))
    motion = FittedMotion(times_s, positions, velocities, accelerations, jerks)
    ends = 0, round(1000 * float(positions[-1, 0]))
    axis = FittedAxis("line", 1000.0, 2 * SPEED, 2 * a, *ends, 100 * a)
    course = PathCourse(motion, [axis], [0], positions[0], 0.001)
    clock, chunks = PathClock.from_rest(0.0, 0.0), list[ChunkPlan]()
    while not chunks or not chunks[-1].last:
        chunks.append(course.plan_chunk(clock, chunks[-1].end_s - SWITCH_S if chunks else 0.0, CHUNK_S))
    return chunks


def _draw_chunks(axes: Axes, chunks: list[ChunkPlan]) -> None:
    for number, chunk in enumerate(chunks):
        profile = next(iter(chunk.profiles.values()))
        at, colour = profile.make_evaluator(), (BLUE, GREEN)[number % 2]
        for begin_s, stop_s, style in ((chunk.begin_s, chunk.end_s, "-"), (chunk.end_s, chunk.stop_s, ":")):
            times_s = np.linspace(begin_s, stop_s, 400)
            speeds = [at(t - chunk.begin_s).velocity / profile.scale_counts for t in times_s.tolist()]
            axes.plot(times_s, speeds, style, color=colour, linewidth=1.8)
        if not chunk.last:
            axes.annotate(f"{number + 1}", (chunk.begin_s + 3.6, SPEED * 0.82), color=colour, ha="center")
    axes.set_ylabel("planned, mm/s")
    axes.set_xlabel("s; each chunk with its stopping tail (dotted), which the next chunk replaces")
    axes.set_ylim(0, 1.25 * SPEED)


def _draw_truth(above: Axes, below: Axes, truth: Truth) -> None:
    middles_s = (truth.times_s[1:] + truth.times_s[:-1]) / 2
    ways = np.hypot(*np.diff(truth.positions, axis=0).T)
    above.plot(middles_s, ways / np.diff(truth.times_s), color=BLUE, linewidth=1.2)
    above.set_ylabel("true speed, mm/s")
    above.set_ylim(0, 1.25 * SPEED)
    for at_s, order, percent in ORDERS:
        word = {"override": f"override {percent:.0f} %", "pause": "pause --now"}.get(order, order)
        above.axvline(at_s, color=RED, linewidth=0.9, linestyle="--")
        above.annotate(word, (at_s + 0.3, 1.1 * SPEED), color=RED)
    errors = np.abs(np.hypot(*(truth.positions - CENTRE).T) - RADIUS)
    below.plot(truth.times_s, UM * errors, color=BLUE, linewidth=0.9, label="true distance from the path")
    below.axhline(UM * truth.bound, color=RED, linewidth=1.2, label="bound, before it ran")
    # One axis late by d on a circle is off it by half of d times the speed, where it is at 45 degrees.
    drifted = truth.apart_ppm * 1e-6 * truth.times_s * SPEED / 2
    label = f"computed: the clocks, {truth.apart_ppm:.0f} ppm apart, never fitted anew, at {SPEED:.0f} mm/s"
    below.plot(truth.times_s, UM * drifted, color=GREY, linewidth=1.2, linestyle="--", label=label)
    below.set_ylim(0, 1.9 * UM * truth.bound)
    below.set_ylabel("off the path, um")
    below.set_xlabel("s after T0")
    below.legend(loc="upper left", frameon=False)


def main() -> None:
    """Write the picture."""
    mpl.rcParams["font.size"] = 9
    figure = Figure(figsize=(10.0, 7.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    first = figure.add_subplot(3, 1, 1)
    above = figure.add_subplot(3, 1, 2)
    below = figure.add_subplot(3, 1, 3, sharex=above)
    _draw_chunks(first, _plan_chunks())
    _draw_truth(above, below, _move_along_circles())
    for axes in (first, above, below):
        axes.grid(alpha=0.3)
    figure.align_ylabels([first, above, below])
    figure.savefig(ROOT / "docs/figures/path-chunks.png")


if __name__ == "__main__":
    main()
