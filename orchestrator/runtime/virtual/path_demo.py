"""The demo of a path: the example's fleet in virtual time, where the true positions are known at every instant."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.owner import running
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import TuttiError
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import split_name
from orchestrator.model.operation.recording import StepSamples
from orchestrator.model.report import JobReport
from orchestrator.model.steps.tree import find_paths
from orchestrator.plan.path.axes import PathAxis
from orchestrator.plan.path.plan import PathPlan, plan_path
from orchestrator.runtime.virtual.fleet import VirtualFleet

Array = NDArray[np.float64]

SETTLE_S = 40  # of clock readings before the job
TRUTH_NS = 5 * NS_PER_MS
COURSE = 4_001  # points of the path that positions are compared with


class PathDemoFailed(TuttiError):
    """The job of the demo was not done, or recorded nothing. The text says why."""


@dataclass(frozen=True, slots=True)
class AxisSamples:
    """Positions that a controller sampled by itself. times_s: after T0; bound_s: of each instant."""

    times_s: Array
    positions: Array
    bound_s: float


@dataclass(frozen=True, slots=True)
class PathDemo:
    """What came of it. axes: of the path; samples: by axis. times_s, truth: when after T0 and where the axes truly were
    (a row each); errors: how far that is from the path. unit: of lengths."""

    report: JobReport
    axes: list[str]
    unit: str
    plan: PathPlan
    samples: dict[str, AxisSamples]
    times_s: Array
    truth: Array
    errors: Array


def run_path_demo(fleet: Fleet, job: Job) -> PathDemo:
    """Run a job with one path that is recorded. Raises `PathDemoFailed`, `Refusal`."""
    return run_virtual(lambda clock: _run(clock, fleet, job))


async def _run(clock: VirtualClock, fleet: Fleet, job: Job) -> PathDemo:
    virtual = VirtualFleet(fleet, clock, seed=1, guardian=False)
    await virtual.start()
    await sleep_ns(clock, SETTLE_S * NS_PER_S)
    (step,) = find_paths(job.steps)
    found_samples: list[StepSamples] = []

    def take(sample: BusSample) -> None:
        found_samples.append(StepSamples.read_message(sample.payload))

    client = virtual.make_client("demo")
    await client.bus.subscribe(client.keys.job_samples(), take)
    sightings: list[tuple[int, list[float]]] = []
    async with running(_watch_truth(virtual, step.axes, sightings)):
        report = await client.wait_for_job(await client.submit(job))
        await sleep_ns(clock, NS_PER_S)
    done_step = next((step_report for step_report in report.steps if step_report.do == "path"), None)
    if report.state != "done" or done_step is None or done_step.t0_fleet_ns is None or not found_samples:
        raise PathDemoFailed(f"the job is {report.state}: {report.reason or 'nothing was sampled'}")
    origin_ns = next(iter(virtual.coordinators.values()))[1].leadership.scale.origin_host_ns
    await client.close()
    plan = plan_path(step, [_describe_axis(fleet, name) for name in step.axes])
    begins_ns, ends_s = done_step.t0_fleet_ns + origin_ns, plan.duration_s
    rows = [((at_ns - begins_ns) / NS_PER_S, position) for at_ns, position in sightings]
    kept_rows = [(at_s, position) for at_s, position in rows if -0.05 <= at_s <= ends_s + 0.05]
    times_s, truth = np.array([at_s for at_s, _ in kept_rows]), np.array([position for _, position in kept_rows])
    course = plan.path(np.linspace(0.0, plan.length, COURSE))
    unit = fleet.axis(step.axes[0]).unit
    samples = _collect_samples(found_samples, done_step.t0_fleet_ns, ends_s)
    return PathDemo(
        report=report,
        axes=step.axes,
        unit=unit,
        plan=plan,
        samples=samples,
        times_s=times_s,
        truth=truth,
        errors=measure_distances(truth, course),
    )


def _describe_axis(fleet: Fleet, name: str) -> PathAxis:
    axis = fleet.axis(name)
    return PathAxis(name, axis.unit, axis.limits.velocity, axis.limits.acceleration, axis.limits.jerk)


async def _watch_truth(fleet: VirtualFleet, axes: list[str], seen: list[tuple[int, list[float]]]) -> None:
    """Record the true positions of axes, for ever."""
    units: list[tuple[Any, str, float]] = []
    for name in axes:
        axis = fleet.fleet.axis(name)
        units.append((fleet.controllers[split_name(name)[0]], axis.motors[0], float(axis.counts_per_unit)))
    while True:
        seen.append((fleet.clock.now_ns(), [unit.position(motor) / scale for unit, motor, scale in units]))
        await sleep_ns(fleet.clock, TRUTH_NS)


def _collect_samples(found: list[StepSamples], t0_ns: int, ends_s: float) -> dict[str, AxisSamples]:
    """The samples of all axes while they move."""
    samples: dict[str, AxisSamples] = {}
    for sample_series in found:
        times_s = (np.array(sample_series.fleet_ns, dtype=np.float64) - t0_ns) / NS_PER_S
        is_inside = (times_s >= 0.0) & (times_s <= ends_s)
        for name, axis in sample_series.axes.items():
            positions = np.array(axis.counts, dtype=np.float64) / axis.counts_per_unit
            bound_s = sample_series.bound_ns / NS_PER_S
            samples[f"{sample_series.controller}.{name}"] = AxisSamples(
                times_s[is_inside], positions[is_inside], bound_s
            )
    return samples


def measure_distances(points: Array, course: Array) -> Array:
    """How far points (n, axes) are from a course of straight lines between points (m, axes)."""
    distances = np.zeros(len(points))
    ways = np.diff(course, axis=0)
    squares = np.maximum((ways**2).sum(axis=1), 1e-300)
    for k, point in enumerate(points):
        off = point - course[:-1]
        part = np.clip((off * ways).sum(axis=1) / squares, 0.0, 1.0)
        distances[k] = np.sqrt(((off - part[:, None] * ways) ** 2).sum(axis=1).min())
    return distances
